//! For tests of the real programs: a process that stands still at a chosen place, so that it can be killed just there.
//!
//! `FEMC_FAULT=POINT:N:FILE` makes the N-th passage of a point write a token, FILE, to disk and wait there for as long as
//! FILE exists. Who sees the token kills or stops the process, cuts its links, or removes the token to let it go on. It is
//! one passage that waits; the process's other threads and tasks go on.
//!
//! `FEMC_DEADLY=TASK` makes a worker die whenever it begins this task.
//!
//! `FEMC_SICK=yes` makes every task of a worker panic.
//!
//! `FEMC_PRETEND=protocol=3,engine=another` makes a worker say that it is of another version, `FEMC_PRETEND=fan=3` a client that
//! a frame's tiles are reduced in threes: see [`pretended`].
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

/// The variable that names the fault.
pub const VARIABLE: &str = "FEMC_FAULT";

/// Between two looks at whether the token is still there.
const LOOK: Duration = Duration::from_millis(2);

/// A passage of `point` on a thread that may block.
pub fn pass(point: Point) {
    if let Some(token) = fires(point) {
        while token.exists() {
            std::thread::sleep(LOOK);
        }
    }
}

/// A passage of `point` in a task; the thread is free meanwhile.
pub async fn pass_async(point: Point) {
    if let Some(token) = fires(point) {
        while token.exists() {
            tokio::time::sleep(LOOK).await;
        }
    }
}

/// A task begins: if it is the one that was named to kill its worker, the process is gone at once.
pub fn dies_of(task: &impl fmt::Display) {
    /// Read at the first task.
    static ASKED: LazyLock<Option<String>> = LazyLock::new(|| std::env::var("FEMC_DEADLY").ok());
    if cfg!(debug_assertions) && ASKED.as_ref().is_some_and(|deadly| *deadly == task.to_string()) {
        std::process::abort();
    }
}

/// A task begins: it panics on a worker that was asked to be sick.
pub fn panics_if_sick() {
    /// Read at the first task.
    static ASKED: LazyLock<bool> = LazyLock::new(|| std::env::var_os("FEMC_SICK").is_some());
    if cfg!(debug_assertions) && *ASKED {
        panic!("every task fails on this worker, as FEMC_SICK asks");
    }
}

/// The token, if this is the passage that was asked for.
fn fires(point: Point) -> Option<&'static Path> {
    /// Read at the first passage.
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

/// Writes the token, durable when this returns.
fn write(token: &Path, point: Point) -> io::Result<()> {
    let new = token.with_extension("new");
    let mut file = File::create_new(&new)?;
    writeln!(file, "{} in process {}", point.name(), std::process::id())?;
    file.sync_all()?;
    fs::rename(&new, token)
}

/// A test that asks for the impossible shall not pass.
fn refuse(message: &str) -> ! {
    eprintln!("{VARIABLE}: {message}");
    std::process::exit(2)
}

#[derive(Debug)]
struct Fault {
    point: Point,
    /// From 1 on.
    passage: u64,
    token: PathBuf,
    passed: AtomicU64,
}

/// Why a text names no fault.
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
