//! Run time against error: what `femc bench` measures, keeps and says of it.

pub mod method;
pub mod record;
pub mod reference;
pub mod setup;
pub mod statistics;
pub mod summary;
pub mod table;
pub mod worst;

pub use record::{Record, Run};
