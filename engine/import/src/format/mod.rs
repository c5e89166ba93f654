//! File formats, one folder or file each.

pub(crate) mod mgf;
