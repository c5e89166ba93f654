//! Leases grouped by stage, and within a stage by key and epoch. A search compares only a few numbers.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use femc_model::{Epoch, JobId, Stage, StageKind, TaskKey};

use crate::lease_table::{Lease, LeaseKey};

type StageLeases = BTreeMap<(u32, Epoch), Lease>;

/// Leases in the order of their keys. Stages without leases have no entry.
#[derive(Debug, Clone, Default)]
pub(crate) struct Leases(BTreeMap<(JobId, Stage), StageLeases>);

impl Leases {
    fn stage_leases(&self, task: &TaskKey) -> Option<&StageLeases> {
        self.0.get(&(task.job, task.stage))
    }

    pub(crate) fn get(&self, (task, epoch): &LeaseKey) -> Option<&Lease> {
        self.stage_leases(task)?.get(&(task.index, *epoch))
    }

    pub(crate) fn get_mut(&mut self, (task, epoch): &LeaseKey) -> Option<&mut Lease> {
        self.0.get_mut(&(task.job, task.stage))?.get_mut(&(task.index, *epoch))
    }

    pub(crate) fn insert(&mut self, (task, epoch): LeaseKey, lease: Lease) {
        self.0.entry((task.job, task.stage)).or_default().insert((task.index, epoch), lease);
    }

    pub(crate) fn remove(&mut self, (task, epoch): &LeaseKey) -> Option<Lease> {
        let stage_leases = self.0.get_mut(&(task.job, task.stage))?;
        let lease = stage_leases.remove(&(task.index, *epoch))?;
        if stage_leases.is_empty() {
            self.0.remove(&(task.job, task.stage));
        }
        Some(lease)
    }

    /// Returns all leases.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (LeaseKey, &Lease)> {
        self.0.iter().flat_map(with_keys)
    }

    /// Returns the leases of a task: none, one, or one and its copy.
    pub(crate) fn of_task(&self, task: &TaskKey) -> impl Iterator<Item = (LeaseKey, &Lease)> + use<'_> {
        let (task, keys) = (*task, (task.index, Epoch(0))..=(task.index, Epoch(u64::MAX)));
        let leases =
            self.stage_leases(&task).into_iter().flat_map(move |stage_leases| stage_leases.range(keys.clone()));
        leases.map(move |(&(_, epoch), lease)| ((task, epoch), lease))
    }

    /// Returns the leases of a stage.
    pub(crate) fn of_stage(&self, job: JobId, stage: Stage) -> impl Iterator<Item = (LeaseKey, &Lease)> {
        self.0.get_key_value(&(job, stage)).into_iter().flat_map(with_keys)
    }

    /// Returns the last lease of a stage whose key is less than `end`.
    pub(crate) fn last_before(&self, job: JobId, stage: Stage, end: u32) -> Option<(LeaseKey, &Lease)> {
        let (&(index, epoch), lease) = self.0.get(&(job, stage))?.range(..(end, Epoch(0))).next_back()?;
        Some(((TaskKey { job, stage, index }, epoch), lease))
    }

    /// Returns the leases of a range of a job's frames.
    pub(crate) fn of_frames(
        &self,
        job: JobId,
        frames: RangeInclusive<u32>,
    ) -> impl Iterator<Item = (LeaseKey, &Lease)> + use<'_> {
        let first = Stage { frame: *frames.start(), round: 0, number: 0, kind: StageKind::ALL[0] };
        let stages = self.0.range((job, first)..);
        stages.take_while(move |((of, stage), _)| *of == job && frames.contains(&stage.frame)).flat_map(with_keys)
    }
}

/// Returns the leases of a stage with their keys.
fn with_keys<'a>(
    (&(job, stage), stage_leases): (&(JobId, Stage), &'a StageLeases),
) -> impl Iterator<Item = (LeaseKey, &'a Lease)> {
    stage_leases.iter().map(move |(&(index, epoch), lease)| ((TaskKey { job, stage, index }, epoch), lease))
}
