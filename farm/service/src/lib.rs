//! Services of the farm, independent of the protocol.
//!
//! [`Operation`] lists all operations with the rights they need. [`Gate`] authorizes requests, limits their rate, and writes the
//! audit log. [`Call`] is a call to the coordinator. gRPC (`femc-proto`) is one adapter of this interface. [`Http`] is the other:
//! JSON for programs and for the web page, and one [`Feed`] of changes as server-sent events. [`view`] has the JSON of all objects.
#![deny(missing_docs)]

mod access;
pub mod attempts;
mod call;
mod farm;
mod feed;
mod file;
mod http;
mod operation;
mod picture;
mod steer;
pub mod times;
pub mod view;

pub use access::{Caller, Credential, Gate, Granted, Limits, Outcome, Place, Places, Shown, Trail, Who};
pub use call::{AttemptPage, Backup, Call, Changes, JobShape, Listing, News, References, Reply};
pub use farm::Farm;
pub use feed::Feed;
pub use http::{Body, Files, Http, Introduced, Served, Site, Visitor};
pub use operation::{Operation, Right};
pub use picture::{Draw, Source, Wanted};
pub use steer::store_refusal;
