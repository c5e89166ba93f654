//! People with jobs who change their minds, ask twice, and do not wait for answers. Also checks what the farm answers them.

use std::time::Duration;

use bytes::Bytes;
use femc_model::{
    Control, Digest, Drain, FrameRecord, Intake, JobId, JobSpec, JobState, JobStatus, Refusal, Role, WorkerId,
    WorkerName,
};
use femc_proto::{CallError, Client};
use rand::RngExt as _;
use rand::rngs::SmallRng;

use crate::audit::{Violation, account};
use crate::faults::WORKERS;
use crate::hosts::{coordinator_name, worker_name};
use crate::network::{dial, url};
use crate::promises::Asked;
use crate::shared::Shared;
use crate::shelf::{Harm, Shelf};
use crate::stage::Stage;

/// Time between two tries.
const AGAIN: Duration = Duration::from_millis(300);

/// Fault in the tasks of a job. The job's name tells it; the name does not change any pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Curse {
    Nothing,
    /// A task panics now and then.
    NowAndThen,
    /// One task panics each time.
    Always,
    /// One task kills its worker each time.
    Deadly,
}

impl Curse {
    const ALL: [Self; 4] = [Self::Nothing, Self::NowAndThen, Self::Always, Self::Deadly];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Nothing => "haze",
            Self::NowAndThen => "haze-now-and-then",
            Self::Always => "haze-always",
            Self::Deadly => "haze-deadly",
        }
    }

    /// Returns the curse of a job.
    pub(crate) fn of(spec: &JobSpec) -> Self {
        Self::ALL.into_iter().find(|curse| curse.name() == spec.name).unwrap_or(Self::Nothing)
    }

    /// Checks whether a job may fail however often it is retried.
    pub(crate) fn is_final(self) -> bool {
        matches!(self, Self::Always | Self::Deadly)
    }
}

/// A person's change of mind while a job runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Whim {
    Nothing,
    PauseAWhile,
    Cancel,
    CancelAndRetry,
    Priority(u8),
}

impl Whim {
    /// Draws a whim; half of the time, nothing.
    pub(crate) fn pick(rng: &mut SmallRng) -> Self {
        match rng.random_range(0..10) {
            0 => Self::PauseAWhile,
            1 => Self::Cancel,
            2 => Self::CancelAndRetry,
            3 | 4 => Self::Priority(rng.random_range(0..=100)),
            _ => Self::Nothing,
        }
    }
}

/// Permitted end of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expected {
    Done,
    Cancelled,
    /// Nobody knows whether the cancellation or the end came first.
    Either,
}

/// A job that a person wants done.
#[derive(Debug, Clone)]
pub(crate) struct Errand {
    pub(crate) key: String,
    pub(crate) spec: JobSpec,
    pub(crate) stage: Stage,
    pub(crate) whim: Whim,
    /// Time until the whim is carried out, and time from then until it is undone.
    pub(crate) pauses: [Duration; 2],
}

/// Habits of people.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Manner {
    /// Time between two status requests.
    pub(crate) look: Duration,
    /// Time after which an unfinished job counts as stuck.
    pub(crate) patience: Duration,
}

/// A person with a job.
pub(crate) struct Person<'a> {
    pub(crate) shared: &'a Shared,
    pub(crate) shelf: &'a Shelf,
    pub(crate) rng: &'a mut SmallRng,
    pub(crate) manner: Manner,
}

