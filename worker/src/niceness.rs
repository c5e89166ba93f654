//! Priority of the threads that compute: other programs on the machine go first. The threads that communicate keep their priority,
//! so that a busy machine costs a worker speed, not its leases.

use crate::WorkerError;

/// Niceness that compute threads apply to themselves when they start.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Niceness(Option<u8>);

impl Niceness {
    /// Creates a niceness after a trial on a short-lived thread.
    pub(crate) fn try_new(niceness: Option<u8>) -> Result<Self, WorkerError> {
        if let Some(niceness) = niceness {
            let tried = std::thread::spawn(move || set_niceness(niceness)).join();
            let outcome = tried.unwrap_or_else(|_| Err("the thread panicked".into()));
            outcome.map_err(|message| WorkerError::Nice { niceness, message })?;
        }
        Ok(Self(niceness))
    }

    /// Applies the niceness to the calling thread and the threads that it starts.
    pub(crate) fn apply(self) {
        if let Some(Err(error)) = self.0.map(set_niceness) {
            tracing::warn!(%error, "cannot lower the priority of a thread");
        }
    }
}

/// Gives the calling thread this niceness, 0 to 19. Threads that it starts inherit it. On systems other than Linux it applies to
/// the whole process.
#[cfg(unix)]
pub(crate) fn set_niceness(niceness: u8) -> Result<(), String> {
    rustix::process::setpriority_process(None, niceness.into()).map_err(|error| error.to_string())
}

/// Fails: this system has no niceness.
#[cfg(not(unix))]
pub(crate) fn set_niceness(_niceness: u8) -> Result<(), String> {
    Err("not supported on this system".into())
}
