//! Where the bytes lie when that is more than a folder or memory.

mod http;
pub(crate) mod s3;
