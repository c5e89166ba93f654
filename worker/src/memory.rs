//! Memory limit of a worker. A worker above the limit clears its caches or gives the task back.
//!
//! Before a task begins, the worker adds its resident size and the largest growth so far by a task of this kind. The sum must fit
//! under the limit. If it does not, the worker clears its cached scenes and frames, except those that a running task uses. If it
//! still does not fit, the worker gives the task back for lack of resources, and the coordinator lets the worker rest. The estimate
//! for the first task of a kind is zero: the limit keeps a worker from growing further, but it cannot keep one task from being too
//! large.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use femc_model::{Affinity, Failure, StageKind};

use crate::Cache;

/// A limit of resident memory, with the function that measures the resident size.
#[derive(Clone)]
pub struct MemoryLimit {
    bytes: u64,
    resident: Arc<dyn Fn() -> Option<u64> + Send + Sync>,
}

impl fmt::Debug for MemoryLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MemoryLimit({} bytes)", self.bytes)
    }
}

impl MemoryLimit {
    /// Creates a limit of `bytes` for this process; `None` if the system does not report a process's size.
    pub fn for_process(bytes: u64) -> Option<Self> {
        resident()?;
        Some(Self { bytes, resident: Arc::new(resident) })
    }
}

/// Returns the resident size of this process in bytes, if the system reports it.
fn resident() -> Option<u64> {
    kilobytes("VmRSS:")
}

/// Returns the peak resident size of this process since [`reset_peak`] in bytes, if the system reports it.
pub(crate) fn peak() -> Option<u64> {
    kilobytes("VmHWM:")
}

/// Resets the peak where the system can. Otherwise [`peak`] counts from the start of the process.
pub(crate) fn reset_peak() {
    // 5 is the kernel's code for resetting the peak.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Returns the bytes that the system has left for this process, if it reports them: the smaller of what the machine and what the
/// control group has left.
fn available() -> Option<u64> {
    let of_group = |name: &str| -> Option<u64> {
        std::fs::read_to_string(format!("/sys/fs/cgroup/memory.{name}")).ok()?.trim().parse().ok()
    };
    // The group's use includes cached files, which the kernel drops when memory is needed.
    let files = std::fs::read_to_string("/sys/fs/cgroup/memory.stat")
        .ok()
        .and_then(|text| text.lines().find_map(|line| line.strip_prefix("inactive_file "))?.trim().parse::<u64>().ok());
    let used = of_group("current").map(|now| now.saturating_sub(files.unwrap_or(0)));
    let group = of_group("max").zip(used).map(|(most, used)| most.saturating_sub(used));
    [kilobytes_of("/proc/meminfo", "MemAvailable:"), group].into_iter().flatten().min()
}

fn kilobytes(field: &str) -> Option<u64> {
    kilobytes_of("/proc/self/status", field)
}

fn kilobytes_of(file: &str, field: &str) -> Option<u64> {
    let status = std::fs::read_to_string(file).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kilobytes| kilobytes << 10)
}

/// Enforces the limit; does nothing without one.
#[derive(Debug, Clone, Default)]
pub(crate) struct MemoryGuard(Option<Arc<Watch>>);

#[derive(Debug)]
struct Watch {
    limit: MemoryLimit,
    /// Largest growth so far by a task of each kind, bytes.
    largest: [AtomicU64; StageKind::ALL.len()],
}

/// A running task whose growth is measured.
pub(crate) struct GrowthMeasurement {
    watch: Option<(Arc<Watch>, usize)>,
    before: u64,
}

impl MemoryGuard {
    pub(crate) fn new(limit: Option<MemoryLimit>) -> Self {
        Self(limit.map(|limit| Arc::new(Watch { limit, largest: Default::default() })))
    }

    /// Makes room for a task. Call [`GrowthMeasurement::finish`] on the returned value when the task is done.
    pub(crate) fn admit(&self, kind: StageKind, cache: &Cache) -> Result<GrowthMeasurement, Failure> {
        let Some(watch) = &self.0 else { return Ok(GrowthMeasurement { watch: None, before: 0 }) };
        let kind = kind.index();
        let estimate = watch.largest[kind].load(Ordering::Relaxed);
        let fits = |resident: u64| resident.saturating_add(estimate) <= watch.limit.bytes;
        if !fits(watch.resident()) {
            tracing::info!("memory limit reached: clearing cached scenes and frames");
            cache.clear();
            let resident = watch.resident();
            if !fits(resident) {
                let mega = |bytes: u64| bytes.div_ceil(1 << 20);
                return Err(Failure::Resources {
                    message: format!(
                        "{} MiB are in use and the task may need {} MiB more; the worker's limit is {} MiB (--memory)",
                        mega(resident),
                        mega(estimate),
                        mega(watch.limit.bytes)
                    ),
                });
            }
        }
        Ok(GrowthMeasurement { watch: Some((watch.clone(), kind)), before: watch.resident() })
    }

