//! Errors of a job file, with their locations.

use crate::values::TextPosition;
use std::path::{Path, PathBuf};

/// Reasons why a job file is refused.
#[derive(Debug, thiserror::Error)]
pub enum JobFileError {
    /// The file cannot be read.
    #[error("{}: {cause}", path.display())]
    Read {
        /// The job file.
        path: PathBuf,
        /// Error of the system.
        cause: std::io::Error,
    },
    /// The file is not TOML, or not a job.
    #[error("{}:{}:{}: {what}", path.display(), place.line, place.column)]
    Invalid {
        /// The job file.
        path: PathBuf,
        /// Line and column of the fault.
        place: TextPosition,
        /// Description of the fault.
        what: String,
    },
}

/// A fault in a text whose file only the caller knows.
#[derive(Debug, PartialEq, Eq)]
pub struct Fault {
    /// Byte offset.
    pub offset: usize,
    /// Description of the fault.
    pub message: String,
}

impl Fault {
    /// Creates a fault at a byte offset.
    pub fn new(offset: usize, message: impl Into<String>) -> Self {
        Self { offset, message: message.into() }
    }

    /// Adds the file to the fault.
    pub fn in_file(self, path: &Path, text: &str) -> JobFileError {
        JobFileError::Invalid {
            path: path.to_owned(),
            place: TextPosition::from_offset(text, self.offset),
            what: self.message,
        }
    }
}

/// Returns a parser's message on one line.
pub fn one_line(message: &str) -> String {
    message.lines().map(str::trim).collect::<Vec<_>>().join("; ")
}
