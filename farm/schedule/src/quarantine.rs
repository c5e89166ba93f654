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
    /// Quarantined until then, once there were too many, while another worker may do the job's tasks.
    until: Option<Tick>,
    /// End of the shorter quarantine that applies while no other worker may do them: a sick machine that is alone must not fail all
    /// tasks of a job within seconds.
    alone_until: Tick,
    /// How often it was quarantined in a row.
    times: u32,
    /// The task that is to prove it well again.
    probe: Option<TaskKey>,
}

impl Record {
    fn left(&self, until: Tick, now: Tick) -> Option<u64> {
        if now < until { Some(until.since(now)) } else { self.probe.map(|_| 0) }
    }
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
            let pause = |first: u64, longest: u64| first.saturating_mul(1 << record.times.min(20)).min(longest);
            record.until = Some(now.after(pause(config.quarantine, config.longest_quarantine)));
            record.alone_until = now.after(pause(config.rest, config.longest_rest));
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

    /// For how many more milliseconds the worker is quarantined while another may do the job's tasks; 0 while its probe runs;
    /// `None`: it is not.
    pub(crate) fn quarantines(&self, worker: Instance, now: Tick) -> Option<u64> {
        let record = self.records.get(&worker)?;
        record.left(record.until?, now)
    }

    /// For how many more milliseconds the worker is quarantined while no other may do the job's tasks; 0 while its probe runs;
    /// `None`: it is not.
    pub(crate) fn quarantines_alone(&self, worker: Instance, now: Tick) -> Option<u64> {
        let record = self.records.get(&worker)?;
        record.until?;
        record.left(record.alone_until, now)
    }
}
