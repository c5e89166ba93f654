//! What the media need beyond `object_store`.

pub(crate) mod folder;
mod http;
pub(crate) mod s3;
