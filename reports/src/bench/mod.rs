//! Run time against error: measurements, files and output of `femc bench`.

pub mod method;
pub mod record;
pub mod reference;
pub mod setup;
pub mod statistics;
pub mod summary;
pub mod table;
pub mod worst;

pub use record::{Record, Run};
