//! A spinner for work of unknown length, such as the pilot of a job.

use super::Printer;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Interval between two lines if stderr is not a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(5);
/// Interval between two states of the spinner.
const TICK: Duration = Duration::from_millis(100);

/// Display of the current work and its duration on stderr, until dropped: a spinner on a terminal, else a line every few seconds;
/// nothing with `--quiet`.
#[derive(Debug)]
pub struct BusyIndicator(Form);

#[derive(Debug)]
enum Form {
    Silent,
    Spinner(ProgressBar),
    Lines { done: Sender<()>, lines: Option<JoinHandle<()>> },
}

impl BusyIndicator {
    /// Starts the display.
    /// - `work`: description of the work, like "a pilot compares the methods".
    pub fn new(printer: Printer, work: &'static str) -> Self {
        if printer.quiet() {
            return Self(Form::Silent);
        }
        if io::stderr().is_terminal() {
            let spinner = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()).with_message(work);
            let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}");
            spinner.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
            spinner.enable_steady_tick(TICK);
            return Self(Form::Spinner(spinner));
        }
        let (done, ended) = channel::<()>();
        let begun = Instant::now();
        let tell = move || {
            while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(LINE_INTERVAL) {
                printer.note(format!("{work}, {} s", begun.elapsed().as_secs()));
            }
        };
        // If the thread cannot be started there are no lines, and the work continues.
        let lines = std::thread::Builder::new().name("busy".to_owned()).spawn(tell).ok();
        Self(Form::Lines { done, lines })
    }
}

impl Drop for BusyIndicator {
    fn drop(&mut self) {
        match &mut self.0 {
            Form::Silent => {}
            Form::Spinner(spinner) => spinner.finish_and_clear(),
            Form::Lines { done, lines } => {
                let _ = done.send(());
                if let Some(lines) = lines.take() {
                    let _ = lines.join();
                }
            }
        }
    }
}
