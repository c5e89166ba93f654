//! Backends of the log.

pub(crate) mod memory;
pub(crate) mod postgres;
mod rows;
pub(crate) mod sqlite;
mod watermark;
