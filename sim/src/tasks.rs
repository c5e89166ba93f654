//! What depends on how a frame is cut into tasks and how they add up: all else knows tasks by their keys alone.

use femc_model::{Assignment, Decision, Epoch, JobId, JobSpec, Stage, StageKind, TaskKey, Work};
use femc_schedule::Fact;

/// The least that can be given out: a sample of a tile, the gathering of a group, or a merge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Unit {
    pub(crate) job: JobId,
    pub(crate) stage: Stage,
    pub(crate) tile: u32,
    pub(crate) sample: u32,
}

impl Unit {
    /// Whether it is a sample that is rendered for `gather`, of groups of `tiles` tiles.
    pub(crate) fn is_gathered_by(&self, gather: &TaskKey, tiles: u32) -> bool {
        let stage = Stage { kind: StageKind::Render, ..gather.stage };
        gather.stage.kind == StageKind::Gather
            && (self.job, self.stage, self.tile / tiles) == (gather.job, stage, gather.index)
    }
}

/// All that a lease covers.
pub(crate) fn units(lease: &Assignment) -> Vec<Unit> {
    let TaskKey { job, stage, .. } = lease.task;
    match &lease.work {
        Work::Render { tile, samples } => {
            samples.clone().map(|sample| Unit { job, stage, tile: *tile, sample }).collect()
        }
        Work::Gather { .. } | Work::Merge { .. } => vec![Unit { job, stage, tile: lease.task.index, sample: 0 }],
    }
}

/// Samples of each pixel that a lease takes; 0 where it takes none.
pub(crate) fn samples(lease: &Assignment) -> u32 {
    match &lease.work {
        Work::Render { samples, .. } => samples.len() as u32,
        Work::Gather { .. } | Work::Merge { .. } => 0,
    }
}

/// Whether a lease renders something, rather than join what is rendered.
pub(crate) fn renders(lease: &Assignment) -> bool {
    matches!(lease.work, Work::Render { .. })
}

/// The task under the name by which its failures are counted: of what joins, they add up over the rounds of its frame.
pub(crate) fn tried(task: TaskKey) -> TaskKey {
    let round = if task.stage.kind == StageKind::Render { task.stage.round } else { 0 };
    TaskKey { stage: Stage { round, ..task.stage }, ..task }
}

/// A result that the log counts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counted {
    pub(crate) task: TaskKey,
    pub(crate) epoch: Epoch,
    /// That it took.
    pub(crate) seconds: f64,
    /// Pixel samples.
    pub(crate) samples: u64,
    /// Whether its frame is finished with it.
    pub(crate) finishes: bool,
}

/// The result that a record counts, if it is of that kind.
pub(crate) fn counted(fact: &Fact) -> Option<Counted> {
    Some(match fact {
        Fact::Rendered { task, epoch, result, .. } => {
            Counted { task: *task, epoch: *epoch, seconds: result.seconds, samples: result.samples, finishes: false }
        }
        Fact::Gathered { task, epoch, result } => {
            Counted { task: *task, epoch: *epoch, seconds: result.seconds, samples: 0, finishes: false }
        }
        Fact::Merged { task, epoch, result } => Counted {
            task: *task,
            epoch: *epoch,
            seconds: result.seconds,
            samples: 0,
            finishes: result.decision == Decision::Done && result.image.is_some(),
        },
        _ => return None,
    })
}

/// All that must count before a merge does.
pub(crate) fn needed(spec: &JobSpec, merge: TaskKey) -> impl Iterator<Item = Unit> {
    let stage = Stage { kind: StageKind::Render, ..merge.stage };
    let (samples, job) = (spec.samples(merge.stage.round), merge.job);
    let tiles = 0..spec.grid.tiles();
    tiles.flat_map(move |tile| samples.clone().map(move |sample| Unit { job, stage, tile, sample }))
}

/// The job that a record is about.
pub(crate) fn job_of(fact: &Fact) -> Option<JobId> {
    match fact {
        Fact::Opened { .. } | Fact::Drained { .. } | Fact::Used { .. } | Fact::Lives { .. } => None,
        Fact::Submitted { job, .. }
        | Fact::Cut { job, .. }
        | Fact::Grouped { job, .. }
        | Fact::Restarted { job, .. }
        | Fact::Doomed { job, .. }
        | Fact::Controlled { job, .. }
        | Fact::Built { job, .. }
        | Fact::Forgotten { job } => Some(*job),
        Fact::Rendered { task, .. }
        | Fact::Gathered { task, .. }
        | Fact::Merged { task, .. }
        | Fact::Failed { task, .. }
        | Fact::Died { task, .. }
        | Fact::Lost { task } => Some(task.job),
        Fact::Logged(record) => Some(record.task.job),
    }
}
