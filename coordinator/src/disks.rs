//! The disks that the log and the artifacts lie on: below one bound of free bytes it is told, below another no new jobs are
//! taken, so that there is room for the work that has begun.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use femc_model::Refusal;
use tokio::time::{Duration, Instant};

use crate::config::{Artifacts, Config, Log};

/// What is free; clones are the same.
#[derive(Debug, Clone)]
pub(crate) struct Disks(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    disks: Vec<Disk>,
    /// With less than these free bytes no new jobs are taken.
    keep_free: u64,
    is_looking: AtomicBool,
}

#[derive(Debug)]
struct Disk {
    /// Data on this disk, as messages name it.
    holds: &'static str,
    /// Path on the disk that is watched.
    path: PathBuf,
    /// `u64::MAX`: nobody knows.
    free: AtomicU64,
    was_low: AtomicBool,
}

impl Disk {
    fn free(&self) -> Option<u64> {
        Some(self.free.load(Ordering::Relaxed)).filter(|free| *free < u64::MAX)
    }

    fn place(&self) -> String {
        format!("{} ({})", self.holds, self.path.display())
    }
}

impl Disks {
    /// It is told from this many times the bytes on that are to stay free.
    const WARN: u64 = 4;
    /// Between two looks.
    pub(crate) const EVERY: Duration = Duration::from_secs(1);

    pub(crate) fn of(config: &Config) -> Self {
        let log = match &config.log {
            Log::Sqlite(path) => Some(("the log", folder(path))),
            Log::Memory | Log::Postgres { .. } => None,
        };
        let artifacts = match &config.artifacts {
            Artifacts::Folder(path) => Some(("the artifacts", path.clone())),
            Artifacts::Memory | Artifacts::S3(_) => None,
        };
        let disk =
            |(holds, path)| Disk { holds, path, free: AtomicU64::new(u64::MAX), was_low: AtomicBool::new(false) };
        let disks = log.into_iter().chain(artifacts).map(disk).collect();
        let disks = Self(Arc::new(Inner { disks, keep_free: config.keep_free, is_looking: AtomicBool::new(false) }));
        disks.look();
        disks
    }

    /// Asks the system, which may take its time.
    fn look(&self) {
        let Inner { disks, keep_free, .. } = &*self.0;
        for disk in disks {
            let free = femc_metrics::free(&disk.path).unwrap_or(u64::MAX);
            disk.free.store(free, Ordering::Relaxed);
            let is_low = free < Self::WARN.saturating_mul(*keep_free);
            match (disk.was_low.swap(is_low, Ordering::Relaxed), is_low) {
                (false, true) => tracing::warn!(place = disk.place(), free, keep_free, "little room is left"),
                (true, false) => tracing::info!(place = disk.place(), free, "there is room again"),
                (false, false) | (true, true) => {}
            }
        }
    }

    /// Asks the system behind everybody's back, now and then.
    pub(crate) fn look_later(&self, last: &mut Instant) {
        if self.0.disks.is_empty() || last.elapsed() < Self::EVERY || self.0.is_looking.swap(true, Ordering::Relaxed) {
            return;
        }
        *last = Instant::now();
        let disks = self.clone();
        tokio::task::spawn_blocking(move || {
            disks.look();
            disks.0.is_looking.store(false, Ordering::Relaxed);
        });
    }

    /// Why no new jobs are taken.
    pub(crate) fn refusal(&self) -> Option<Refusal> {
        let short = self.0.disks.iter().find_map(|disk| {
            let free = disk.free().filter(|free| *free < self.0.keep_free)?;
            Some((disk.place(), free))
        });
        short.map(|(place, free)| Refusal::NoRoom { place, free })
    }

    /// What somebody should look after.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let keep = self.0.keep_free;
        let warning = |disk: &Disk| {
            let free = disk.free().filter(|free| *free < Self::WARN.saturating_mul(keep))?;
            let (mib, place, keep) = (free >> 20, disk.place(), keep >> 20);
            let follows =
                if free >> 20 < keep { "no new jobs are taken until" } else { "no new jobs will be taken if not" };
            Some(format!("{mib} MiB are left for {place}; {follows} {keep} MiB are free (`femc gc`)"))
        };
        self.0.disks.iter().filter_map(warning).collect()
    }

    /// What is free, by what lies there.
    pub(crate) fn free(&self) -> Vec<(&'static str, u64)> {
        let label = |holds| if holds == "the log" { "log" } else { "artifacts" };
        self.0.disks.iter().filter_map(|disk| Some((label(disk.holds), disk.free()?))).collect()
    }
}

/// The folder of a file.
fn folder(path: &Path) -> PathBuf {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new(".")).to_owned()
}
