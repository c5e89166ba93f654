//! Checks that must hold after every run.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_coordinator::ROSTER_SUBJECT;
use femc_model::{Artifact, Control, Digest, Epoch, JobId, JobSpec, JobStatus, LeaseEnding, TaskKey};
use femc_queue::Note;
use femc_schedule::{Fact, SnapshotError, decode_attempts};

use crate::disk::Tail;
use crate::leases::Leases;
use crate::shared::{ResultSet, State};
use crate::tasks::{Tally, TaskStep, counted_result};

/// A broken guarantee of the farm.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// Jobs of some people did not end in time.
    #[error("{jobs} people still wait for their jobs")]
    Unfinished {
        /// Number of people whose jobs have not ended.
        jobs: usize,
    },
    /// A job did not end within its time.
    #[error("the job has not ended after {seconds} s: {state}")]
    Stuck {
        /// Seconds that a person waited.
        seconds: u64,
        /// State of the job as the farm reports it.
        state: String,
    },
    /// A job did not end as done.
    #[error("the job ended as {state}")]
    JobFailed {
        /// State in which the job ended.
        state: String,
    },
    /// The result of a frame (pixels or drill answer) differs from that of a single process.
    #[error("frame {frame} has the result {found}, expected {expected}")]
    WrongResult {
        /// Position among the job's frames.
        frame: usize,
        /// Digest of the result.
        found: String,
        /// Digest of the result of a single process.
        expected: String,
    },
    /// The log counts a result twice: samples of a tile, or a whole task.
    #[error("{task} counts twice, at least in part: under epoch {} and under epoch {}", .epochs[0].0, .epochs[1].0)]
    CountedTwice {
        /// The task.
        task: TaskKey,
        /// Epochs of the two results.
        epochs: [Epoch; 2],
    },
    /// The log counts a task whose inputs are not done, for example samples of its round.
    #[error("{task} counts, but its input, step {step} of task {item}, does not")]
    MissingInput {
        /// The task that reads the input.
        task: TaskKey,
        /// Number of the task that makes the input.
        item: u32,
        /// Step of that task.
        step: u32,
    },
    /// A result was acknowledged, but is not in the log.
    #[error("{task} under epoch {} was acknowledged, but is not in the log", .epoch.0)]
    LostResult {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
    },
    /// The log counts a result without a lease.
    #[error("{task} under epoch {} counts, but was never leased", .epoch.0)]
    Unleased {
        /// The task.
        task: TaskKey,
        /// Epoch of its result.
        epoch: Epoch,
    },
    /// A result counts although its lease was over, because the task had been leased again.
    #[error("{task} counts under epoch {}, but was leased again under epoch {}", .epoch.0, .later.0)]
    Superseded {
        /// The task.
        task: TaskKey,
        /// Epoch of its result.
        epoch: Epoch,
        /// Epoch of the valid lease.
        later: Epoch,
    },
    /// A result of one engine build counts in a frame of another build.
    #[error("{task} counts under epoch {}, with the build {build:?} in a frame of the build {frame:?}", .epoch.0)]
    ForeignBuild {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
        /// Build of the worker; empty if it has none.
        build: String,
        /// Build of the frame; empty if it has none yet.
        frame: String,
    },
    /// A frame changed its engine build without a restart.
    #[error("frame {frame} of job {job} changed its build from {:?} to {:?}", .builds[0], .builds[1])]
    BuildChanged {
        /// The job.
        job: JobId,
        /// Frame number.
        frame: u32,
        /// Earlier and present build.
        builds: [String; 2],
    },
    /// A counted result has too few or too many attempt records.
    #[error("{task} under epoch {} counts, but has {times} attempt records", .epoch.0)]
    AttemptRecords {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
        /// Number of attempt records.
        times: u64,
    },
    /// An attempt record says that the attempt is done, but the result does not count.
    #[error("an attempt record says that {task} under epoch {} is done, but its result does not count", .epoch.0)]
    FalseAttemptRecord {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
    },
    /// A job's account differs from what was done.
    #[error("wrong account: {found} {what}, expected {expected}")]
    WrongAccount {
        /// Name of the quantity.
        what: &'static str,
        /// Value in the account.
        found: u64,
        /// Expected value.
        expected: u64,
    },
    /// A violation in one of many jobs.
    #[error("job {job}: {violation}")]
    InJob {
        /// The job.
        job: JobId,
        /// The violation.
        violation: Box<Violation>,
    },
    /// A quantity grew that should stay constant.
    #[error("{what}: the mean grew from {before} to {after}")]
    Growth {
        /// Name of the quantity.
        what: &'static str,
        /// Mean of the first half.
        before: u64,
        /// Mean of the second half.
        after: u64,
    },
    /// A coordinator began with a number that an earlier one had used.
    #[error("incarnation {incarnation} was used before")]
    IncarnationReused {
        /// The number.
        incarnation: u32,
    },
    /// Two leases have the same epoch.
    #[error("epoch {} belongs to {} and to {}", .epoch.0, .tasks[0], .tasks[1])]
    EpochReused {
        /// The epoch.
        epoch: Epoch,
        /// Tasks of the first and the second lease.
        tasks: [TaskKey; 2],
    },
    /// Shared stages were begun again although they existed.
    #[error("the shared stages {} began, but equal ones exist: {}", .jobs[1], .jobs[0])]
    DuplicateSharedStages {
        /// The existing instance and the new one.
        jobs: [JobId; 2],
    },
    /// A task was leased before its build had finished the shared stages that it reads.
    #[error("{task} is leased under epoch {}, but its frame's shared stages are not done", .epoch.0)]
    SharedStagesMissing {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// A worker computes a shared stage that no job waits for.
    #[error("a worker holds {task}, but no job waits for it")]
    UnwantedLease {
        /// The task.
        task: TaskKey,
    },
    /// A new job has the number of an earlier one.
    #[error("a new job got the number {job} of an earlier job")]
    JobNumberReused {
        /// The number.
        job: JobId,
    },
    /// A key refers to two jobs.
    #[error("the key {key} refers to job {} and to job {}", .jobs[0], .jobs[1])]
    KeyMoved {
        /// The key.
        key: String,
        /// Earlier and present job.
        jobs: [JobId; 2],
    },
    /// The log contains a control that nobody requested.
    #[error("the log has {control:?} of job {job}, but nobody requested it")]
    UnrequestedControl {
        /// The job.
        job: JobId,
        /// Control in the log.
        control: Control,
    },
    /// A control was acknowledged, but is not in the log.
    #[error("{control:?} of job {job} was acknowledged, but is not in the log")]
    LostControl {
        /// The job.
        job: JobId,
        /// Control that the person requested.
        control: Control,
    },
    /// A control was refused because the job had ended, but it had not.
    #[error("{control:?} of job {job} was refused because the job had ended, but it had not ended")]
    WrongRefusal {
        /// The job.
        job: JobId,
        /// Control that was requested.
        control: Control,
    },
    /// A result counts although its job had ended.
    #[error("{task} counts under epoch {}, but its job had ended", .epoch.0)]
    CountedAfterEnd {
        /// The task.
        task: TaskKey,
        /// Epoch of its result.
        epoch: Epoch,
    },
    /// A job expired too early.
    #[error("job {job} expired too early")]
    ExpiredEarly {
        /// The job.
        job: JobId,
    },
    /// A job disappeared without expiring.
    #[error("job {job} disappeared")]
    JobDisappeared {
        /// The job.
        job: JobId,
    },
    /// A drained worker received a task.
    #[error("the worker of process {instance} is drained, but received a task")]
    LeasedToDrained {
        /// The worker's process.
        instance: u64,
    },
    /// An answer differs from the log of that time.
    #[error("an answer about job {job} contradicts the log: {what}")]
    WrongAnswer {
        /// The job.
        job: JobId,
        /// Content of the answer.
        what: String,
    },
    /// An answer reports more failures of a task than the log has, or the task was quarantined too early.
    #[error(
        "an answer says that {task} is quarantined after {answered} attempts, but the log has {logged} failures of it"
    )]
    TooManyAttempts {
        /// The task.
        task: TaskKey,
        /// Attempts according to the answer.
        answered: u32,
        /// Failed attempts in the log.
        logged: u32,
    },
    /// A quarantined task was leased.
    #[error("{task} is leased under epoch {}, but was quarantined before", .epoch.0)]
    LeasedWhileQuarantined {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// The attempts of a quarantined task decreased without a retry.
    #[error("{task} was quarantined after {before} attempts, now after {answered}")]
    AttemptsDecreased {
        /// The task.
        task: TaskKey,
        /// Attempts according to an earlier answer.
        before: u32,
        /// Attempts according to the latest answer.
        answered: u32,
    },
    /// The log counts more failures of a task than workers reported. A lease and its copy are one attempt.
    #[error("the log has {counted} failed attempts of {task}, but workers reported {reported}")]
    TooManyFailures {
        /// The task.
        task: TaskKey,
        /// Failed attempts in the log.
        counted: usize,
        /// Failed attempts that workers reported.
        reported: usize,
    },
    /// A task was reported as stalled, although every task of the simulation makes progress.
    #[error("{task} was reported as stalled")]
    FalseStall {
        /// The task.
        task: TaskKey,
    },
    /// The charge of an owner decreased, or differs from the time for which workers held the owner's tasks.
    #[error("{owner} is charged {held} ms after {before} ms, but workers held tasks of this owner for {seen} ms")]
    WrongCharge {
        /// The owner.
        owner: String,
        /// Milliseconds charged before.
        before: u64,
        /// Milliseconds charged now.
        held: u64,
        /// Milliseconds observed between coordinators and workers.
        seen: u64,
    },
    /// A task was reported to have killed a worker's process, but the process is alive.
    #[error("process {instance} was reported as killed by {task}, but it is alive")]
    FalseDeath {
        /// The worker's process.
        instance: u64,
        /// The task.
        task: TaskKey,
    },
    /// A job failed without an explanation.
    #[error("the job failed without an explanation: {status}")]
    UnexplainedFailure {
        /// Status of the job as the farm reports it.
        status: String,
    },
    /// A report was refused because its lease was over, but its worker had not been informed.
    #[error("the lease of {task} under epoch {} ended, but its worker was not informed", .epoch.0)]
    UnannouncedEnd {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// The busy time of a frame differs from the sum over its results.
    #[error("an answer says that frame {frame} took {answered} ms, but its results took {logged} ms")]
    WrongBusyTime {
        /// Frame number.
        frame: u32,
        /// Time according to an answer, in milliseconds.
        answered: u64,
        /// Time according to the log, in milliseconds.
        logged: u64,
    },
    /// An artifact that the log references was removed from the store.
    #[error("{digest} was removed, but the log references it")]
    ReferencedArtifactRemoved {
        /// Digest of the artifact.
        digest: Digest,
    },
    /// After garbage collection, the store has unreferenced artifacts or lacks referenced ones.
    #[error(
        "after garbage collection, {left} artifacts without references are left, and {missing} referenced artifacts are missing"
    )]
    WrongGarbage {
        /// Artifacts without references.
        left: u64,
        /// Artifacts that are referenced and missing.
        missing: u64,
    },
    /// A person's upload failed although the store had no fault.
    #[error("an upload was refused although the farm had no fault: {message}")]
    UploadRefused {
        /// Message that the person received.
        message: String,
    },
    /// A result counts although it states a wrong size of an artifact.
    #[error(
        "{task} counts under epoch {}, but states {} bytes for {}, which has {bytes}",
        .epoch.0, .stated.bytes, .stated.digest
    )]
    WrongSize {
        /// The task.
        task: TaskKey,
        /// Epoch of its lease.
        epoch: Epoch,
        /// Artifact with the stated size.
        stated: Artifact,
        /// Real size in bytes.
        bytes: u64,
    },
    /// A lease of another farm replaced one of this farm.
    #[error("{task} under epoch {} is held by a worker that brought a lease of another farm", .epoch.0)]
    ForeignLease {
        /// The task.
        task: TaskKey,
        /// Epoch of the lease.
        epoch: Epoch,
    },
    /// A request for an artifact returned wrong bytes.
    #[error("a request for {digest} returned {found}")]
    WrongBytes {
        /// Digest that was requested.
        digest: Digest,
        /// Digest of the received bytes.
        found: Digest,
    },
    /// A snapshot was made although the log was short.
    #[error("a snapshot was made after only {records} records")]
    EarlySnapshot {
        /// Records of the log since the previous snapshot.
        records: usize,
    },
    /// A snapshot differs from the log that it replaces.
    #[error("a snapshot differs from the previous snapshot plus the {records} records since")]
    SnapshotDiffers {
        /// Records of the log since the previous snapshot.
        records: usize,
    },
    /// A coordinator terminated because the log's disk was full.
    #[error("a coordinator terminated because the disk was full: {message}")]
    CoordinatorTerminated {
        /// Error of the coordinator.
        message: String,
    },
    /// A worker was leased a task that computes although its waiting tasks already take more time than allowed.
    #[error(
        "at {at:.3?} the worker of process {instance} is leased {task}, but already has {count} waiting tasks, which take at least \
         {milliseconds} ms"
    )]
    QueueTooDeep {
        /// The worker's process.
        instance: u64,
        /// The task.
        task: TaskKey,
        /// Number of waiting tasks.
        count: usize,
        /// Least duration of these tasks, in milliseconds.
        milliseconds: u64,
        /// Simulated time.
        at: Duration,
    },
    /// A worker on which tasks of a job failed was leased another one before its pause was over.
    #[error(
        "at {at:.3?} the worker of process {instance} is leased {task}, {milliseconds} ms after its first pause began; {failures} \
         tasks of the job failed there in a row, so that its pauses are {pause} ms"
    )]
    PauseTooShort {
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
    /// A task that joins waited, while a worker that could take it was leased a task that computes.
    #[error(
        "at {at:.3?} {task} had waited for {milliseconds} ms, but the worker of process {instance} was leased {other} first"
    )]
    JoinStarved {
        /// The task that joins.
        task: TaskKey,
        /// The process of the worker that could take it.
        instance: u64,
        /// The task that this worker was leased.
        other: TaskKey,
        /// Milliseconds that the task had waited.
        milliseconds: u64,
        /// Simulated time.
        at: Duration,
    },
    /// A drained worker kept a task that it had not begun.
    #[error(
        "at {at:.3?} the worker of process {instance} has been drained for {milliseconds} ms, but {task} still waits there"
    )]
    KeptWhileDrained {
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
    #[error("cannot read the log: {0}")]
    Log(#[from] SnapshotError),
    /// The simulation itself failed.
    #[error("the simulation failed: {0}")]
    Simulation(String),
}

impl Violation {
    /// Turns a violation into a violation of one of many jobs.
    pub(crate) fn in_job(self, job: JobId) -> Self {
        Self::InJob { job, violation: Box::new(self) }
    }
}

/// Returns all violations of a run.
pub(crate) fn audit(state: &State) -> Vec<Violation> {
    let mut wrong = state.violations.clone();
    wrong.extend(check_log(state));
    if state.waiting_people > 0 {
        wrong.push(Violation::Unfinished { jobs: state.waiting_people });
    }
    wrong
}

/// Returns the violations in the current log.
pub(crate) fn check_log(state: &State) -> Vec<Violation> {
    let disk = &state.disk;
    let logged = check_records(&disk.history, [&state.accepted, &state.reported], &state.leases);
    let attempts = check_attempt_records(&disk.history, &disk.notes, disk.tail());
    [logged, attempts].into_iter().flat_map(|found| found.unwrap_or_else(|error| vec![error.into()])).collect()
}

/// Checks that the status of a finished job agrees with its specification.
pub(crate) fn check_account(spec: &JobSpec, status: &JobStatus) -> Vec<Violation> {
    let mut wrong = Vec::new();
    let mut check = |what, found: u64, expected: u64| {
        if found != expected {
            wrong.push(Violation::WrongAccount { what, found, expected });
        }
    };
    let frames = spec.frames.len() as u64;
    check("frames", u64::from(status.frames_done), frames);
    check("samples", status.samples_done, frames * spec.samples_of_frame());
    check("bad samples", status.bad_samples, 0);
    wrong
}

/// Checks the records of a log against the leases and the acknowledged results.
pub(crate) fn check_records<'a>(
    history: impl IntoIterator<Item = &'a Vec<u8>>,
    [accepted, reported]: [&ResultSet; 2],
    leases: &Leases,
) -> Result<Vec<Violation>, SnapshotError> {
    let mut wrong = Vec::new();
    let mut tally = Tally::default();
    let mut counts: BTreeSet<(TaskKey, Epoch)> = BTreeSet::new();
    for record in history {
        let (now, fact) = Fact::decode(record)?;
        if let Some(result) = counted_result(&fact) {
            let (task, epoch) = (result.task, result.epoch);
            counts.insert((task, epoch));
            let steps = leases.steps(task, epoch);
            let missing = tally.missing_input(steps, result.granted);
            wrong.extend(missing.map(|TaskStep { item, step, .. }| Violation::MissingInput { task, item, step }));
            let before = tally.count(&result, steps);
            wrong.extend(before.map(|(_, before)| Violation::CountedTwice { task, epochs: [before, epoch] }));
        }
        tally.apply(&fact, now);
    }
    for &(task, epoch) in accepted.intersection(reported) {
        if !counts.contains(&(task, epoch)) {
            wrong.push(Violation::LostResult { task, epoch });
        }
    }
    Ok(wrong)
}

