//! Workers on which tasks of one job keep failing: they get no more of it for a while, then one task to prove themselves.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{TaskKey, Tick};

use crate::Config;

/// A worker's process, whatever its session.
pub(crate) type Instance = u64;

#[derive(Debug, Clone, Default)]
struct Record {
    /// Different tasks that failed there, none done in between.
    tasks: BTreeSet<TaskKey>,
    /// Quarantined until then, once there were too many.
    until: Option<Tick>,
    /// How often it was quarantined in a row.
    times: u32,
    /// The task that is to prove it well again.
    probe: Option<TaskKey>,
}

/// What one job has seen of its workers. Forgotten at a restart.
#[derive(Debug, Clone, Default)]
pub(crate) struct WorkerQuarantine {
    records: BTreeMap<Instance, Record>,
}

impl WorkerQuarantine {
    /// Different tasks that fail on a worker before it is quarantined.
    const TASKS: usize = 3;

    /// A task failed there by its own fault, as far as one can tell.
    pub(crate) fn failed(&mut self, worker: Instance, task: TaskKey, config: &Config, now: Tick) {
        let record = self.records.entry(worker).or_default();
        record.tasks.insert(task);
        let has_failed_its_probe = record.probe.take().is_some();
        if has_failed_its_probe || (record.until.is_none() && record.tasks.len() >= Self::TASKS) {
            let pause = config.quarantine.saturating_mul(1 << record.times.min(20)).min(config.longest_quarantine);
            record.until = Some(now.after(pause));
            record.times += 1;
        }
    }

    /// A task was done there: all is forgiven.
    pub(crate) fn succeeded(&mut self, worker: Instance) {
        self.records.remove(&worker);
    }

    /// A task is leased there.
    pub(crate) fn granted(&mut self, worker: Instance, task: TaskKey) {
        if let Some(record) = self.records.get_mut(&worker).filter(|record| record.until.is_some()) {
            record.probe = Some(task);
        }
    }

    /// A lease ended without a verdict on the worker.
    pub(crate) fn released(&mut self, task: &TaskKey) {
        for record in self.records.values_mut().filter(|record| record.probe == Some(*task)) {
            record.probe = None;
        }
    }

    /// Whether it was quarantined and has not proved itself since.
    pub(crate) fn is_in_doubt(&self, worker: Instance) -> bool {
        self.records.get(&worker).is_some_and(|record| record.until.is_some())
    }

    /// For how many more milliseconds the worker is quarantined; 0 while its one task of proof is under way; `None`: it is not.
    pub(crate) fn quarantines(&self, worker: Instance, now: Tick) -> Option<u64> {
        let record = self.records.get(&worker)?;
        let until = record.until?;
        if now < until { Some(until.since(now)) } else { record.probe.map(|_| 0) }
    }
}
