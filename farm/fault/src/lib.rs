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
//! frame's tiles are reduced in threes: see [`pretended`].
//!
//! Builds without debug assertions have none of this.
#![deny(missing_docs)]

mod point;
mod pretense;

use std::fmt;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

pub use point::Point;
pub use pretense::{Pretense, pretended};

/// Name of the environment variable that selects the fault.
pub const VARIABLE: &str = "FEMC_FAULT";

/// Time between two checks whether the token still exists.
const LOOK: Duration = Duration::from_millis(2);

/// Passes `point` on a thread that may block.
pub fn pass(point: Point) {
    if let Some(token) = fires(point) {
        while token.exists() {
            std::thread::sleep(LOOK);
        }
    }
}

/// Passes `point` in an asynchronous task; the thread is free while the task waits.
pub async fn pass_async(point: Point) {
    if let Some(token) = fires(point) {
        while token.exists() {
            tokio::time::sleep(LOOK).await;
        }
    }
}

/// Aborts the process if `FEMC_DEADLY` names this task. Call it when the task begins.
pub fn dies_of(task: &impl fmt::Display) {
    /// Value of `FEMC_DEADLY`, read at the first task.
    static ASKED: LazyLock<Option<String>> = LazyLock::new(|| std::env::var("FEMC_DEADLY").ok());
    if cfg!(debug_assertions) && ASKED.as_ref().is_some_and(|deadly| *deadly == task.to_string()) {
        std::process::abort();
    }
}

/// Panics if `FEMC_SICK` is set. Call it when a task begins.
pub fn panics_if_sick() {
    /// Whether `FEMC_SICK` is set, read at the first task.
    static ASKED: LazyLock<bool> = LazyLock::new(|| std::env::var_os("FEMC_SICK").is_some());
    if cfg!(debug_assertions) && *ASKED {
        panic!("every task fails on this worker, as FEMC_SICK asks");
    }
}

/// Counts a pass of `point`. Writes and returns the token if this is the pass that `FEMC_FAULT` names.
fn fires(point: Point) -> Option<&'static Path> {
    /// Fault of `FEMC_FAULT`, read at the first pass.
    static ASKED: LazyLock<Option<Fault>> = LazyLock::new(Fault::asked);
    if !cfg!(debug_assertions) {
        return None;
    }
    let fault = ASKED.as_ref().filter(|fault| fault.point == point)?;
    let passage = fault.passed.fetch_add(1, Ordering::SeqCst) + 1;
    (passage == fault.passage).then(|| {
        write(&fault.token, point).unwrap_or_else(|error| refuse(&format!("{}: {error}", fault.token.display())));
        &*fault.token
    })
}

/// Writes the token; it is durable when this returns.
fn write(token: &Path, point: Point) -> io::Result<()> {
    let new = token.with_extension("new");
    let mut file = File::create_new(&new)?;
    writeln!(file, "{} in process {}", point.name(), std::process::id())?;
    file.sync_all()?;
    fs::rename(&new, token)
}

/// Ends the process with an error: a test with an invalid fault must not pass.
fn refuse(message: &str) -> ! {
    eprintln!("{VARIABLE}: {message}");
    std::process::exit(2)
}

#[derive(Debug)]
struct Fault {
    point: Point,
    /// Number of the pass that waits, from 1.
    passage: u64,
    token: PathBuf,
    passed: AtomicU64,
}

/// Error for a text that is not a valid fault.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no fault; write POINT:N:FILE, with N from 1")]
struct NoFault(String);

impl Fault {
    fn asked() -> Option<Self> {
        let text = std::env::var(VARIABLE).ok()?;
        Some(text.parse().unwrap_or_else(|error: NoFault| refuse(&error.to_string())))
    }
}

impl FromStr for Fault {
    type Err = NoFault;

    fn from_str(text: &str) -> Result<Self, NoFault> {
        let parse = || {
            let (name, rest) = text.split_once(':')?;
            let (passage, token) = rest.split_once(':')?;
            let passage = passage.parse().ok().filter(|&passage| passage > 0)?;
            let is_named = |point: &Point| point.name() == name;
            let point = Point::ALL.into_iter().find(is_named)?;
            (!token.is_empty()).then(|| Self { point, passage, token: token.into(), passed: AtomicU64::new(0) })
        };
        parse().ok_or_else(|| NoFault(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_a_point_a_passage_and_a_file_and_nothing_else() {
        let fault: Fault = "worker-mid-reduce:3:/tmp/a:b".parse().unwrap();
        assert_eq!((fault.point, fault.passage, fault.token), (Point::WorkerMidReduce, 3, "/tmp/a:b".into()));
        for wrong in ["", "worker-mid-reduce", "worker-mid-reduce:0:a", "worker-mid-reduce:1:", "nowhere:1:a"] {
            assert!(wrong.parse::<Fault>().is_err(), "{wrong}");
        }
    }
}
