//! What must be true after a run, whatever happened in it.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{Ending, Epoch, JobId, JobSpec, JobState, JobStatus, Stage as TaskStage, StageKind, TaskKey};
use femc_queue::Note;
use femc_schedule::{Fact, SnapshotError, decode_attempts};

use crate::disk::Tail;
use crate::leases::{Leases, Unit};
use crate::shared::{Reports, State};
use crate::stage::Stage;

/// Something that must never be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// The job did not come to its end in time.
    #[error("the job has not ended")]
    Unfinished,
    /// A job did not end within its time.
    #[error("after {seconds} s it has not ended: {state}")]
    Stuck {
        /// So long somebody waited.
        seconds: u64,
        /// What the farm says of it.
        state: String,
    },
    /// It ended otherwise than done.
    #[error("the job ended as {state}")]
    Failed {
        /// As what.
        state: String,
    },
    /// A frame's pixels are not those of one process.
    #[error("frame {frame} has the pixels {found}, not {expected}")]
    Pixels {
        /// Position among the job's frames.
        frame: usize,
        /// Digest.
        found: String,
        /// Digest.
        expected: String,
    },
    /// The log counts a sample of a tile twice, or a merge.
    #[error("{task} counts twice, in part at least: under epoch {} and under {}", .epochs[0].0, .epochs[1].0)]
    Twice {
        /// Which.
        task: TaskKey,
        /// Of its two results.
        epochs: [Epoch; 2],
    },
    /// The log counts a merge to which samples of its round were missing.
    #[error("{task} counts, and sample {sample} of tile {tile} does not")]
    Missing {
        /// The merge.
        task: TaskKey,
        /// Number in the grid.
        tile: u32,
        /// Of each pixel.
        sample: u32,
    },
    /// A result was acknowledged, and the log does not have it.
    #[error("{task} under epoch {} was acknowledged and is not in the log", .epoch.0)]
    Forgotten {
        /// Which.
        task: TaskKey,
        /// Of its lease.
        epoch: Epoch,
    },
    /// The log counts a result that nobody was asked for.
    #[error("{task} under epoch {} counts and was never leased", .epoch.0)]
    Unleased {
        /// Which.
        task: TaskKey,
        /// Of its result.
        epoch: Epoch,
    },
    /// A result counts although its lease was over: the task had been given out anew.
    #[error("{task} counts under epoch {}, and was leased anew under {}", .epoch.0, .later.0)]
    Superseded {
        /// Which.
        task: TaskKey,
        /// Of its result.
        epoch: Epoch,
        /// Of the lease that held.
        later: Epoch,
    },
    /// A result counts in a frame of another build of the engine.
    #[error("{task} counts under epoch {}, of the build {build:?} in a frame of the build {frame:?}", .epoch.0)]
    Foreign {
        /// Which.
        task: TaskKey,
        /// Of its lease.
        epoch: Epoch,
        /// Of its worker; empty: nobody's.
        build: String,
        /// Of its frame; empty: none yet.
        frame: String,
    },
    /// A frame that was of one build is of another, and has not begun anew.
    #[error("frame {frame} of job {job} was of the build {:?} and is of {:?}", .builds[0], .builds[1])]
    Rebuilt {
        /// The job.
        job: JobId,
        /// Frame number.
        frame: u32,
        /// Before, and now.
        builds: [String; 2],
    },
    /// A result counts, and what it took was noted more often or less.
    #[error("{task} under epoch {} counts, and what it took was noted {times} times", .epoch.0)]
    Noted {
        /// Which.
        task: TaskKey,
        /// Of its lease.
        epoch: Epoch,
        /// How often.
        times: u64,
    },
    /// What an attempt took was noted as that of a result, which does not count.
    #[error("what {task} took under epoch {} was noted as that of a result, and it does not count", .epoch.0)]
    NotedForNothing {
        /// Which.
        task: TaskKey,
        /// Of its lease.
        epoch: Epoch,
    },
    /// The job's account does not agree with what was done.
    #[error("the account says {found} {what}, it should be {expected}")]
    Account {
        /// Of what.
        what: &'static str,
        /// As told.
        found: u64,
        /// As it should be.
        expected: u64,
    },
    /// One of many jobs went wrong.
    #[error("job {job}: {violation}")]
    OfJob {
        /// Which.
        job: JobId,
        /// How.
        violation: Box<Violation>,
    },
    /// What should stay as it is has grown.
    #[error("{what} grew from {before} to {after} on the average")]
    Growth {
        /// What.
        what: &'static str,
        /// In the first half.
        before: u64,
        /// In the second half.
        after: u64,
    },
    /// The log cannot be read.
    #[error("the log cannot be read: {0}")]
    Log(#[from] SnapshotError),
    /// The simulation itself broke.
    #[error("the world broke: {0}")]
    World(String),
}

