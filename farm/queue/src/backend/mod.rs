//! Where a log may live.

pub(crate) mod memory;
pub(crate) mod postgres;
mod rows;
pub(crate) mod sqlite;
