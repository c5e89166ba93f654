//! The wire protocol: `femc/v1/femc.proto`, with clients and servers that use the farm's own types.
//!
//! The generated types are private to this crate. Every received message is checked once, on conversion. An invalid message is a
//! [`ConvertError`], never a default. A refusal travels as an enum in the status's details; the status's code and text serve other
//! tools.
#![deny(missing_docs)]

mod addresses;
mod batch;
mod bearer;
mod client;
mod codec;
mod convert;
mod error;
mod net;
mod probe;
mod server;
#[cfg(feature = "testing")]
pub mod testing;
mod tls;
mod transfer;
mod wire;

pub use client::{Client, JobWatch, SessionReceiver, SessionSender};
pub use convert::ConvertError;
pub use error::{BackupError, CallError, IdentityError, ServeError, UnreachableCause};
pub use femc_service::view::error_target;
pub use femc_service::{
    AttemptPage, Backup, ChangeScope, Changes, JobList, JobShape, LightFault, LightFile, LightSource, Limits,
    LoginTokens, MAX_LIGHT_BYTES, PageFiles, References, Reply, Site,
};
pub use net::{ByteStream, DialFuture, Dialer, Io};
pub use probe::{ProbeResult, probe_address};
pub use server::{
    AccessControl, ArtifactTotals, Call, CollectMode, CollectReport, MIN_GRACE, Server, Session, Traffic,
    WorkerMessages, serve_metrics,
};
pub use tonic::transport::server::{Connected, TcpIncoming};

/// Version of the protocol. A worker sends it when it registers. From version 5 on, a job is a graph of stages. From
/// version 6 on, each thing that a task does has a kind.
pub const PROTOCOL: u32 = 6;

/// Oldest worker version that a coordinator accepts: one before its own, so that a running farm can be upgraded, the coordinator
/// first. The coordinator sends older workers nothing that they do not know. It refuses versions before 5, which do not know
/// graphs.
pub const OLDEST_PROTOCOL: u32 = if PROTOCOL > 5 { PROTOCOL - 1 } else { 5 };

/// Largest number of artifact bytes in one message.
pub const MAX_PIECE_SIZE: usize = 1 << 20;

/// Largest size in bytes of a message of the services `Jobs` and `Workers`.
pub const MAX_MESSAGE_SIZE: usize = Limits::MESSAGE;

/// Largest size in bytes of a message that a worker accepts from its coordinator. An assignment names all inputs of its task, at
/// most [`Graph::MAX_INPUTS`].
///
/// [`Graph::MAX_INPUTS`]: femc_model::Graph::MAX_INPUTS
pub const MAX_ASSIGNMENT_SIZE: usize = 96 << 20;