impl Violation {
    /// As that of one of many jobs.
    pub(crate) fn of(self, job: JobId) -> Self {
        Self::OfJob { job, violation: Box::new(self) }
    }
}

/// All that is wrong.
pub(crate) fn audit(stage: &Stage, state: &State) -> Vec<Violation> {
    let mut wrong = state.wrong.clone();
    match log(&state.disk.history, [&state.accepted, &state.reported], &state.leases) {
        Ok(found) => wrong.extend(found),
        Err(error) => wrong.push(error.into()),
    }
    match noted(&state.disk.history, &state.disk.notes, state.disk.tail()) {
        Ok(found) => wrong.extend(found),
        Err(error) => wrong.push(error.into()),
    }
    let Some((status, pixels)) = &state.end else {
        wrong.push(Violation::Unfinished);
        return wrong;
    };
    if status.state != JobState::Done {
        wrong.push(Violation::Failed { state: format!("{:?} ({:?})", status.state, status.failure) });
        return wrong;
    }
    for (frame, expected) in stage.pixels.iter().enumerate() {
        let found = pixels.get(frame).cloned().unwrap_or_default();
        if found != *expected {
            wrong.push(Violation::Pixels { frame, found, expected: expected.clone() });
        }
    }
    wrong.extend(account(&stage.spec, status));
    wrong
}

/// Whether the status of a job that is done agrees with what was asked for.
pub(crate) fn account(spec: &JobSpec, status: &JobStatus) -> Vec<Violation> {
    let mut wrong = Vec::new();
    let mut check = |what, found: u64, expected: u64| {
        if found != expected {
            wrong.push(Violation::Account { what, found, expected });
        }
    };
    let spp = spec.rounds.last().copied().unwrap_or(0);
    let frames = spec.frames.len() as u64;
    check("frames", u64::from(status.frames_done), frames);
    check("samples", status.samples_done, frames * spec.grid.pixels() * u64::from(spp));
    check("bad samples", status.bad_samples, 0);
    wrong
}

