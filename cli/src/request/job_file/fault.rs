//! What is wrong with a job file, and where.

use crate::values::Place;
use std::path::{Path, PathBuf};

/// Why a job file is refused.
#[derive(Debug, thiserror::Error)]
pub enum JobFileError {
    /// Not readable.
    #[error("{}: {cause}", path.display())]
    Read {
        /// The job file.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// Not TOML, or not a job.
    #[error("{}:{}:{}: {what}", path.display(), place.line, place.column)]
    Form {
        /// The job file.
        path: PathBuf,
        /// Line and column of the fault.
        place: Place,
        /// What is wrong there.
        what: String,
    },
}

/// A fault in a text whose path the caller knows.
#[derive(Debug, PartialEq, Eq)]
pub struct Fault {
    /// Byte offset.
    pub offset: usize,
    /// What is wrong there.
    pub what: String,
}

impl Fault {
    /// At a byte offset.
    pub fn new(offset: usize, what: impl Into<String>) -> Self {
        Self { offset, what: what.into() }
    }

    /// In a file.
    pub fn within(self, path: &Path, text: &str) -> JobFileError {
        JobFileError::Form { path: path.to_owned(), place: Place::of(text, self.offset), what: self.what }
    }
}

/// What a parser says, on one line.
pub fn one_line(message: &str) -> String {
    message.lines().map(str::trim).collect::<Vec<_>>().join("; ")
}
