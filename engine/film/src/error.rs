//! What can go wrong with film data.

use crate::{Rect, SampleRange};
use std::path::PathBuf;

/// Errors of this crate; decide by variant.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// A film, tile or image has no pixels or more than the limit.
    #[error("size {width}x{height}: pixels must be 1 to {limit}")]
    Size {
        /// Width, pixels.
        width: u64,
        /// Height, pixels.
        height: u64,
        /// Largest number of pixels.
        limit: u64,
    },
    /// A sample range holds no sample.
    #[error("sample range {}..{} is empty", .0.start, .0.end)]
    EmptyRange(SampleRange),
    /// Two tiles of different pixels cannot be merged.
    #[error("tile {found} merged into tile {expected}")]
    OtherPixels {
        /// Pixels of the tile that was to grow.
        expected: Rect,
        /// Pixels of the other one.
        found: Rect,
    },
    /// The tile's pixels are no tile of the frame.
    #[error("tile {0} is none of the frame's tiles")]
    NotInFrame(Rect),
    /// Some, but not all, samples of a tile have been counted before.
    #[error("tile {rect}: samples {}..{} overlap {}..{}, which are counted already", .new.start, .new.end, .old.start, .old.end)]
    Overlap {
        /// Pixels of the tile.
        rect: Rect,
        /// Range already there.
        old: SampleRange,
        /// Range that was to be added.
        new: SampleRange,
    },
    /// A tile that is to be resolved is not whole.
    #[error("tile {0} has no samples, or a gap in them")]
    Gap(Rect),
    /// Bytes that are no tile, or a damaged one.
    #[error("tile data: {0}")]
    Corrupt(&'static str),
    /// Bytes written by another version of the format.
    #[error("tile data of format {found}, this is format {expected}")]
    Version {
        /// Version in the data.
        found: u32,
        /// Version that this build reads and writes.
        expected: u32,
    },
    /// An image file cannot be decoded or encoded.
    #[error("{what}: {cause}")]
    Format {
        /// Kind of file.
        what: &'static str,
        /// What its library says.
        cause: String,
    },
    /// An EXR file has no colors.
    #[error("EXR without channels R, G and B in one part; it has: {found}")]
    NoColors {
        /// Names of the channels it has.
        found: String,
    },
    /// Two images cannot be compared.
    #[error("sizes differ: {a_width}x{a_height} against {b_width}x{b_height}")]
    SizesDiffer {
        /// Width of the first.
        a_width: u32,
        /// Height of the first.
        a_height: u32,
        /// Width of the second.
        b_width: u32,
        /// Height of the second.
        b_height: u32,
    },
    /// No pixel is finite in both images.
    #[error("no pixel is finite in both images")]
    NothingToCompare,
    /// A file cannot be read or written.
    #[error("{}: {cause}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// A named file's content is at fault.
    #[error("{}: {cause}", .path.display())]
    In {
        /// The file.
        path: PathBuf,
        /// The fault.
        cause: Box<FilmError>,
    },
    /// An animated image's extension names no format that is written here.
    #[error("{}: an animated image ends in .png, .apng or .gif", .0.display())]
    AnimationFormat(PathBuf),
}

impl FilmError {
    pub(crate) fn in_file(self, path: &std::path::Path) -> Self {
        Self::In { path: path.into(), cause: Box::new(self) }
    }
}