/// What the log says that it must not say.
pub(crate) fn log<'a>(
    history: impl IntoIterator<Item = &'a Vec<u8>>,
    [accepted, reported]: [&Reports; 2],
    leases: &Leases,
) -> Result<Vec<Violation>, SnapshotError> {
    let mut wrong = Vec::new();
    let mut done: BTreeMap<Unit, (TaskKey, Epoch)> = BTreeMap::new();
    let mut counted: BTreeSet<(TaskKey, Epoch)> = BTreeSet::new();
    let mut specs: BTreeMap<JobId, Box<JobSpec>> = BTreeMap::new();
    let mut groups: BTreeMap<JobId, u32> = BTreeMap::new();
    for record in history {
        match Fact::decode(record)?.1 {
            Fact::Rendered { task, epoch, .. }
            | Fact::Gathered { task, epoch, .. }
            | Fact::Merged { task, epoch, .. } => {
                counted.insert((task, epoch));
                if task.stage.kind == StageKind::Merge {
                    wrong.extend(specs.get(&task.job).and_then(|spec| missing(spec, task, &done)));
                }
                let units = leases.units(task, epoch).iter();
                let before = units.filter_map(|unit| done.insert(*unit, (task, epoch))).next();
                wrong.extend(before.map(|(_, before)| Violation::Twice { task, epochs: [before, epoch] }));
            }
            Fact::Submitted { job, spec, .. } => drop(specs.insert(job, spec)),
            Fact::Grouped { job, tiles } => drop(groups.insert(job, tiles)),
            Fact::Lost { task } => {
                let tiles = groups.get(&task.job).copied().unwrap_or(1);
                done.retain(|unit, (by, _)| *by != task && !unit.is_gathered_by(&task, tiles));
            }
            Fact::Restarted { job, frame } => {
                done.retain(|unit, _| (unit.job, unit.stage.frame) != (job, frame));
            }
            _ => {}
        }
    }
    for &(task, epoch) in accepted.intersection(reported) {
        if !counted.contains(&(task, epoch)) {
            wrong.push(Violation::Forgotten { task, epoch });
        }
    }
    Ok(wrong)
}

/// Whether of each result that counts it was noted each time what it took, and of nothing else as of a result. Of jobs that are
/// forgotten there are no notes. Where a write was torn, there may be more: what was noted along with a record that was lost.
pub(crate) fn noted<'a>(
    history: impl IntoIterator<Item = &'a Vec<u8>>,
    notes: &[Note],
    tail: Tail,
) -> Result<Vec<Violation>, SnapshotError> {
    // One that was lost may come again under its lease, and count again.
    let (mut counted, mut forgotten) = (BTreeMap::<_, u64>::new(), BTreeSet::new());
    for record in history {
        match Fact::decode(record)?.1 {
            Fact::Rendered { task, epoch, .. }
            | Fact::Gathered { task, epoch, .. }
            | Fact::Merged { task, epoch, .. } => *counted.entry((task, epoch)).or_default() += 1,
            Fact::Forgotten { job } => drop(forgotten.insert(job)),
            _ => {}
        }
    }
    counted.retain(|(task, _), _| !forgotten.contains(&task.job));
    let mut times: BTreeMap<(TaskKey, Epoch), u64> = BTreeMap::new();
    for note in notes {
        for attempt in decode_attempts(&note.bytes)?.into_iter().filter(|attempt| attempt.ending == Ending::Done) {
            *times.entry((attempt.task, attempt.epoch)).or_default() += 1;
        }
    }
    let mut wrong = Vec::new();
    for (&(task, epoch), &counts) in &counted {
        let times = times.get(&(task, epoch)).copied().unwrap_or(0);
        if times < counts || times > counts && tail == Tail::Whole {
            wrong.push(Violation::Noted { task, epoch, times });
        }
    }
    let for_nothing = times.keys().filter(|key| tail == Tail::Whole && !counted.contains_key(key));
    wrong.extend(for_nothing.map(|&(task, epoch)| Violation::NotedForNothing { task, epoch }));
    Ok(wrong)
}

/// A sample that is not there when its round is merged.
fn missing(spec: &JobSpec, merge: TaskKey, done: &BTreeMap<Unit, (TaskKey, Epoch)>) -> Option<Violation> {
    let stage_of_tiles = TaskStage { kind: StageKind::Render, ..merge.stage };
    let samples = spec.samples(merge.stage.round);
    let mut all = (0..spec.grid.tiles()).flat_map(|tile| samples.clone().map(move |sample| (tile, sample)));
    let is_missing = |&(tile, sample): &(u32, u32)| {
        !done.contains_key(&Unit { job: merge.job, stage: stage_of_tiles, tile, sample })
    };
    let (tile, sample) = all.find(is_missing)?;
    Some(Violation::Missing { task: merge, tile, sample })
}
