//! OpenEXR files: writes the renderer's files, and reads the colors of any file that the `exr` crate supports.

mod layers;
mod named_channels;
mod read;
mod write;

pub use layers::{Channels, decode_channels, read_channels};
pub use named_channels::{NamedChannel, Precision, encode_named_channels};
pub use read::{ExrFile, decode, read, read_attributes};
pub use write::{Provenance, UNLIT, block_error_plane, encode, encode_layers, write};

/// Prefix of the string attributes that the renderer writes.
pub const ATTRIBUTE_PREFIX: &str = "femc:";

/// Number of threads that pack or unpack a file; the bytes of the file do not depend on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Threads {
    One,
    Many,
}

impl Threads {
    /// Number of pixels from which several threads pay off.
    const MIN_PARALLEL_PIXELS: usize = 1 << 18;

    /// Returns the threads for a file of `pixels` pixels. For each file that it compresses with many threads, the `exr` crate
    /// starts a pool of all the machine's threads. Small files, callers whose pool has one thread, and callers without a pool get
    /// one thread. (Outside of a pool, asking rayon for its number of threads would start the global pool.)
    fn for_pixels(pixels: usize) -> Self {
        let has_pool = rayon::current_thread_index().is_some();
        if pixels >= Self::MIN_PARALLEL_PIXELS && has_pool && rayon::current_num_threads() > 1 {
            Self::Many
        } else {
            Self::One
        }
    }
}
