//! Free space on the disks of the log and of the artifacts. Below one limit a warning is given. Below a lower limit new jobs are
//! refused, so that there is space for the work in progress.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use femc_model::Refusal;
use tokio::time::{Duration, Instant};

use crate::config::{ArtifactStorage, Config, LogStorage};

/// Free space of the disks. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Disks(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    disks: Vec<Disk>,
    /// Free bytes below which new jobs are refused.
    keep_free: u64,
    is_looking: AtomicBool,
}

#[derive(Debug)]
struct Disk {
    /// Data on this disk, for messages.
    content: &'static str,
    /// Watched path on the disk.
    path: PathBuf,
    /// Free bytes; `u64::MAX`: not known.
    free: AtomicU64,
    was_low: AtomicBool,
}

impl Disk {
    fn free(&self) -> Option<u64> {
        Some(self.free.load(Ordering::Relaxed)).filter(|free| *free < u64::MAX)
    }

    fn description(&self) -> String {
        format!("{} ({})", self.content, self.path.display())
    }
}

impl Disks {
    /// Multiple of `keep_free` below which a warning is given.
    const WARNING_FACTOR: u64 = 4;
    /// Interval between two checks.
    pub(crate) const CHECK_INTERVAL: Duration = Duration::from_secs(1);

    pub(crate) fn new(config: &Config) -> Self {
        let log = match &config.log {
            LogStorage::Sqlite(path) => Some(("the log", folder(path))),
            LogStorage::Memory | LogStorage::Postgres { .. } => None,
        };
        let artifacts = match &config.artifacts {
            ArtifactStorage::Folder(path) => Some(("the artifacts", path.clone())),
            ArtifactStorage::Memory | ArtifactStorage::S3(_) => None,
        };
        let disk = |(holds, path)| Disk {
            content: holds,
            path,
            free: AtomicU64::new(u64::MAX),
            was_low: AtomicBool::new(false),
        };
        let disks = log.into_iter().chain(artifacts).map(disk).collect();
        let disks = Self(Arc::new(Inner { disks, keep_free: config.keep_free, is_looking: AtomicBool::new(false) }));
        disks.check();
        disks
    }

    /// Queries the operating system, which may be slow.
    fn check(&self) {
        let Inner { disks, keep_free, .. } = &*self.0;
        for disk in disks {
            let free = femc_metrics::free_disk_bytes(&disk.path).unwrap_or(u64::MAX);
            disk.free.store(free, Ordering::Relaxed);
            let is_low = free < Self::WARNING_FACTOR.saturating_mul(*keep_free);
            match (disk.was_low.swap(is_low, Ordering::Relaxed), is_low) {
                (false, true) => tracing::warn!(place = disk.description(), free, keep_free, "disk space is low"),
                (true, false) => tracing::info!(place = disk.description(), free, "there is enough disk space again"),
                (false, false) | (true, true) => {}
            }
        }
    }

    /// Queries the operating system in the background, at most once per interval.
    pub(crate) fn check_in_background(&self, last: &mut Instant) {
        if self.0.disks.is_empty()
            || last.elapsed() < Self::CHECK_INTERVAL
            || self.0.is_looking.swap(true, Ordering::Relaxed)
        {
            return;
        }
        *last = Instant::now();
        let disks = self.clone();
        tokio::task::spawn_blocking(move || {
            disks.check();
            disks.0.is_looking.store(false, Ordering::Relaxed);
        });
    }

    /// Returns the refusal of new jobs, if space is short.
    pub(crate) fn refusal(&self) -> Option<Refusal> {
        let short = self.0.disks.iter().find_map(|disk| {
            let free = disk.free().filter(|free| *free < self.0.keep_free)?;
            Some((disk.description(), free))
        });
        short.map(|(place, free)| Refusal::NoRoom { place, free })
    }

    /// Returns warnings for users about short space.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let keep = self.0.keep_free;
        let warning = |disk: &Disk| {
            let free = disk.free().filter(|free| *free < Self::WARNING_FACTOR.saturating_mul(keep))?;
            let (mib, place, keep) = (free >> 20, disk.description(), keep >> 20);
            let follows =
                if free >> 20 < keep { "new jobs are refused until" } else { "new jobs will be refused if less than" };
            Some(format!("{mib} MiB are free for {place}; {follows} {keep} MiB are free (`femc gc`)"))
        };
        self.0.disks.iter().filter_map(warning).collect()
    }

    /// Returns the free bytes by the data on each disk.
    pub(crate) fn free(&self) -> Vec<(&'static str, u64)> {
        let label = |holds| if holds == "the log" { "log" } else { "artifacts" };
        self.0.disks.iter().filter_map(|disk| Some((label(disk.content), disk.free()?))).collect()
    }
}

/// Returns the folder of a file.
fn folder(path: &Path) -> PathBuf {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new(".")).to_owned()
}
