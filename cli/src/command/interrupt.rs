//! Ctrl-C and SIGTERM: the first signal requests a graceful stop, the second ends the process at once.

use crate::exit::{Exit, Failure, failed};
use tokio::sync::watch;

/// Whether the user asked to stop.
#[derive(Clone, Debug)]
pub struct Interrupt {
    stopped: watch::Receiver<bool>,
}

impl Interrupt {
    /// Starts listening for signals. Must be called in a tokio runtime.
    pub fn listen() -> Result<Self, Failure> {
        let (sender, stopped) = watch::channel(false);
        let mut signals = Signals::new().map_err(|e| failed(format!("cannot listen for signals: {e}")))?;
        tokio::spawn(async move {
            signals.next().await;
            // The receiver is gone if the command is about to end.
            let _ = sender.send(true);
            signals.next().await;
            std::process::exit(Exit::Interrupted as i32);
        });
        Ok(Self { stopped })
    }

    /// Returns when the user has asked to stop; at once if that happened before the call.
    pub async fn wait(&mut self) {
        // An error means that the sender is gone, which happens only at the end of the runtime.
        let _ = self.stopped.wait_for(|&stopped| stopped).await;
    }
}

#[cfg(unix)]
struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn new() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) {
        let _ = tokio::signal::ctrl_c().await;
    }
}
