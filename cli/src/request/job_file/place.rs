//! Where things stand in a job file.

use std::path::{Path, PathBuf};

/// Line and column, both from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// From 1.
    pub line: usize,
    /// From 1, in characters.
    pub column: usize,
}

impl Place {
    /// Of a byte offset.
    pub fn of(text: &str, offset: usize) -> Self {
        let before = text.get(..offset).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |i| i + 1);
        Self { line: before.matches('\n').count() + 1, column: before[line_start..].chars().count() + 1 }
    }
}

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
