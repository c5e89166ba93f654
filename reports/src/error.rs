use femc_film::FilmError;
use femc_pipeline::paths::{MergeError, PathsError};
use parquet::errors::ParquetError;
use std::path::{Path, PathBuf};

/// Reason why a report cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A figure cannot be drawn.
    #[error("cannot draw a figure: {0}")]
    Figure(String),
    /// A file cannot be read or written.
    #[error("{}: {cause}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// Error of the system.
        cause: std::io::Error,
    },
    /// A file or folder given by the user cannot be read.
    #[error("{}: {cause}", path.display())]
    Input {
        /// The file or folder.
        path: PathBuf,
        /// Error of the system.
        cause: std::io::Error,
    },
    /// A record of a job's attempts is damaged.
    #[error("{}: {cause}", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// Error of the parser.
        cause: serde_json::Error,
    },
    /// A value cannot be written as JSON.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// An image cannot be read, compared or written.
    #[error(transparent)]
    Film(#[from] FilmError),
    /// A Parquet file cannot be written.
    #[error("{}: {cause}", path.display())]
    Parquet {
        /// The file.
        path: PathBuf,
        /// Error of the Parquet library.
        cause: ParquetError,
    },
    /// A file of light statistics is damaged.
    #[error("{}: {cause}", path.display())]
    Statistics {
        /// The file.
        path: PathBuf,
        /// Error of the decoder.
        cause: PathsError,
    },
    /// Frames that were merged cannot be merged again.
    #[error("{file}: {cause}")]
    MergedFrames {
        /// The file, or the first and the last of several.
        file: String,
        /// Reason of the failure.
        cause: MergeError,
    },
    /// A file of light statistics contains no frame.
    #[error("{}: the file contains no frame", .0.display())]
    NoFrame(PathBuf),
    /// A folder without light statistics.
    #[error("{}: the folder contains no .paths file; `femc render --stats` writes .paths files beside the frames", .0.display())]
    NoStatistics(PathBuf),
    /// Frames of different jobs.
    #[error("{file}: {cause}; merge only frames of one job, and a frame only with the same content")]
    MergeConflict {
        /// The file that does not fit.
        file: String,
        /// Reason of the failure.
        cause: MergeError,
    },
    /// A file does not contain measurements.
    #[error("{}: not measurements of `femc bench`: {cause}; give another file, or move this file away", path.display())]
    Measurements {
        /// The file.
        path: PathBuf,
        /// Error of the parser.
        cause: serde_json::Error,
    },
    /// Measurements in an unsupported version of the file format.
    #[error("{}: file format version {found}, this program reads version {own}; give another file", path.display())]
    MeasurementsVersion {
        /// The file.
        path: PathBuf,
        /// Version of the file.
        found: u32,
        /// Version that this program supports.
        own: u32,
    },
    /// Measurements with another setup.
    #[error(
        "{}: the file contains measurements of another setup; give another file with -o, or move this file away; differences: \
         {differing}",
        path.display()
    )]
    SetupMismatch {
        /// The file.
        path: PathBuf,
        /// Differences between the setups.
        differing: String,
    },
    /// A missing reference.
    #[error("--reference {}: no such file; give an EXR image", .0.display())]
    NoReference(PathBuf),
    /// Images of a reference have different sizes.
    #[error("--reference {named}: the images have different sizes: {sizes}")]
    ReferenceSizes {
        /// Reference, as given.
        named: String,
        /// Both sizes, pixels.
        sizes: String,
    },
    /// Two files beside a reference have the names of its halves, but are not.
    #[error(
        "--reference {0}: the files _A and _B beside it are not its halves: their mean is a different image; move these files \
         away, or give the halves: A.exr,B.exr"
    )]
    NotHalves(String),
}

/// Cause of a missing report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// The request: another command line helps.
    Usage,
    /// A file or the machine.
    Execution,
}

impl ReportError {
    /// Returns the cause of the error.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Input { .. }
            | Self::NoStatistics(_)
            | Self::MergeConflict { .. }
            | Self::SetupMismatch { .. }
            | Self::NoReference(_)
            | Self::ReferenceSizes { .. }
            | Self::NotHalves(_) => ErrorKind::Usage,
            Self::Figure(_)
            | Self::File { .. }
            | Self::Record { .. }
            | Self::Json(_)
            | Self::Film(_)
            | Self::Parquet { .. }
            | Self::Statistics { .. }
            | Self::MergedFrames { .. }
            | Self::NoFrame(_)
            | Self::Measurements { .. }
            | Self::MeasurementsVersion { .. } => ErrorKind::Execution,
        }
    }

    pub(crate) fn file(path: &Path) -> impl Fn(std::io::Error) -> Self {
        let path = path.to_owned();
        move |cause| Self::File { path: path.clone(), cause }
    }

    pub(crate) fn input(path: &Path) -> impl Fn(std::io::Error) -> Self {
        let path = path.to_owned();
        move |cause| Self::Input { path: path.clone(), cause }
    }
}
