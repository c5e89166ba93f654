//! Usage by owner and month, for accounting. It is independent of the order of service, whose figures only serve fairness.
//!
//! Sums become durable every few seconds ([`Scheduler::CHARGE_INTERVAL`]): a killed coordinator loses no more than that.

use std::collections::BTreeMap;

use femc_model::{Month, OwnerUsage, ResourceUsage, TaskKey, Tick, UsageSums};

use crate::ledger::Job;
use crate::scheduler::Scheduler;
use crate::{Command, Fact};

/// Usage that is not durable yet.
#[derive(Debug, Clone, Default)]
pub(crate) struct Meter {
    month: Option<Month>,
    owners: BTreeMap<String, UsageSums>,
}

impl Meter {
    /// Adds to an owner's usage in this month.
    pub(crate) fn add(&mut self, owner: &str, sums: UsageSums) {
        if self.month.is_none() {
            return;
        }
        match self.owners.get_mut(owner) {
            Some(known) => *known = known.plus(sums),
            None => drop(self.owners.insert(owner.to_owned(), sums)),
        }
    }
}

impl Scheduler {
    /// Begins a month; usage up to now belongs to the previous month.
    pub(crate) fn begin_month(&mut self, month: Month, now: Tick, out: &mut Vec<Command>) {
        if self.meter.month == Some(month) {
            return;
        }
        self.record_charges(now, out);
        self.record_usage(now, out);
        self.meter.month = Some(month);
    }

    /// Adds the processor time of an attempt to the usage of the job's owner. The time of a shared job is divided among the owners
    /// whose jobs wait for it, in proportion to their weights.
    pub(crate) fn meter_attempt(&mut self, task: &TaskKey, usage: &ResourceUsage) {
        let microseconds = (usage.cpu * 1e6) as u64;
        let Some(job) = self.ledger.jobs.get(&task.job).filter(|_| microseconds > 0) else { return };
        if job.shared.is_some() {
            for (owner, part) in self.split_charge(job, microseconds) {
                self.meter.add(&owner, UsageSums { processor_us: part, ..UsageSums::default() });
            }
            return;
        }
        self.meter.add(&job.spec.owner, UsageSums { processor_us: microseconds, ..UsageSums::default() });
    }

    /// Counts a completed task, and its frame if the task finished it.
    pub(crate) fn meter_task(&mut self, task: &TaskKey, samples: u64) {
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        let frames = u64::from(is_finished_frame(job, task));
        self.meter.add(&job.spec.owner, UsageSums { frames, tasks: 1, samples, ..UsageSums::default() });
    }

    /// Makes the added usage durable.
    pub(crate) fn record_usage(&mut self, now: Tick, out: &mut Vec<Command>) {
        let Some(month) = self.meter.month else { return };
        let added = std::mem::take(&mut self.meter.owners);
        if added.is_empty() {
            return;
        }
        let side = &self.ledger.side;
        let totals = added.into_iter().map(|(owner, sums)| {
            let sums = side.usage_of(month, &owner).plus(sums);
            OwnerUsage { month, owner, sums }
        });
        let usage = totals.collect();
        self.record_fact(Fact::Metered { usage }, now, out);
    }

    /// Returns the usage by month and owner up to the last event. The time of running leases is charged every few seconds.
    pub fn usage_by_owner(&self) -> Vec<OwnerUsage> {
        let mut all: BTreeMap<(Month, String), UsageSums> =
            self.ledger.side.usage_rows().map(|row| ((row.month, row.owner), row.sums)).collect();
        if let Some(month) = self.meter.month {
            for (owner, sums) in &self.meter.owners {
                let known = all.entry((month, owner.clone())).or_default();
                *known = known.plus(*sums);
            }
        }
        all.into_iter().map(|((month, owner), sums)| OwnerUsage { month, owner, sums }).collect()
    }
}

fn is_finished_frame(job: &Job, task: &TaskKey) -> bool {
    let frame = task.stage.frame;
    frame != femc_model::Stage::JOB_FRAME && job.shared.is_none() && job.finished.contains_key(&frame)
}