/// Checks that each counted result has exactly one attempt record per count, and that no other attempt record says that its attempt
/// is done. Expired jobs have no attempt records. After a torn write there may be more: the attempt record is kept while its log
/// record is lost.
pub(crate) fn check_attempt_records<'a>(
    history: impl IntoIterator<Item = &'a Vec<u8>>,
    notes: &[Note],
    tail: Tail,
) -> Result<Vec<Violation>, SnapshotError> {
    // A lost result may be reported again under its lease, and counts again.
    let (mut counts, mut expired) = (BTreeMap::<_, (u64, u64)>::new(), BTreeSet::new());
    for record in history {
        let fact = Fact::decode(record)?.1;
        if let Some(result) = counted_result(&fact) {
            let (times, samples) = counts.entry((result.task, result.epoch)).or_default();
            *times += 1;
            *samples += result.result.units;
        }
        if let Fact::JobRemoved { job } = fact {
            expired.insert(job);
        }
    }
    counts.retain(|(task, _), _| !expired.contains(&task.job));
    let mut times: BTreeMap<(TaskKey, Epoch), (u64, u64)> = BTreeMap::new();
    for note in notes.iter().filter(|note| note.subject != ROSTER_SUBJECT) {
        for attempt in decode_attempts(&note.bytes)?.into_iter().filter(|attempt| attempt.ending == LeaseEnding::Done) {
            let (times, samples) = times.entry((attempt.task, attempt.epoch)).or_default();
            *times += 1;
            *samples += attempt.samples;
        }
    }
    let mut wrong = Vec::new();
    for (&(task, epoch), &(counts, expected)) in &counts {
        let (times, samples) = times.get(&(task, epoch)).copied().unwrap_or_default();
        if times < counts || times > counts && tail == Tail::Whole {
            wrong.push(Violation::AttemptRecords { task, epoch, times });
        } else if times == counts && samples != expected {
            wrong.push(Violation::WrongAccount { what: "samples of an attempt", found: samples, expected });
        }
    }
    let for_nothing = times.keys().filter(|key| tail == Tail::Whole && !counts.contains_key(key));
    wrong.extend(for_nothing.map(|&(task, epoch)| Violation::FalseAttemptRecord { task, epoch }));
    Ok(wrong)
}
