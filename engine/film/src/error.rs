//! Errors in film data.

use crate::{Rect, SampleRange};
use std::path::PathBuf;

/// Errors of this crate; decide by variant.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// A film, tile or image has no pixels or more than the limit.
    #[error("size {width}x{height}: the number of pixels must be from 1 to {limit}")]
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
    #[error("tile {found} cannot be merged into tile {expected}")]
    OtherPixels {
        /// Pixels of the tile that is merged into.
        expected: Rect,
        /// Pixels of the other tile.
        found: Rect,
    },
    /// The tile's pixels match no tile of the frame.
    #[error("tile {0} is not a tile of the frame")]
    NotInFrame(Rect),
    /// Some, but not all, samples of a tile have been counted before.
    #[error("tile {rect}: samples {}..{} overlap {}..{}, which are already counted", .new.start, .new.end, .old.start, .old.end)]
    Overlap {
        /// Pixels of the tile.
        rect: Rect,
        /// Sample range that is already counted.
        old: SampleRange,
        /// Sample range to add.
        new: SampleRange,
    },
    /// A tile cannot be resolved, because it has no samples or a gap in them.
    #[error("tile {0} has no samples, or a gap in them")]
    Gap(Rect),
    /// The bytes are not a tile, or they are damaged.
    #[error("tile data: {0}")]
    Corrupt(&'static str),
    /// The bytes were written by another version of the format.
    #[error("the tile data have format {found}; this build reads format {expected}")]
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
        /// Message of the image library.
        cause: String,
    },
    /// An EXR file has no colors.
    #[error("the EXR file has no part with channels R, G and B; it has: {found}")]
    NoColors {
        /// Names of the channels in the file.
        found: String,
    },
    /// Two images of different sizes cannot be compared.
    #[error("the image sizes differ: {a_width}x{a_height} and {b_width}x{b_height}")]
    SizesDiffer {
        /// Width of the first image.
        a_width: u32,
        /// Height of the first image.
        a_height: u32,
        /// Width of the second image.
        b_width: u32,
        /// Height of the second image.
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
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// The content of a named file is invalid.
    #[error("{}: {cause}", .path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// Error in the content.
        cause: Box<FilmError>,
    },
    /// The extension of an animated image is not a supported format.
    #[error("{}: the name of an animated image must end in .png, .apng or .gif", .0.display())]
    AnimationFormat(PathBuf),
}

impl FilmError {
    pub(crate) fn in_file(self, path: &std::path::Path) -> Self {
        Self::InFile { path: path.into(), cause: Box::new(self) }
    }
}