impl Person<'_> {
    /// Submits a job, follows it to its end and fetches its frames. Returns the number of the job at the end.
    pub(crate) async fn runs(&mut self, errand: &Errand) -> anyhow::Result<JobId> {
        loop {
            let (asked, job) = self.submits(errand).await;
            let followed = tokio::time::timeout(self.manner.patience, self.follows(asked, job, errand)).await;
            // If the log is lost, the job is lost, too.
            if self.shared.is_over(asked) {
                self.shared.lock().did("submitted again");
                continue;
            }
            let wrong = match followed {
                Ok(wrong) => wrong?,
                Err(_) => vec![self.stuck(asked, job).await],
            };
            self.shared.lock().wrong.extend(wrong.into_iter().map(|violation| violation.of(job)));
            if self.rng.random_range(0..4) == 0 {
                self.comes_again(asked, errand).await;
            }
            return Ok(job);
        }
    }

    /// Submits a job until it is accepted. Sometimes does not wait for the first answer, sometimes submits twice.
    async fn submits(&mut self, errand: &Errand) -> (Asked, JobId) {
        let (key, mut spec) = (&errand.key, errand.spec.clone());
        if self.rng.random_range(0..3) == 0 {
            let patience = Duration::from_millis(self.rng.random_range(1..80));
            let first = self.submission(key, &spec, &errand.stage.bundle);
            if tokio::time::timeout(patience, first).await.is_err() {
                self.shared.lock().did("did not wait for an answer");
            }
        }
        loop {
            let asked = self.shared.asks();
            let Ok(job) = self.submission(key, &spec, &errand.stage.bundle).await else {
                tokio::time::sleep(AGAIN).await;
                continue;
            };
            self.shared.hears_job(asked, key, job);
            if self.rng.random_range(0..3) > 0 || self.shared.is_over(asked) {
                return (asked, job);
            }
            // The same key means the same job, even if the rest of the submission differs. In half of the cases nothing differs.
            if self.rng.random_range(0..2) == 0 {
                spec.priority = 100 - spec.priority;
            }
            let asked_again = self.shared.asks();
            if let Ok(again) = self.submission(key, &spec, &errand.stage.bundle).await {
                self.shared.lock().did("submitted twice");
                self.shared.hears_job(asked_again, key, again);
            }
            return (asked, job);
        }
    }

    /// Submits an ended job again: its key must still refer to it.
    async fn comes_again(&self, asked: Asked, errand: &Errand) {
        // If jobs expire, this could be a new job that nobody waits for.
        if self.shared.lock().chronicle.keep_ended.is_some() || self.shared.is_over(asked) {
            return;
        }
        let now = self.shared.asks();
        if let Ok(again) = self.submission(&errand.key, &errand.spec, &errand.stage.bundle).await {
            self.shared.lock().did("submitted an ended job again");
            self.shared.hears_job(now, &errand.key, again);
        }
    }

    /// Submits a running job again: its key must refer to it.
    async fn asks_twice(&self, asked: Asked, errand: &Errand) {
        let now = self.shared.asks();
        if self.shared.is_over(asked) {
            return;
        }
        if let Ok(again) = self.submission(&errand.key, &errand.spec, &errand.stage.bundle).await {
            self.shared.lock().did("submitted a running job again");
            self.shared.hears_job(now, &errand.key, again);
        }
    }

    async fn submission(&self, key: &str, spec: &JobSpec, bundle: &Bytes) -> Result<JobId, Refusal> {
        answer(self.shared, self.shared.asks(), &async |client: Client| {
            client.put(bundle.clone()).await?;
            client.submit(Some(key.to_owned()), spec.clone()).await
        })
        .await
    }

    /// Follows a job to its end, and returns the violations.
    async fn follows(&mut self, asked: Asked, job: JobId, errand: &Errand) -> anyhow::Result<Vec<Violation>> {
        let [first, second] = errand.pauses;
        if errand.whim != Whim::Nothing {
            tokio::time::sleep(first).await;
        }
        let mut expected = self.indulges(asked, job, errand.whim, second).await;
        let curse = Curse::of(&errand.spec);
        // A task that fails now and then may fail three times by chance.
        let mut tries = if curse.is_final() { 1 } else { 20 };
        let mut harms = self.rng.random_range(0..4) == 0;
        let (status, files) = loop {
            let Some(status) = self.waits(asked, job, errand).await else { return Ok(Vec::new()) };
            if status.state != JobState::Failed || tries == 0 {
                if status.state == JobState::Failed && curse.is_final() {
                    self.shared.lock().did("failed");
                    return Ok(Vec::new());
                }
                if std::mem::take(&mut harms) && status.state == JobState::Done {
                    self.harms_a_result(asked, job, errand.stage.result).await;
                }
                match self.fetches(asked, job, errand.stage.result, status.state).await {
                    Fetched::Files(files) if files.len() >= status.frames_done as usize => break (status, files),
                    // A damaged result is rendered again.
                    Fetched::Files(_) | Fetched::Refused => {
                        tokio::time::sleep(AGAIN).await;
                        continue;
                    }
                    Fetched::Gone => return Ok(Vec::new()),
                }
            }
            tries -= 1;
            // The job may have failed because its scene was lost.
            let put = async |client: Client| client.put(errand.stage.bundle.clone()).await;
            let _ = answer(self.shared, asked, &put).await;
            if self.steer(asked, job, Control::Retry).await.is_ok() {
                self.shared.lock().did("retried a failed job");
                if expected == Expected::Cancelled {
                    expected = Expected::Either;
                }
            }
        };
        let mut wrong = ended(&errand.spec, &status, expected);
        {
            let mut state = self.shared.lock();
            state.did(if status.state == JobState::Done { "done" } else { "cancelled" });
            state.stale += status.stale_messages;
        }
        if files.len() as u64 != u64::from(status.frames_done) {
            let (found, expected) = (files.len() as u64, status.frames_done.into());
            wrong.push(Violation::Account { what: "frames fetched", found, expected });
        }
        for (record, file) in files {
            let Some(file) = file else { continue };
            let found = errand.stage.digest(file)?;
            let frame = errand.stage.spec.frames.iter().position(|&frame| frame == record.frame).unwrap_or_default();
            if found != errand.stage.digests[frame] {
                let expected = errand.stage.digests[frame].clone();
                wrong.push(Violation::Result { frame, found, expected });
            }
            let busy = self.shared.lock().chronicle.busy(job, record.frame);
            let [answered, logged] = [record.busy_seconds, busy.unwrap_or(record.busy_seconds)];
            if (answered - logged).abs() > 1e-6 {
                let [answered, logged] = [answered, logged].map(|seconds| (seconds * 1000.0) as u64);
                wrong.push(Violation::Busy { frame: record.frame, answered, logged });
            }
        }
        Ok(wrong)
    }

    /// Waits until the job has ended. Returns `None` if the job has expired or its log is lost.
    async fn waits(&mut self, asked: Asked, job: JobId, errand: &Errand) -> Option<JobStatus> {
        loop {
            let now = self.shared.asks();
            let status = answer(self.shared, asked, &async |client: Client| client.status(job).await).await;
            if self.shared.is_over(asked) {
                return None;
            }
            self.shared.hears_status(now, job, &status);
            match status {
                Ok(status) if status.state.has_ended() => return Some(status),
                Err(Refusal::NoSuchJob { .. }) => {
                    self.shared.lock().did("expired before anybody looked");
                    return None;
                }
                Ok(_) | Err(_) => tokio::time::sleep(self.manner.look).await,
            }
            if self.rng.random_range(0..6) == 0 {
                self.asks_twice(asked, errand).await;
            }
            if self.rng.random_range(0..8) == 0 {
                let now = self.shared.asks();
                let all = answer(self.shared, asked, &async |client: Client| client.list().await).await;
                all.iter().for_each(|all| self.shared.hears_list(now, all));
            }
        }
    }

    /// Damages the result of a finished frame.
    async fn harms_a_result(&mut self, asked: Asked, job: JobId, role: Role) {
        let frames = answer(self.shared, asked, &async |client: Client| client.frames(job).await).await;
        let Ok(Some(result)) = frames.map(|frames| frames.iter().find_map(|frame| frame.output(role))) else { return };
        let (harm, thousandths) = (self.rng.random_range(0..4), self.rng.random_range(0..1000));
        let harm = [Harm::Lost, Harm::Flipped, Harm::Short(thousandths), Harm::Zeroed(thousandths)][harm];
        self.shared.lock().harmed.insert(result.digest);
        if self.shelf.harm(&result.digest, harm) {
            self.shared.lock().did("damaged a finished result");
        }
    }

    /// Fetches the files of the job's finished frames. A cancelled job renders nothing again, so damaged files of it have no bytes.
    async fn fetches(&self, asked: Asked, job: JobId, role: Role, state: JobState) -> Fetched {
        let is_gone = |digest: &Digest| state == JobState::Cancelled && self.shared.lock().harmed.contains(digest);
        let fetch = async |client: Client| {
            let mut files = Vec::new();
            for frame in client.frames(job).await? {
                let Some(result) = frame.output(role) else { continue };
                match client.get(&result.digest, result.bytes).await {
                    Ok(file) => {
                        self.shared.receives(&result.digest, &file);
                        files.push((frame, Some(file)));
                    }
                    Err(CallError::Refused(_)) if is_gone(&result.digest) => files.push((frame, None)),
                    Err(error) => return Err(error),
                }
            }
            Ok(files)
        };
        match answer(self.shared, asked, &fetch).await {
            Ok(files) => Fetched::Files(files),
            Err(_) if self.shared.is_over(asked) || self.shared.lock().chronicle.has_forgotten(job) => Fetched::Gone,
            Err(refusal) => {
                self.shared.note(|| format!("person: {refusal}"));
                Fetched::Refused
            }
        }
    }

    async fn steer(&self, asked: Asked, job: JobId, control: Control) -> Result<(), Refusal> {
        let now = self.shared.asks();
        if self.shared.is_over(asked) {
            return Err(over());
        }
        self.shared.steers(job, &control);
        let steers = async |client: Client| client.control(job, control.clone()).await;
        let answered = answer(self.shared, asked, &steers).await;
        self.shared.hears_steered(now, job, &control, &answered);
        answered
    }

    /// Carries out the person's whim, and returns how the job may end then. A request without an answer may still be on its way.
    /// The pause before the next request is long enough that the next one arrives last.
    async fn indulges(&self, asked: Asked, job: JobId, whim: Whim, pause: Duration) -> Expected {
        let did = |what| self.shared.lock().did(what);
        let steer = async |control| self.steer(asked, job, control).await;
        match whim {
            Whim::Nothing => Expected::Done,
            Whim::PauseAWhile => {
                if steer(Control::Pause).await.is_ok() {
                    did("paused");
                }
                tokio::time::sleep(pause).await;
                // A job that has ended meanwhile need not resume.
                let _ = steer(Control::Resume).await;
                Expected::Done
            }
            Whim::Cancel => match steer(Control::Cancel).await {
                Ok(()) => Expected::Cancelled,
                Err(_) => Expected::Either,
            },
            Whim::CancelAndRetry => {
                // An ended job cannot be cancelled, and a finished job cannot be retried. Both refusals are right.
                let _ = steer(Control::Cancel).await;
                tokio::time::sleep(pause).await;
                if steer(Control::Retry).await.is_ok() {
                    did("retried");
                }
                Expected::Done
            }
            Whim::Priority(priority) => {
                if steer(Control::Priority(priority)).await.is_ok() {
                    did("priority changed");
                }
                Expected::Done
            }
        }
    }

    /// Describes a job that does not end.
    async fn stuck(&self, asked: Asked, job: JobId) -> Violation {
        let state = match answer(self.shared, asked, &async |client: Client| client.status(job).await).await {
            Ok(status) => format!("{:?}, waiting: {:?}", status.state, status.waits),
            Err(refusal) => refusal.to_string(),
        };
        Violation::Stuck { seconds: self.manner.patience.as_secs(), state }
    }
}

