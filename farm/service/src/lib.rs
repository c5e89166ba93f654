//! What can be asked of a farm, whatever the way.
//!
//! [`Operation`] is everything that can be asked for, with the right that it takes; [`Gate`] says who may, whose turn it is, and
//! what is noted of it. [`Call`] is what reaches the coordinator. gRPC (`femc-proto`) is one adapter of this; [`Http`] is the other: JSON
//! for programs and for the page, one [`Feed`] of changes, server-sent. [`view`] has the JSON of all there is.
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
