//! The priority of the threads that compute: others of the machine go first. The threads that talk keep theirs, so that a
//! busy machine costs a worker speed and not its leases.

use crate::WorkerError;

/// What the threads that compute apply to themselves when they start.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Nice(Option<u8>);

impl Nice {
    /// A niceness, tried on a thread that ends at once.
    pub(crate) fn tried(niceness: Option<u8>) -> Result<Self, WorkerError> {
        if let Some(niceness) = niceness {
            let tried = std::thread::spawn(move || lower(niceness)).join();
            let outcome = tried.unwrap_or_else(|_| Err("the thread panicked".into()));
            outcome.map_err(|message| WorkerError::Nice { niceness, message })?;
        }
        Ok(Self(niceness))
    }

    /// For the calling thread, and those that it starts.
    pub(crate) fn apply(self) {
        if let Some(Err(error)) = self.0.map(lower) {
            tracing::warn!(%error, "a thread keeps its priority");
        }
    }
}

/// Gives the calling thread this niceness, 0 to 19; threads that it starts have it too. On systems other than Linux it is the
/// whole process's.
#[cfg(unix)]
pub(crate) fn lower(niceness: u8) -> Result<(), String> {
    rustix::process::setpriority_process(None, niceness.into()).map_err(|error| error.to_string())
}

/// Says that there is no niceness here.
#[cfg(not(unix))]
pub(crate) fn lower(_niceness: u8) -> Result<(), String> {
    Err("this system has none".into())
}
