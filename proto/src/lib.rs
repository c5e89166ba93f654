//! The wire protocol: `femc/v1/femc.proto`, with clients and servers that use the farm's own types.
//!
//! The generated types are private to this crate. Every received message is checked once, on conversion. An invalid message is a
//! [`ConvertError`], never a default. A refusal travels as an enum in the status's details; the status's code and text serve other
//! tools.
#![deny(missing_docs)]

mod addresses;
mod bearer;
mod client;
mod codec;
mod convert;
mod error;
mod look;
mod many;
mod net;
mod server;
#[cfg(feature = "testing")]
pub mod testing;
mod tls;
mod transfer;
mod wire;

pub use client::{Client, Incoming, Outgoing, Watch};
pub use convert::ConvertError;
pub use error::{BackupError, CallError, IdentityError, ServeError, Why};
pub use femc_service::view::error_target;
pub use femc_service::{AttemptPage, Backup, Changes, Files, JobShape, Limits, Listing, News, References, Reply, Site};
pub use look::{Found, look};
pub use net::{Dial, Dialing, Io, Link};
pub use server::{
    Call, CollectMode, Collected, Entrance, LEAST_GRACE, Server, Session, Traffic, Volume, WorkerMessages,
};
pub use tonic::transport::server::{Connected, TcpIncoming};

/// Version of the protocol. A worker sends it when it registers. From version 5 on, a job is a graph of stages.
pub const PROTOCOL: u32 = 5;

/// Oldest worker version that a coordinator accepts: one before its own, so that a running farm can be upgraded, the coordinator
/// first. The coordinator sends older workers nothing that they do not know. It refuses versions before 5, which do not know
/// graphs.
pub const OLDEST: u32 = if PROTOCOL > 5 { PROTOCOL - 1 } else { 5 };

/// Largest number of artifact bytes in one message.
pub const PIECE: usize = 1 << 20;

/// Largest size in bytes of a message of the services `Jobs` and `Workers`.
pub const MESSAGE: usize = Limits::MESSAGE;

/// Largest size in bytes of a message that a worker accepts from its coordinator. An assignment names all inputs of its task, at
/// most [`Graph::MAX_INPUTS`].
///
/// [`Graph::MAX_INPUTS`]: femc_model::Graph::MAX_INPUTS
pub const ASSIGNMENT: usize = 96 << 20;
