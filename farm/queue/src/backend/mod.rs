//! Where a log may live.

pub(crate) mod memory;
pub(crate) mod sqlite;
