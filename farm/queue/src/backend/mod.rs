//! Backends of the log.

mod mark;
pub(crate) mod memory;
pub(crate) mod postgres;
mod rows;
pub(crate) mod sqlite;
