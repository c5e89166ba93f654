//! Code specific to one medium, beyond `object_store`.

pub(crate) mod folder;
pub(crate) mod http;
pub(crate) mod s3;
