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
mod job_control;
mod light;
mod operation;
mod picture;
pub mod times;
pub mod view;

pub use access::{
    AccessGrant, AuditEntry, Caller, CallerKey, Credential, Gate, Limits, LoginTokens, Outcome, PresentedCredentials,
    TransferSlot, TransferSlots,
};
pub use call::{AttemptPage, Backup, Call, ChangeScope, Changes, JobList, JobShape, References, Reply};
pub use farm::Farm;
pub use feed::Feed;
pub use http::{Body, ConnectedClient, Http, PageFiles, PermittedResponse, PublicResponse, Site};
pub use job_control::store_refusal;
pub use light::{
    AxisPairs, Corners, EarlierRows, LightAnswer, LightCall, LightCallKind, LightData, LightError, LightFault,
    LightFile, LightSource, MAX_LIGHT_BYTES, OpenLight, PathCount, RowIdentity, VoxelLevel,
};
pub use operation::{Operation, Right};
pub use picture::{ComparePictures, DrawPicture, PictureKind, PictureSource};
