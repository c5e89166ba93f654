//! Quarantine of workers on which tasks of one job keep failing: they get no task of the job for a while, then one task as a probe.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{TaskKey, Tick};

use crate::Config;

/// Number of a worker's process, independent of its session.
pub(crate) type Instance = u64;

#[derive(Debug, Clone, Default)]
struct WorkerRecord {
    /// Different tasks that failed there without a success in between.
    tasks: BTreeSet<TaskKey>,
    /// End of the quarantine, once it was imposed, while another worker may do the job's tasks.
    until: Option<Tick>,
    /// End of the shorter quarantine that applies while no other worker may do them: a broken machine that is alone must not fail
    /// all tasks of a job within seconds.
    alone_until: Tick,
    /// Number of quarantines in a row.
    count: u32,
    /// Task that tests whether the worker works again.
    probe: Option<TaskKey>,
}

impl WorkerRecord {
    fn remaining(&self, until: Tick, now: Tick) -> Option<u64> {
        if now < until { Some(until.since(now)) } else { self.probe.map(|_| 0) }
    }
}

/// Quarantine records of one job's workers. A restart discards them.
#[derive(Debug, Clone, Default)]
pub(crate) struct WorkerQuarantine {
    records: BTreeMap<Instance, WorkerRecord>,
}

impl WorkerQuarantine {
    /// Number of different failed tasks that quarantine a worker.
    const FAILED_TASKS: usize = 3;

    /// Counts a failed attempt of a task on this worker.
    pub(crate) fn record_failure(&mut self, worker: Instance, task: TaskKey, config: &Config, now: Tick) {
        let record = self.records.entry(worker).or_default();
        record.tasks.insert(task);
        let failed_probe = record.probe.take().is_some();
        if failed_probe || (record.until.is_none() && record.tasks.len() >= Self::FAILED_TASKS) {
            let duration = |first: u64, longest: u64| first.saturating_mul(1 << record.count.min(20)).min(longest);
            record.until = Some(now.after(duration(config.quarantine, config.max_quarantine)));
            record.alone_until = now.after(duration(config.back_off, config.max_back_off));
            record.count += 1;
        }
    }

    /// Removes a worker's record, because a task succeeded there.
    pub(crate) fn record_success(&mut self, worker: Instance) {
        self.records.remove(&worker);
    }

    /// Notes a lease to the worker; if the worker is in doubt, it is its probe.
    pub(crate) fn record_grant(&mut self, worker: Instance, task: TaskKey) {
        if let Some(record) = self.records.get_mut(&worker).filter(|record| record.until.is_some()) {
            record.probe = Some(task);
        }
    }

    /// Notes that a lease ended without a verdict on the worker.
    pub(crate) fn record_release(&mut self, task: &TaskKey) {
        for record in self.records.values_mut().filter(|record| record.probe == Some(*task)) {
            record.probe = None;
        }
    }

    /// Checks whether the worker was quarantined and has not succeeded since.
    pub(crate) fn is_suspect(&self, worker: Instance) -> bool {
        self.records.get(&worker).is_some_and(|record| record.until.is_some())
    }

    /// Returns the remaining milliseconds of the worker's quarantine that applies while another worker may do the job's tasks; 0
    /// while its probe runs; `None`: it is not quarantined.
    pub(crate) fn remaining(&self, worker: Instance, now: Tick) -> Option<u64> {
        let record = self.records.get(&worker)?;
        record.remaining(record.until?, now)
    }

    /// Returns the remaining milliseconds of the worker's quarantine that applies while no other worker may do the job's tasks; 0
    /// while its probe runs; `None`: it is not quarantined.
    pub(crate) fn remaining_alone(&self, worker: Instance, now: Tick) -> Option<u64> {
        let record = self.records.get(&worker)?;
        record.until?;
        record.remaining(record.alone_until, now)
    }
}
