//! Health and metrics of a process, as its metrics page reports them.

/// Health of a process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Health {
    /// The process works.
    Ready,
    /// The process works, but refuses some requests.
    Degraded {
        /// Refused service, and the reason.
        message: String,
    },
    /// The process is healthy and waits for something, like a standby.
    Waiting {
        /// Reason for the wait.
        message: String,
    },
    /// The process does not work and must be restarted.
    Broken {
        /// Part that fails, and its error.
        message: String,
    },
}

/// Health and metrics of a process.
#[derive(Debug)]
pub struct ProcessReport {
    /// Health of the process.
    pub health: Health,
    /// Page of metrics.
    pub page: String,
}
