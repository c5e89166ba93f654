//! Exit codes that scripts rely on, and failures with one short paragraph of text.

use femc_reports::{ErrorKind, ReportError};
use std::fmt;
use std::process::ExitCode;

/// Exit codes of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Success.
    Done = 0,
    /// The work failed, or a check found a fault.
    Failed = 1,
    /// Wrong usage.
    Usage = 2,
    /// Interrupted; rerun the command to resume.
    Interrupted = 3,
    /// The server could not be reached.
    Unreachable = 4,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// A failed command: its exit code and one short paragraph (problem, location, remedy).
#[derive(Debug)]
pub struct Failure {
    /// Exit code.
    pub exit: Exit,
    /// Problem, location and remedy.
    pub message: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl From<ReportError> for Failure {
    fn from(error: ReportError) -> Self {
        match error.kind() {
            ErrorKind::Usage => usage(error),
            ErrorKind::Execution => failed(error),
        }
    }
}

/// Creates the failure of a command that could not do its work.
pub fn failed(message: impl fmt::Display) -> Failure {
    Failure { exit: Exit::Failed, message: message.to_string() }
}

/// Creates the failure of wrong usage.
pub fn usage(message: impl fmt::Display) -> Failure {
    Failure { exit: Exit::Usage, message: message.to_string() }
}

/// Creates the failure of a command that the user interrupted and can resume.
pub fn interrupted(message: impl fmt::Display) -> Failure {
    Failure { exit: Exit::Interrupted, message: message.to_string() }
}

/// Creates the failure of an unreachable server.
pub fn unreachable(message: impl fmt::Display) -> Failure {
    Failure { exit: Exit::Unreachable, message: message.to_string() }
}
