//! What must be true after a run, whatever happened in it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_coordinator::ROSTER;
use femc_model::{Artifact, Control, Digest, Ending, Epoch, JobId, JobSpec, JobStatus, TaskKey};
use femc_queue::Note;
use femc_schedule::{Fact, SnapshotError, decode_attempts};

use crate::disk::Tail;
use crate::leases::Leases;
use crate::shared::{Reports, State};
use crate::tasks::{Tally, Unit, counted};

/// Something that must never be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// Somebody's jobs did not come to their end in time.
    #[error("{jobs} people still wait for their jobs")]
    Unfinished {
        /// Number of people whose jobs have not ended.
        jobs: usize,
    },
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
    /// A frame's result is not that of one process: its pixels, or its answer.
    #[error("frame {frame} came out as {found}, not as {expected}")]
    Result {
        /// Position among the job's frames.
        frame: usize,
        /// Digest.
        found: String,
        /// Digest.
        expected: String,
    },
    /// The log counts a result twice: samples of a tile, or a task that is not cut.
    #[error("{task} counts twice, in part at least: under epoch {} and under {}", .epochs[0].0, .epochs[1].0)]
    Twice {
        /// The task.
        task: TaskKey,
        /// Of its two results.
        epochs: [Epoch; 2],
    },
    /// The log counts a task that reads what is not done, like samples of its round.
    #[error("{task} counts, and step {step} of task {item}, which it reads, does not")]
    Missing {
        /// The one that reads it.
        task: TaskKey,
        /// The task that was to do it, by its number.
        item: u32,
        /// Of that task.
        step: u32,
    },
    /// A result was acknowledged, and the log does not have it.
    #[error("{task} under epoch {} was acknowledged and is not in the log", .epoch.0)]
    Forgotten {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
    },
    /// The log counts a result that nobody was asked for.
    #[error("{task} under epoch {} counts and was never leased", .epoch.0)]
    Unleased {
        /// The task.
        task: TaskKey,
        /// Epoch of its result.
        epoch: Epoch,
    },
    /// A result counts although its lease was over: the task had been given out anew.
    #[error("{task} counts under epoch {}, and was leased anew under {}", .epoch.0, .later.0)]
    Superseded {
        /// The task.
        task: TaskKey,
        /// Epoch of its result.
        epoch: Epoch,
        /// Of the lease that held.
        later: Epoch,
    },
    /// A result counts in a frame of another build of the engine.
    #[error("{task} counts under epoch {}, of the build {build:?} in a frame of the build {frame:?}", .epoch.0)]
    Foreign {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
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
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
        /// Number of notes.
        times: u64,
    },
    /// What an attempt took was noted as that of a result, which does not count.
    #[error("what {task} took under epoch {} was noted as that of a result, and it does not count", .epoch.0)]
    NotedForNothing {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
    },
    /// The job's account does not agree with what was done.
    #[error("the account says {found} {what}, it should be {expected}")]
    Account {
        /// Name of the quantity.
        what: &'static str,
        /// Value in the account.
        found: u64,
        /// Value that it should have.
        expected: u64,
    },
    /// One of many jobs went wrong.
    #[error("job {job}: {violation}")]
    OfJob {
        /// The job.
        job: JobId,
        /// The violation.
        violation: Box<Violation>,
    },
    /// What should stay as it is has grown.
    #[error("{what} grew from {before} to {after} on the average")]
    Growth {
        /// Name of the quantity.
        what: &'static str,
        /// In the first half.
        before: u64,
        /// In the second half.
        after: u64,
    },
    /// A coordinator began under a number under which another one had begun.
    #[error("incarnation {incarnation} begins again")]
    Incarnation {
        /// The number.
        incarnation: u32,
    },
    /// Two leases have one epoch.
    #[error("epoch {} is that of {} and of {}", .epoch.0, .tasks[0], .tasks[1])]
    EpochAgain {
        /// The epoch.
        epoch: Epoch,
        /// Of the first lease and of the second.
        tasks: [TaskKey; 2],
    },
    /// What jobs share was begun again, and was there.
    #[error("{} is begun, and {} is the same", .jobs[1], .jobs[0])]
    BegunAgain {
        /// The one that was there, and the new one.
        jobs: [JobId; 2],
    },
    /// A task was given out that reads what is done for its content, and that was not done by its build.
    #[error("{task} is leased under epoch {}, and what its frame shares is not there", .epoch.0)]
    Unserved {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// A worker does what jobs share and none of them waits for.
    #[error("a worker holds {task}, and nobody waits for it")]
    Unwanted {
        /// The task.
        task: TaskKey,
    },
    /// A job has the number of an earlier one.
    #[error("job {job} is submitted, and there was one of this number")]
    Renumbered {
        /// The number.
        job: JobId,
    },
    /// A key stands for two jobs.
    #[error("the key {key} is that of job {}, and of job {}", .jobs[0], .jobs[1])]
    KeyMoved {
        /// The key.
        key: String,
        /// Before, and now.
        jobs: [JobId; 2],
    },
    /// The log says that a person steered a job, and nobody did.
    #[error("nobody asked for {control:?} of job {job}")]
    Unasked {
        /// The job.
        job: JobId,
        /// Control that the person asked for.
        control: Control,
    },
    /// What a person did to a job was acknowledged, and the log does not have it.
    #[error("{control:?} of job {job} was acknowledged and is not in the log")]
    Unwritten {
        /// The job.
        job: JobId,
        /// Control that the person asked for.
        control: Control,
    },
    /// What a person wanted was refused because the job had ended, which it had not.
    #[error("{control:?} of job {job} was refused because it had ended, and it had not")]
    Refused {
        /// The job.
        job: JobId,
        /// Control that was asked for.
        control: Control,
    },
    /// A result counts of a job that had ended.
    #[error("{task} counts under epoch {}, and its job had ended", .epoch.0)]
    AfterEnd {
        /// The task.
        task: TaskKey,
        /// Epoch of its result.
        epoch: Epoch,
    },
    /// A job was forgotten before its time.
    #[error("job {job} was forgotten before its time")]
    ForgottenEarly {
        /// The job.
        job: JobId,
    },
    /// A job is gone, and nobody has forgotten it.
    #[error("job {job} is gone")]
    Gone {
        /// The job.
        job: JobId,
    },
    /// A worker that an operator had drained got a task.
    #[error("the worker of process {instance} is drained and gets a task")]
    Drained {
        /// The worker's process.
        instance: u64,
    },
    /// An answer is not what the log said then.
    #[error("somebody was told of job {job}: {what}; the log never said so")]
    Answer {
        /// The job.
        job: JobId,
        /// What the answer said.
        what: String,
    },
    /// A task is said to have failed more often than it has, or was put aside too soon.
    #[error("{task} is put aside after {answered} attempts, as somebody was told; by the log it failed {logged} times")]
    Attempts {
        /// The task.
        task: TaskKey,
        /// Attempts that an answer stated.
        answered: u32,
        /// Failed attempts in the log.
        logged: u32,
    },
    /// A task that was put aside was given out.
    #[error("{task} is leased under epoch {}, and was put aside before", .epoch.0)]
    Aside {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// The attempts of a task that is put aside have become fewer, and nobody has tried it again.
    #[error("{task} was put aside after {before} attempts, and now after {answered}")]
    Fewer {
        /// The task.
        task: TaskKey,
        /// Attempts that an earlier answer stated.
        before: u32,
        /// Attempts that the latest answer stated.
        answered: u32,
    },
    /// The log counts more failures of a task than were reported, a lease and its copy being one attempt.
    #[error("the log counts {counted} failed attempts of {task}, and {reported} were reported")]
    Failures {
        /// The task.
        task: TaskKey,
        /// Failed attempts in the log.
        counted: usize,
        /// Failed attempts that workers reported.
        reported: usize,
    },
    /// A task is said to have made no progress, and every task here does.
    #[error("{task} is said to have made no progress")]
    Stalled {
        /// The task.
        task: TaskKey,
    },
    /// An owner is charged less than before, or not for the time that workers held something of his.
    #[error("{owner} is charged {held} ms after {before} ms; workers held something of his for {seen} ms")]
    Charged {
        /// The owner.
        owner: String,
        /// Milliseconds charged before.
        before: u64,
        /// Milliseconds charged now.
        held: u64,
        /// Milliseconds as seen on the way to the workers.
        seen: u64,
    },
    /// A worker's process is said to have died over a task, and it lives.
    #[error("process {instance} is said to have died over {task}, and it lives")]
    Alive {
        /// The worker's process.
        instance: u64,
        /// The task.
        task: TaskKey,
    },
    /// A job failed, and nothing explains it.
    #[error("the job failed, and nothing says why: {status}")]
    Unexplained {
        /// What the farm says of it.
        status: String,
    },
    /// A report was refused because its lease was over, and its worker had not been told.
    #[error("the lease of {task} under epoch {} ended, and its worker was not told", .epoch.0)]
    Silent {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// A frame's seconds are not those of its results.
    #[error("frame {frame} took {answered} ms, as somebody was told; its results took {logged} ms")]
    Busy {
        /// Frame number.
        frame: u32,
        /// Time that an answer stated, in milliseconds.
        answered: u64,
        /// Time by the log, in milliseconds.
        logged: u64,
    },
    /// Something was removed from the store that the log names.
    #[error("{digest} was removed, and the log names it")]
    Removed {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// Something is in the store that nobody needs, or is not there and somebody does.
    #[error("after a collection of garbage {left} artifacts are left that nothing names, and {missing} are missing")]
    Garbage {
        /// Artifacts that nothing names.
        left: u64,
        /// Artifacts that are named and missing.
        missing: u64,
    },
    /// A person's upload failed though nothing was wrong with the farm.
    #[error("an upload was refused, and nothing was wrong with the farm: {message}")]
    Upload {
        /// What the person was told.
        message: String,
    },
    /// A result counts that states another size of an artifact than that has.
    #[error(
        "{task} counts under epoch {}, and states {} bytes of {}, which has {bytes}",
        .epoch.0, .stated.bytes, .stated.digest
    )]
    Size {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
        /// What the result states.
        stated: Artifact,
        /// Bytes of the artifact.
        bytes: u64,
    },
    /// A lease of another farm took the place of one of here.
    #[error("{task} under epoch {} is held by who brought a lease of another farm", .epoch.0)]
    TakenOver {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// Somebody asked for an artifact and got other bytes than its own.
    #[error("somebody asked for {digest} and got {found}")]
    Delivered {
        /// Digest that was asked for.
        digest: Digest,
        /// Digest of what came.
        found: Digest,
    },
    /// A snapshot was made of a log that was short.
    #[error("a snapshot was made of {records} records")]
    Snapshot {
        /// Records of the log since the snapshot before.
        records: usize,
    },
    /// A snapshot does not say what the log says that it replaces.
    #[error("a snapshot is not what the snapshot before it and the {records} records since say")]
    SnapshotDiffers {
        /// Records of the log since the snapshot before.
        records: usize,
    },
    /// A coordinator came to its end because its log's disk was full.
    #[error("a full disk ended a coordinator: {message}")]
    Ended {
        /// Error of the coordinator.
        message: String,
    },
    /// A worker got a task that computes while the tasks that waited there were worth more time than may wait.
    #[error(
        "at {at:.3?} the worker of process {instance} is leased {task} while it has {count} waiting, which take at least \
         {milliseconds} ms"
    )]
    Deep {
        /// The worker's process.
        instance: u64,
        /// The task.
        task: TaskKey,
        /// Tasks that waited.
        count: usize,
        /// Milliseconds that they take at least.
        milliseconds: u64,
        /// Simulated time.
        at: Duration,
    },
    /// A worker on which the tasks of a job fail got another one before its pause was over.
    #[error(
        "at {at:.3?} the worker of process {instance} is leased {task}, {milliseconds} ms after its first pause began; {failures} \
         tasks of the job failed there in a row, and the pauses after them are {pause} ms"
    )]
    Hasty {
        /// The worker's process.
        instance: u64,
        /// The task.
        task: TaskKey,
        /// Failures in a row, without those of leases from before the first pause.
        failures: u32,
        /// Milliseconds since the first pause began.
        milliseconds: u64,
        /// Milliseconds of all pauses so far.
        pause: u64,
        /// Simulated time.
        at: Duration,
    },
    /// A task that joins waited while a worker that could take it got a task that computes.
    #[error(
        "at {at:.3?} {task} had waited for {milliseconds} ms, and the worker of process {instance} was leased {other} before it"
    )]
    Starved {
        /// The task that joins.
        task: TaskKey,
        /// The process of the worker that could take it.
        instance: u64,
        /// The task that this worker got.
        other: TaskKey,
        /// Milliseconds that the task had waited.
        milliseconds: u64,
        /// Simulated time.
        at: Duration,
    },
    /// A drained worker has kept a task that it has not begun.
    #[error(
        "at {at:.3?} the worker of process {instance} has been drained for {milliseconds} ms, and {task} waits there"
    )]
    Kept {
        /// The worker's process.
        instance: u64,
        /// The task that it has not begun.
        task: TaskKey,
        /// Milliseconds since the drain.
        milliseconds: u64,
        /// Simulated time.
        at: Duration,
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
pub(crate) fn audit(state: &State) -> Vec<Violation> {
    let mut wrong = state.wrong.clone();
    wrong.extend(settled(state));
    if state.left > 0 {
        wrong.push(Violation::Unfinished { jobs: state.left });
    }
    wrong
}

/// What is wrong with the log that there is now.
pub(crate) fn settled(state: &State) -> Vec<Violation> {
    let disk = &state.disk;
    let logged = log(&disk.history, [&state.accepted, &state.reported], &state.leases);
    let noted = noted(&disk.history, &disk.notes, disk.tail());
    [logged, noted].into_iter().flat_map(|found| found.unwrap_or_else(|error| vec![error.into()])).collect()
}

/// Whether the status of a job that is done agrees with what was asked for.
pub(crate) fn account(spec: &JobSpec, status: &JobStatus) -> Vec<Violation> {
    let mut wrong = Vec::new();
    let mut check = |what, found: u64, expected: u64| {
        if found != expected {
            wrong.push(Violation::Account { what, found, expected });
        }
    };
    let frames = spec.frames.len() as u64;
    check("frames", u64::from(status.frames_done), frames);
    check("samples", status.samples_done, frames * spec.samples_of_frame());
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
    let mut tally = Tally::default();
    let mut counts: BTreeSet<(TaskKey, Epoch)> = BTreeSet::new();
    for record in history {
        let (now, fact) = Fact::decode(record)?;
        if let Some(result) = counted(&fact) {
            let (task, epoch) = (result.task, result.epoch);
            counts.insert((task, epoch));
            let units = leases.units(task, epoch);
            let missing = tally.missing(units, result.leased);
            wrong.extend(missing.map(|Unit { item, step, .. }| Violation::Missing { task, item, step }));
            let before = tally.count(&result, units);
            wrong.extend(before.map(|(_, before)| Violation::Twice { task, epochs: [before, epoch] }));
        }
        tally.note(&fact, now);
    }
    for &(task, epoch) in accepted.intersection(reported) {
        if !counts.contains(&(task, epoch)) {
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
    let (mut counts, mut forgotten) = (BTreeMap::<_, (u64, u64)>::new(), BTreeSet::new());
    for record in history {
        let fact = Fact::decode(record)?.1;
        if let Some(result) = counted(&fact) {
            let (times, samples) = counts.entry((result.task, result.epoch)).or_default();
            *times += 1;
            *samples += result.result.units;
        }
        if let Fact::Forgotten { job } = fact {
            forgotten.insert(job);
        }
    }
    counts.retain(|(task, _), _| !forgotten.contains(&task.job));
    let mut times: BTreeMap<(TaskKey, Epoch), (u64, u64)> = BTreeMap::new();
    for note in notes.iter().filter(|note| note.subject != ROSTER) {
        for attempt in decode_attempts(&note.bytes)?.into_iter().filter(|attempt| attempt.ending == Ending::Done) {
            let (times, samples) = times.entry((attempt.task, attempt.epoch)).or_default();
            *times += 1;
            *samples += attempt.samples;
        }
    }
    let mut wrong = Vec::new();
    for (&(task, epoch), &(counts, expected)) in &counts {
        let (times, samples) = times.get(&(task, epoch)).copied().unwrap_or_default();
        if times < counts || times > counts && tail == Tail::Whole {
            wrong.push(Violation::Noted { task, epoch, times });
        } else if times == counts && samples != expected {
            wrong.push(Violation::Account { what: "samples of an attempt", found: samples, expected });
        }
    }
    let for_nothing = times.keys().filter(|key| tail == Tail::Whole && !counts.contains_key(key));
    wrong.extend(for_nothing.map(|&(task, epoch)| Violation::NotedForNothing { task, epoch }));
    Ok(wrong)
}
