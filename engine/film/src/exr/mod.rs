//! OpenEXR files: what the renderer writes, and the colors of any file that the `exr` crate reads.

mod read;
mod write;

pub use read::{ExrFile, decode, read, read_attributes};
pub use write::{Provenance, encode, write};

/// Prefix of the string attributes that the renderer writes.
pub const ATTRIBUTE_PREFIX: &str = "femc:";
