//! The wire: `femc/v1/femc.proto`, and typed clients and servers for it in the farm's own terms.
//!
//! The generated types stay in here. What comes in is checked once, on conversion; a message that makes no sense is a
//! [`ConvertError`], never a default. Refusals travel as an enum in the status's details, beside code and text for
//! other people's tools.
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

/// Version of the protocol: a worker says it when it registers. From 5 on a job is a graph of stages.
pub const PROTOCOL: u32 = 5;

/// Oldest version of workers that a coordinator takes: one before its own, so that a farm is upgraded while it works, the
/// coordinator first. It sends them nothing that they do not know; those before 5, which know no graphs, it refuses.
pub const OLDEST: u32 = if PROTOCOL > 5 { PROTOCOL - 1 } else { 5 };

/// Bytes of an artifact that travel in one message.
pub const PIECE: usize = 1 << 20;

/// Most bytes of a message of the services `Jobs` and `Workers`.
pub const MESSAGE: usize = Limits::MESSAGE;

/// The same of what a worker takes from its coordinator: an assignment names all that its task reads, [`Graph::MAX_INPUTS`] at most.
///
/// [`Graph::MAX_INPUTS`]: femc_model::Graph::MAX_INPUTS
pub const ASSIGNMENT: usize = 96 << 20;
