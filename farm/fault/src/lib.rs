//! Fault injection for tests of the real programs: a process stops at a chosen point, so that a test can kill it there.
//!
//! `FEMC_FAULT=POINT:N:FILE` makes the N-th pass of a point write a token, FILE, to disk and wait there until FILE is removed. A
//! test that sees the token kills or stops the process, cuts its links, or removes the token to let the process resume. Only that
//! pass waits; the process's other threads and tasks keep running.
//!
//! `FEMC_DEADLY=TASK` makes a worker die whenever it begins this task.
//!
//! `FEMC_SICK=yes` makes every task of a worker panic.
//!
//! `FEMC_PRETEND=protocol=3,engine=another` makes a worker report another version. `FEMC_PRETEND=fan=3` makes a client plan that a
//! frame's tiles are reduced in threes: see [`pretended_value`].
//!
//! Builds without debug assertions have none of this.
#![deny(missing_docs)]

mod point;
mod pretended;

use std::fmt;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

pub use point::Point;
pub use pretended::{PretendedValue, pretended_value};

/// Name of the environment variable that selects the fault.
pub const VARIABLE: &str = "FEMC_FAULT";

/// Time between two checks whether the token still exists.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

/// Passes `point` on a thread that may block.
pub fn pass_point(point: Point) {
    if let Some(token) = token_if_due(point) {
        while token.exists() {
            std::thread::sleep(POLL_INTERVAL);
        }
    }
}

/// Passes `point` in an asynchronous task; the thread is free while the task waits.
pub async fn pass_point_async(point: Point) {
    if let Some(token) = token_if_due(point) {
        while token.exists() {
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }
}

/// Aborts the process if `FEMC_DEADLY` names this task. Call it when the task begins.
pub fn abort_if_deadly(task: &impl fmt::Display) {
    /// Value of `FEMC_DEADLY`, read at the first task.
    static DEADLY_TASK: LazyLock<Option<String>> = LazyLock::new(|| std::env::var("FEMC_DEADLY").ok());
    if cfg!(debug_assertions) && DEADLY_TASK.as_ref().is_some_and(|deadly| *deadly == task.to_string()) {
        std::process::abort();
    }
}

/// Panics if `FEMC_SICK` is set. Call it when a task begins.
pub fn panic_if_sick() {
    /// Whether `FEMC_SICK` is set, read at the first task.
    static IS_SICK: LazyLock<bool> = LazyLock::new(|| std::env::var_os("FEMC_SICK").is_some());
    if cfg!(debug_assertions) && *IS_SICK {
        panic!("every task fails on this worker, as FEMC_SICK asks");
    }
}

/// Counts a pass of `point`. Writes and returns the token if this is the pass that `FEMC_FAULT` names.
fn token_if_due(point: Point) -> Option<&'static Path> {
    /// Fault of `FEMC_FAULT`, read at the first pass.
    static FAULT: LazyLock<Option<Fault>> = LazyLock::new(Fault::from_env);
    if !cfg!(debug_assertions) {
        return None;
    }
    let fault = FAULT.as_ref().filter(|fault| fault.point == point)?;
    let pass = fault.pass_count.fetch_add(1, Ordering::SeqCst) + 1;
    (pass == fault.waiting_pass).then(|| {
        write_token(&fault.token, point)
            .unwrap_or_else(|error| exit_with_error(&format!("{}: {error}", fault.token.display())));
        &*fault.token
    })
}

/// Writes the token; it is durable when this returns.
fn write_token(token: &Path, point: Point) -> io::Result<()> {
    let new = token.with_extension("new");
    let mut file = File::create_new(&new)?;
    writeln!(file, "{} in process {}", point.name(), std::process::id())?;
    file.sync_all()?;
    fs::rename(&new, token)
}

/// Ends the process with an error: a test with an invalid fault must not pass.
fn exit_with_error(message: &str) -> ! {
    eprintln!("{VARIABLE}: {message}");
    std::process::exit(2)
}

#[derive(Debug)]
struct Fault {
    point: Point,
    /// Number of the pass that waits, from 1.
    waiting_pass: u64,
    token: PathBuf,
    pass_count: AtomicU64,
}

/// Error for a text that is not a valid fault.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no fault; write POINT:N:FILE, with N from 1")]
struct ParseFaultError(String);

impl Fault {
    fn from_env() -> Option<Self> {
        let text = std::env::var(VARIABLE).ok()?;
        Some(text.parse().unwrap_or_else(|error: ParseFaultError| exit_with_error(&error.to_string())))
    }
}

impl FromStr for Fault {
    type Err = ParseFaultError;

    fn from_str(text: &str) -> Result<Self, ParseFaultError> {
        let parse = || {
            let (name, rest) = text.split_once(':')?;
            let (passage, token) = rest.split_once(':')?;
            let passage = passage.parse().ok().filter(|&passage| passage > 0)?;
            let is_named = |point: &Point| point.name() == name;
            let point = Point::ALL.into_iter().find(is_named)?;
            (!token.is_empty()).then(|| Self {
                point,
                waiting_pass: passage,
                token: token.into(),
                pass_count: AtomicU64::new(0),
            })
        };
        parse().ok_or_else(|| ParseFaultError(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_a_point_a_passage_and_a_file_and_nothing_else() {
        let fault: Fault = "worker-mid-reduce:3:/tmp/a:b".parse().unwrap();
        assert_eq!((fault.point, fault.waiting_pass, fault.token), (Point::WorkerMidReduce, 3, "/tmp/a:b".into()));
        for wrong in ["", "worker-mid-reduce", "worker-mid-reduce:0:a", "worker-mid-reduce:1:", "nowhere:1:a"] {
            assert!(wrong.parse::<Fault>().is_err(), "{wrong}");
        }
    }
}