fn ended(spec: &JobSpec, status: &JobStatus, expected: Expected) -> Vec<Violation> {
    match (status.state, expected) {
        (JobState::Done, Expected::Done | Expected::Either) => account(spec, status),
        (JobState::Cancelled, Expected::Cancelled | Expected::Either) => Vec::new(),
        _ => {
            let JobStatus { state, failure, quarantined, .. } = status;
            vec![Violation::Failed { state: format!("{state:?} ({failure:?}, {quarantined:?})") }]
        }
    }
}

/// Result of fetching a job's files.
enum Fetched {
    /// Finished frames, each with its file unless that is damaged.
    Files(Vec<(FrameRecord, Option<Bytes>)>),
    /// A file is missing or damaged.
    Refused,
    /// The job has expired, or its log is lost.
    Gone,
}

/// Draws at least one and at most `most` of the frames, in their order.
pub(crate) fn some(frames: &[u32], most: usize, rng: &mut SmallRng) -> Vec<u32> {
    let chosen: Vec<u32> = frames.iter().copied().filter(|_| rng.random_range(0..2) == 0).take(most).collect();
    if chosen.is_empty() { frames.iter().copied().take(most).collect() } else { chosen }
}

fn over() -> Refusal {
    Refusal::Unavailable { message: "the log was lost".into() }
}

