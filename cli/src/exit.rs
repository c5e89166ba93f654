//! How a command ends: the exit codes that scripts rely on, and the one short paragraph that goes with a failure.

use femc_reports::{Blame, ReportError};
use std::fmt;
use std::process::ExitCode;

/// The exit codes of the contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Done.
    Done = 0,
    /// The work failed, or a check found a fault.
    Failed = 1,
    /// Wrong usage.
    Usage = 2,
    /// Interrupted; the same command goes on where this one stopped.
    Interrupted = 3,
    /// The server could not be reached.
    Unreachable = 4,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// A failed command: its exit code and one short paragraph (what, where, what to do).
#[derive(Debug)]
pub struct Failure {
    /// Exit code.
    pub exit: Exit,
    /// What, where, what to do.
    pub message: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl From<ReportError> for Failure {
    fn from(error: ReportError) -> Self {
        match error.blame() {
            Blame::Usage => usage(error),
            Blame::Work => failed(error),
        }
    }
}

/// The work failed.
pub fn failed(message: impl fmt::Display) -> Failure {
    Failure { exit: Exit::Failed, message: message.to_string() }
}

/// Wrong usage.
pub fn usage(message: impl fmt::Display) -> Failure {
    Failure { exit: Exit::Usage, message: message.to_string() }
}

/// Interrupted by the user; can be resumed.
pub fn interrupted(message: impl fmt::Display) -> Failure {
    Failure { exit: Exit::Interrupted, message: message.to_string() }
}

/// The server cannot be reached.
pub fn unreachable(message: impl fmt::Display) -> Failure {
    Failure { exit: Exit::Unreachable, message: message.to_string() }
}
