//! Quarantine of workers on which tasks of one job keep failing: they get no task of the job for a while, then one task as a probe.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{TaskKey, Tick};

use crate::Config;

/// Number of a worker's process, independent of its session.
pub(crate) type Instance = u64;

#[derive(Debug, Clone, Default)]
struct Record {
    /// Different tasks that failed there without a success in between.
    tasks: BTreeSet<TaskKey>,
    /// End of the quarantine, once it was imposed, while another worker may do the job's tasks.
    until: Option<Tick>,
    /// End of the shorter quarantine that applies while no other worker may do them: a broken machine that is alone must not fail
    /// all tasks of a job within seconds.
    alone_until: Tick,
    /// Number of quarantines in a row.
    times: u32,
    /// Task that tests whether the worker works again.
    probe: Option<TaskKey>,
}

impl Record {
    fn left(&self, until: Tick, now: Tick) -> Option<u64> {
        if now < until { Some(until.since(now)) } else { self.probe.map(|_| 0) }
    }
}

/// Quarantine records of one job's workers. A restart discards them.
#[derive(Debug, Clone, Default)]
pub(crate) struct WorkerQuarantine {
    records: BTreeMap<Instance, Record>,
}

impl WorkerQuarantine {
    /// Number of different failed tasks that quarantine a worker.
    const TASKS: usize = 3;

    /// Counts a failed attempt of a task on this worker.
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

    /// Removes a worker's record, because a task succeeded there.
    pub(crate) fn succeeded(&mut self, worker: Instance) {
        self.records.remove(&worker);
    }

    /// Notes a lease to the worker; if the worker is in doubt, it is its probe.
    pub(crate) fn granted(&mut self, worker: Instance, task: TaskKey) {
        if let Some(record) = self.records.get_mut(&worker).filter(|record| record.until.is_some()) {
            record.probe = Some(task);
        }
    }

    /// Notes that a lease ended without a verdict on the worker.
    pub(crate) fn released(&mut self, task: &TaskKey) {
        for record in self.records.values_mut().filter(|record| record.probe == Some(*task)) {
            record.probe = None;
        }
    }

    /// Checks whether the worker was quarantined and has not succeeded since.
    pub(crate) fn is_in_doubt(&self, worker: Instance) -> bool {
        self.records.get(&worker).is_some_and(|record| record.until.is_some())
    }

    /// Returns the remaining milliseconds of the worker's quarantine that applies while another worker may do the job's tasks; 0
    /// while its probe runs; `None`: it is not quarantined.
    pub(crate) fn quarantines(&self, worker: Instance, now: Tick) -> Option<u64> {
        let record = self.records.get(&worker)?;
        record.left(record.until?, now)
    }

    /// Returns the remaining milliseconds of the worker's quarantine that applies while no other worker may do the job's tasks; 0
    /// while its probe runs; `None`: it is not quarantined.
    pub(crate) fn quarantines_alone(&self, worker: Instance, now: Tick) -> Option<u64> {
        let record = self.records.get(&worker)?;
        record.until?;
        record.left(record.alone_until, now)
    }
}
