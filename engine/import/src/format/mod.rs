//! File formats, one folder or file each.

pub(crate) mod ies;
pub(crate) mod mgf;