/// Sends a request to the leading coordinator until it answers, also with a refusal. Stops when the log of the question is lost.
pub(crate) async fn answer<T>(
    shared: &Shared,
    asked: Asked,
    ask: &impl AsyncFn(Client) -> Result<T, CallError>,
) -> Result<T, Refusal> {
    while !shared.is_over(asked) {
        let leader = url(&coordinator_name(shared.lock().leader));
        let answer = tokio::time::timeout(Duration::from_secs(5), async {
            let client = Client::connect_by(&dial(shared, "person"), &leader).await?;
            ask(client).await
        });
        match answer.await {
            Ok(Ok(answer)) => return Ok(answer),
            Ok(Err(CallError::Refused(no @ (Refusal::Unavailable { .. } | Refusal::NoRoom { .. })))) => {
                shared.note(|| format!("person: {no}"));
            }
            Ok(Err(CallError::Refused(refusal))) => return Err(refusal),
            Ok(Err(error)) => shared.note(|| format!("person: {error}")),
            Err(_) => shared.note(|| "person: no answer".into()),
        }
        tokio::time::sleep(AGAIN).await;
    }
    Err(over())
}

/// Drains a worker for a while.
pub(crate) async fn drain_a_while(shared: &Shared, rng: &mut SmallRng, most: Duration) {
    let worker = WorkerName::Name(worker_name(rng.random_range(0..WORKERS)));
    let drain = async |client: Client| client.drain(worker.clone(), Drain::Begin).await;
    if answer(shared, shared.asks(), &drain).await.is_ok() {
        shared.lock().did("drained");
    }
    tokio::time::sleep(Duration::from_millis(rng.random_range(0..most.as_millis() as u64))).await;
    open_all(shared).await;
}

/// Ends the drain of every connected worker.
pub(crate) async fn open_all(shared: &Shared) {
    let undo = async |client: Client| -> Result<Vec<WorkerId>, CallError> {
        let mut opened = Vec::new();
        for worker in client.workers().await? {
            if worker.intake == Intake::Drained {
                opened.extend(client.drain(WorkerName::Number(worker.worker), Drain::Undo).await?);
            }
        }
        Ok(opened)
    };
    // A worker may have left in between.
    let _ = answer(shared, shared.asks(), &undo).await;
}