    /// Fails if something needs more memory than there is, because the system would kill the worker in the middle of it.
    /// - `needed`: lower bound of the bytes needed.
    /// - `what`: its name for the message.
    pub(crate) fn check_room(&self, needed: u64, what: &str) -> Result<(), Failure> {
        let (room, who) = match &self.0 {
            Some(watch) => {
                (Some(watch.limit.bytes.saturating_sub(watch.resident())), "the worker's limit (--memory) leaves")
            }
            None => (available(), "this machine has only"),
        };
        let mega = |bytes: u64| bytes.div_ceil(1 << 20);
        match room {
            Some(room) if needed > room => Err(Failure::Resources {
                message: format!("{what} needs at least {} MiB, but {who} {} MiB", mega(needed), mega(room)),
            }),
            _ => Ok(()),
        }
    }

    /// Checks that there is room to prepare something that is not needed yet.
    pub(crate) fn has_room_ahead(&self) -> bool {
        let fits = |watch: &Arc<Watch>| {
            let kinds = StageKind::ALL.into_iter().filter(|kind| kind.properties().affinity == Affinity::Frame);
            let estimate = kinds.map(|kind| watch.largest[kind.index()].load(Ordering::Relaxed)).max();
            watch.resident().saturating_add(estimate.unwrap_or(0)) <= watch.limit.bytes
        };
        self.0.as_ref().is_none_or(fits)
    }
}

impl Watch {
    fn resident(&self) -> u64 {
        (self.limit.resident)().unwrap_or(0)
    }
}

impl GrowthMeasurement {
    /// Records the growth at the end of the task. Call it while the task's result still exists.
    pub(crate) fn finish(self) {
        if let Some((watch, kind)) = self.watch {
            let added = watch.resident().saturating_sub(self.before);
            watch.largest[kind].fetch_max(added, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a limit of 100 MiB, and the simulated size of the process in MiB.
    fn memory() -> (MemoryGuard, Arc<AtomicU64>) {
        let size = Arc::new(AtomicU64::new(0));
        let seen = size.clone();
        let resident = Arc::new(move || Some(seen.load(Ordering::Relaxed) << 20));
        (MemoryGuard::new(Some(MemoryLimit { bytes: 100 << 20, resident })), size)
    }

    #[test]
    fn a_task_begins_where_the_largest_of_its_kind_so_far_would_fit() {
        let ((memory, size), cache) = (memory(), Cache::default());
        let set = |megabytes| size.store(megabytes, Ordering::Relaxed);
        set(60);
        let first = memory.admit(StageKind::Render, &cache).unwrap();
        set(95);
        first.finish();
        let refused = memory.admit(StageKind::Render, &cache).err();
        assert!(
            matches!(&refused, Some(Failure::Resources { message }) if message.contains("95 MiB") && message.contains("35 MiB")),
            "{refused:?}"
        );
        assert!(!memory.has_room_ahead());
        assert!(memory.admit(StageKind::Image, &cache).is_ok(), "images have added nothing so far");
        set(65);
        assert!(memory.admit(StageKind::Render, &cache).is_ok() && memory.has_room_ahead());
        set(101);
        assert!(memory.admit(StageKind::Image, &cache).is_err(), "above the limit nothing begins");
    }

    #[test]
    fn what_takes_more_than_there_is_is_refused_before_it_begins() {
        let (memory, size) = memory();
        size.store(60, Ordering::Relaxed);
        assert!(memory.check_room(40 << 20, "it").is_ok());
        let refused = memory.check_room((40 << 20) + 1, "a first pass").err();
        assert!(
            matches!(&refused, Some(Failure::Resources { message })
                if message == "a first pass needs at least 41 MiB, but the worker's limit (--memory) leaves 40 MiB"),
            "{refused:?}"
        );
        let memory = MemoryGuard::default();
        assert!(memory.check_room(1, "it").is_ok());
        if cfg!(target_os = "linux") {
            assert!(
                memory
                    .check_room(1 << 60, "it")
                    .is_err_and(|error| error.to_string().contains("this machine has only"))
            );
        }
    }

    #[test]
    fn a_task_begins_when_letting_go_of_the_caches_has_made_room() {
        // The cache holds all the memory that is in use.
        let cache = Cache::default();
        cache.insert_unread_scene();
        let held = cache.clone();
        let resident = Arc::new(move || Some(if held.is_empty() { 10 << 20 } else { 200 << 20 }));
        let memory = MemoryGuard::new(Some(MemoryLimit { bytes: 100 << 20, resident }));
        assert!(!memory.has_room_ahead() && !cache.is_empty());
        assert!(memory.admit(StageKind::Render, &cache).is_ok());
        assert!(cache.is_empty() && memory.has_room_ahead());
    }

    #[test]
    fn tasks_begin_without_memory_limit_and_process_size_is_known() {
        let memory = MemoryGuard::default();
        assert!(memory.admit(StageKind::Render, &Cache::default()).is_ok() && memory.has_room_ahead());
        if cfg!(target_os = "linux") {
            assert!(resident().unwrap() > 1 << 20 && peak().unwrap() >= resident().unwrap() / 2);
        }
    }
}
