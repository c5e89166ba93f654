//! People with jobs who change their minds, ask twice, and do not wait for answers. Also checks what the farm answers them.

use std::time::Duration;

use bytes::Bytes;
use femc_model::{
    Control, Digest, Drain, FrameRecord, Intake, JobId, JobSpec, JobState, JobStatus, Refusal, Role, WorkerId,
    WorkerSelector,
};
use femc_proto::{CallError, Client};
use rand::RngExt as _;
use rand::rngs::SmallRng;

use crate::audit::{Violation, check_account};
use crate::faults::WORKERS;
use crate::faulty_medium::{Damage, FaultyMedium};
use crate::hosts::{coordinator_name, worker_name};
use crate::network::{dialer, url};
use crate::requests::RequestTime;
use crate::shared::Shared;
use crate::test_jobs::TestJob;

/// Time between two tries.
const RETRY_INTERVAL: Duration = Duration::from_millis(300);

/// Fault in the tasks of a job. The job's name tells it; the name does not change any pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum InjectedFailure {
    Nothing,
    /// A task panics now and then.
    RandomPanics,
    /// One task panics each time.
    RepeatedPanic,
    /// One task kills its worker each time.
    KillsWorker,
}

impl InjectedFailure {
    const ALL: [Self; 4] = [Self::Nothing, Self::RandomPanics, Self::RepeatedPanic, Self::KillsWorker];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Nothing => "haze",
            Self::RandomPanics => "haze-now-and-then",
            Self::RepeatedPanic => "haze-always",
            Self::KillsWorker => "haze-deadly",
        }
    }

    /// Returns the injected failure of a job.
    pub(crate) fn from_spec(spec: &JobSpec) -> Self {
        Self::ALL.into_iter().find(|failure| failure.name() == spec.name).unwrap_or(Self::Nothing)
    }

    /// Checks whether a job may fail however often it is retried.
    pub(crate) fn is_permanent(self) -> bool {
        matches!(self, Self::RepeatedPanic | Self::KillsWorker)
    }
}

/// A person's change of mind while a job runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Intervention {
    Nothing,
    PauseAWhile,
    Cancel,
    CancelAndRetry,
    Priority(u8),
}

impl Intervention {
    /// Draws an intervention; half of the time, none.
    pub(crate) fn draw(rng: &mut SmallRng) -> Self {
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
enum ExpectedEnd {
    Done,
    Cancelled,
    /// Nobody knows whether the cancellation or the end came first.
    Either,
}

/// A job that a person wants done.
#[derive(Debug, Clone)]
pub(crate) struct JobRequest {
    pub(crate) key: String,
    pub(crate) spec: JobSpec,
    pub(crate) test_job: TestJob,
    pub(crate) intervention: Intervention,
    /// Time until the intervention, and time from then until it is undone.
    pub(crate) pauses: [Duration; 2],
}

/// Habits of people.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Timing {
    /// Time between two status requests.
    pub(crate) poll_interval: Duration,
    /// Time after which an unfinished job counts as stuck.
    pub(crate) timeout: Duration,
}

/// A person with a job.
pub(crate) struct Person<'a> {
    pub(crate) shared: &'a Shared,
    pub(crate) medium: &'a FaultyMedium,
    pub(crate) rng: &'a mut SmallRng,
    pub(crate) timing: Timing,
}

impl Person<'_> {
    /// Submits a job, follows it to its end and fetches its frames. Returns the number of the job at the end.
    pub(crate) async fn run_job(&mut self, request: &JobRequest) -> anyhow::Result<JobId> {
        loop {
            let (asked_at, job) = self.submit(request).await;
            let followed = tokio::time::timeout(self.timing.timeout, self.follow_job(asked_at, job, request)).await;
            // If the log is lost, the job is lost, too.
            if self.shared.is_log_lost(asked_at) {
                self.shared.lock().count_action("submitted again");
                continue;
            }
            let wrong = match followed {
                Ok(wrong) => wrong?,
                Err(_) => vec![self.stuck_violation(asked_at, job).await],
            };
            self.shared.lock().violations.extend(wrong.into_iter().map(|violation| violation.in_job(job)));
            if self.rng.random_range(0..4) == 0 {
                self.resubmit_ended(asked_at, request).await;
            }
            return Ok(job);
        }
    }

    /// Submits a job until it is accepted. Sometimes does not wait for the first answer, sometimes submits twice.
    async fn submit(&mut self, request: &JobRequest) -> (RequestTime, JobId) {
        let (key, mut spec) = (&request.key, request.spec.clone());
        if self.rng.random_range(0..3) == 0 {
            let patience = Duration::from_millis(self.rng.random_range(1..80));
            let first = self.submit_once(key, &spec, &request.test_job.bundle);
            if tokio::time::timeout(patience, first).await.is_err() {
                self.shared.lock().count_action("did not wait for an answer");
            }
        }
        loop {
            let asked_at = self.shared.request_time();
            let Ok(job) = self.submit_once(key, &spec, &request.test_job.bundle).await else {
                tokio::time::sleep(RETRY_INTERVAL).await;
                continue;
            };
            self.shared.check_submission(asked_at, key, job);
            if self.rng.random_range(0..3) > 0 || self.shared.is_log_lost(asked_at) {
                return (asked_at, job);
            }
            // The same key means the same job, even if the rest of the submission differs. In half of the cases nothing differs.
            if self.rng.random_range(0..2) == 0 {
                spec.priority = 100 - spec.priority;
            }
            let asked_again_at = self.shared.request_time();
            if let Ok(again) = self.submit_once(key, &spec, &request.test_job.bundle).await {
                self.shared.lock().count_action("submitted twice");
                self.shared.check_submission(asked_again_at, key, again);
            }
            return (asked_at, job);
        }
    }

    /// Submits an ended job again: its key must still refer to it.
    async fn resubmit_ended(&self, asked_at: RequestTime, request: &JobRequest) {
        // If jobs expire, this could be a new job that nobody waits for.
        if self.shared.lock().history.keep_ended.is_some() || self.shared.is_log_lost(asked_at) {
            return;
        }
        let now = self.shared.request_time();
        if let Ok(again) = self.submit_once(&request.key, &request.spec, &request.test_job.bundle).await {
            self.shared.lock().count_action("submitted an ended job again");
            self.shared.check_submission(now, &request.key, again);
        }
    }

    /// Submits a running job again: its key must refer to it.
    async fn resubmit_running(&self, asked_at: RequestTime, request: &JobRequest) {
        let now = self.shared.request_time();
        if self.shared.is_log_lost(asked_at) {
            return;
        }
        if let Ok(again) = self.submit_once(&request.key, &request.spec, &request.test_job.bundle).await {
            self.shared.lock().count_action("submitted a running job again");
            self.shared.check_submission(now, &request.key, again);
        }
    }

    async fn submit_once(&self, key: &str, spec: &JobSpec, bundle: &Bytes) -> Result<JobId, Refusal> {
        ask_leader(self.shared, self.shared.request_time(), &async |client: Client| {
            client.put(bundle.clone()).await?;
            client.submit(Some(key.to_owned()), spec.clone()).await
        })
        .await
    }

    /// Follows a job to its end, and returns the violations.
    async fn follow_job(
        &mut self,
        asked_at: RequestTime,
        job: JobId,
        request: &JobRequest,
    ) -> anyhow::Result<Vec<Violation>> {
        let [first, second] = request.pauses;
        if request.intervention != Intervention::Nothing {
            tokio::time::sleep(first).await;
        }
        let mut expected = self.intervene(asked_at, job, request.intervention, second).await;
        let injected = InjectedFailure::from_spec(&request.spec);
        // A task that fails now and then may fail three times by chance.
        let mut tries = if injected.is_permanent() { 1 } else { 20 };
        let mut harms = self.rng.random_range(0..4) == 0;
        let (status, files) = loop {
            let Some(status) = self.wait_for_end(asked_at, job, request).await else { return Ok(Vec::new()) };
            if status.state != JobState::Failed || tries == 0 {
                if status.state == JobState::Failed && injected.is_permanent() {
                    self.shared.lock().count_action("failed");
                    return Ok(Vec::new());
                }
                if std::mem::take(&mut harms) && status.state == JobState::Done {
                    self.damage_result(asked_at, job, request.test_job.result_role).await;
                }
                match self.fetch_results(asked_at, job, request.test_job.result_role, status.state).await {
                    FetchOutcome::Files(files) if files.len() >= status.frames_done as usize => break (status, files),
                    // A damaged result is rendered again.
                    FetchOutcome::Files(_) | FetchOutcome::Refused => {
                        tokio::time::sleep(RETRY_INTERVAL).await;
                        continue;
                    }
                    FetchOutcome::JobGone => return Ok(Vec::new()),
                }
            }
            tries -= 1;
            // The job may have failed because its scene was lost.
            let put = async |client: Client| client.put(request.test_job.bundle.clone()).await;
            let _ = ask_leader(self.shared, asked_at, &put).await;
            if self.send_control(asked_at, job, Control::Retry).await.is_ok() {
                self.shared.lock().count_action("retried a failed job");
                if expected == ExpectedEnd::Cancelled {
                    expected = ExpectedEnd::Either;
                }
            }
        };
        let mut wrong = check_end(&request.spec, &status, expected);
        {
            let mut state = self.shared.lock();
            state.count_action(if status.state == JobState::Done { "done" } else { "cancelled" });
            state.stale += status.stale_messages;
        }
        if files.len() as u64 != u64::from(status.frames_done) {
            let (found, expected) = (files.len() as u64, status.frames_done.into());
            wrong.push(Violation::WrongAccount { what: "frames fetched", found, expected });
        }
        for (record, file) in files {
            let Some(file) = file else { continue };
            let found = request.test_job.digest(file)?;
            let frame =
                request.test_job.spec.frames.iter().position(|&frame| frame == record.frame).unwrap_or_default();
            if found != request.test_job.digests[frame] {
                let expected = request.test_job.digests[frame].clone();
                wrong.push(Violation::WrongResult { frame, found, expected });
            }
            let busy = self.shared.lock().history.busy_seconds(job, record.frame);
            let [answered, logged] = [record.busy_seconds, busy.unwrap_or(record.busy_seconds)];
            if (answered - logged).abs() > 1e-6 {
                let [answered, logged] = [answered, logged].map(|seconds| (seconds * 1000.0) as u64);
                wrong.push(Violation::WrongBusyTime { frame: record.frame, answered, logged });
            }
        }
        Ok(wrong)
    }

    /// Waits until the job has ended. Returns `None` if the job has expired or its log is lost.
    async fn wait_for_end(&mut self, asked_at: RequestTime, job: JobId, request: &JobRequest) -> Option<JobStatus> {
        loop {
            let now = self.shared.request_time();
            let status = ask_leader(self.shared, asked_at, &async |client: Client| client.status(job).await).await;
            if self.shared.is_log_lost(asked_at) {
                return None;
            }
            self.shared.check_status_answer(now, job, &status);
            match status {
                Ok(status) if status.state.has_ended() => return Some(status),
                Err(Refusal::NoSuchJob { .. }) => {
                    self.shared.lock().count_action("expired before anybody looked");
                    return None;
                }
                Ok(_) | Err(_) => tokio::time::sleep(self.timing.poll_interval).await,
            }
            if self.rng.random_range(0..6) == 0 {
                self.resubmit_running(asked_at, request).await;
            }
            if self.rng.random_range(0..8) == 0 {
                let now = self.shared.request_time();
                let all = ask_leader(self.shared, asked_at, &async |client: Client| client.list().await).await;
                all.iter().for_each(|all| self.shared.check_list_answer(now, all));
            }
        }
    }

    /// Damages the result of a finished frame.
    async fn damage_result(&mut self, asked_at: RequestTime, job: JobId, role: Role) {
        let frames = ask_leader(self.shared, asked_at, &async |client: Client| client.frames(job).await).await;
        let Ok(Some(result)) = frames.map(|frames| frames.iter().find_map(|frame| frame.output(role))) else { return };
        let (harm, thousandths) = (self.rng.random_range(0..4), self.rng.random_range(0..1000));
        let harm = [Damage::Lost, Damage::Flipped, Damage::Short(thousandths), Damage::Zeroed(thousandths)][harm];
        self.shared.lock().damaged.insert(result.digest);
        if self.medium.damage(&result.digest, harm) {
            self.shared.lock().count_action("damaged a finished result");
        }
    }

    /// Fetches the files of the job's finished frames. A cancelled job renders nothing again, so damaged files of it have no bytes.
    async fn fetch_results(&self, asked_at: RequestTime, job: JobId, role: Role, state: JobState) -> FetchOutcome {
        let is_gone = |digest: &Digest| state == JobState::Cancelled && self.shared.lock().damaged.contains(digest);
        let fetch = async |client: Client| {
            let mut files = Vec::new();
            for frame in client.frames(job).await? {
                let Some(result) = frame.output(role) else { continue };
                match client.get(&result.digest, result.bytes).await {
                    Ok(file) => {
                        self.shared.check_download(&result.digest, &file);
                        files.push((frame, Some(file)));
                    }
                    Err(CallError::Refused(_)) if is_gone(&result.digest) => files.push((frame, None)),
                    Err(error) => return Err(error),
                }
            }
            Ok(files)
        };
        match ask_leader(self.shared, asked_at, &fetch).await {
            Ok(files) => FetchOutcome::Files(files),
            Err(_) if self.shared.is_log_lost(asked_at) || self.shared.lock().history.has_expired(job) => {
                FetchOutcome::JobGone
            }
            Err(refusal) => {
                self.shared.trace(|| format!("person: {refusal}"));
                FetchOutcome::Refused
            }
        }
    }

    async fn send_control(&self, asked_at: RequestTime, job: JobId, control: Control) -> Result<(), Refusal> {
        let now = self.shared.request_time();
        if self.shared.is_log_lost(asked_at) {
            return Err(log_lost());
        }
        self.shared.record_control(job, &control);
        let steers = async |client: Client| client.control(job, control.clone()).await;
        let answered = ask_leader(self.shared, asked_at, &steers).await;
        self.shared.check_control_answer(now, job, &control, &answered);
        answered
    }

    /// Carries out the intervention, and returns how the job may end then. A request without an answer may still be on its way.
    /// The pause before the next request is long enough that the next one arrives last.
    async fn intervene(
        &self,
        asked_at: RequestTime,
        job: JobId,
        intervention: Intervention,
        pause: Duration,
    ) -> ExpectedEnd {
        let did = |what| self.shared.lock().count_action(what);
        let steer = async |control| self.send_control(asked_at, job, control).await;
        match intervention {
            Intervention::Nothing => ExpectedEnd::Done,
            Intervention::PauseAWhile => {
                if steer(Control::Pause).await.is_ok() {
                    did("paused");
                }
                tokio::time::sleep(pause).await;
                // A job that has ended meanwhile need not resume.
                let _ = steer(Control::Resume).await;
                ExpectedEnd::Done
            }
            Intervention::Cancel => match steer(Control::Cancel).await {
                Ok(()) => ExpectedEnd::Cancelled,
                Err(_) => ExpectedEnd::Either,
            },
            Intervention::CancelAndRetry => {
                // An ended job cannot be cancelled, and a finished job cannot be retried. Both refusals are right.
                let _ = steer(Control::Cancel).await;
                tokio::time::sleep(pause).await;
                if steer(Control::Retry).await.is_ok() {
                    did("retried");
                }
                ExpectedEnd::Done
            }
            Intervention::Priority(priority) => {
                if steer(Control::Priority(priority)).await.is_ok() {
                    did("priority changed");
                }
                ExpectedEnd::Done
            }
        }
    }

    /// Describes a job that does not end.
    async fn stuck_violation(&self, asked_at: RequestTime, job: JobId) -> Violation {
        let state = match ask_leader(self.shared, asked_at, &async |client: Client| client.status(job).await).await {
            Ok(status) => format!("{:?}, waiting: {:?}", status.state, status.waits),
            Err(refusal) => refusal.to_string(),
        };
        Violation::Stuck { seconds: self.timing.timeout.as_secs(), state }
    }
}

fn check_end(spec: &JobSpec, status: &JobStatus, expected: ExpectedEnd) -> Vec<Violation> {
    match (status.state, expected) {
        (JobState::Done, ExpectedEnd::Done | ExpectedEnd::Either) => check_account(spec, status),
        (JobState::Cancelled, ExpectedEnd::Cancelled | ExpectedEnd::Either) => Vec::new(),
        _ => {
            let JobStatus { state, failure, quarantined, .. } = status;
            vec![Violation::JobFailed { state: format!("{state:?} ({failure:?}, {quarantined:?})") }]
        }
    }
}

/// Result of fetching a job's files.
enum FetchOutcome {
    /// Finished frames, each with its file unless that is damaged.
    Files(Vec<(FrameRecord, Option<Bytes>)>),
    /// A file is missing or damaged.
    Refused,
    /// The job has expired, or its log is lost.
    JobGone,
}

/// Draws at least one and at most `most` of the frames, in their order.
pub(crate) fn choose_frames(frames: &[u32], most: usize, rng: &mut SmallRng) -> Vec<u32> {
    let chosen: Vec<u32> = frames.iter().copied().filter(|_| rng.random_range(0..2) == 0).take(most).collect();
    if chosen.is_empty() { frames.iter().copied().take(most).collect() } else { chosen }
}

fn log_lost() -> Refusal {
    Refusal::Unavailable { message: "the log was lost".into() }
}

/// Sends a request to the leading coordinator until it answers, also with a refusal. Stops when the log of the question is lost.
pub(crate) async fn ask_leader<T>(
    shared: &Shared,
    asked_at: RequestTime,
    request: &impl AsyncFn(Client) -> Result<T, CallError>,
) -> Result<T, Refusal> {
    while !shared.is_log_lost(asked_at) {
        let leader = url(&coordinator_name(shared.lock().leader));
        let answer = tokio::time::timeout(Duration::from_secs(5), async {
            let client = Client::connect_with(&dialer(shared, "person"), &leader).await?;
            request(client).await
        });
        match answer.await {
            Ok(Ok(answer)) => return Ok(answer),
            Ok(Err(CallError::Refused(no @ (Refusal::Unavailable { .. } | Refusal::NoRoom { .. })))) => {
                shared.trace(|| format!("person: {no}"));
            }
            Ok(Err(CallError::Refused(refusal))) => return Err(refusal),
            Ok(Err(error)) => shared.trace(|| format!("person: {error}")),
            Err(_) => shared.trace(|| "person: no answer".into()),
        }
        tokio::time::sleep(RETRY_INTERVAL).await;
    }
    Err(log_lost())
}

/// Drains a worker for a while.
pub(crate) async fn drain_random_worker(shared: &Shared, rng: &mut SmallRng, most: Duration) {
    let worker = WorkerSelector::Name(worker_name(rng.random_range(0..WORKERS)));
    let drain = async |client: Client| client.drain(worker.clone(), Drain::Begin).await;
    if ask_leader(shared, shared.request_time(), &drain).await.is_ok() {
        shared.lock().count_action("drained");
    }
    tokio::time::sleep(Duration::from_millis(rng.random_range(0..most.as_millis() as u64))).await;
    undrain_all(shared).await;
}

/// Ends the drain of every connected worker.
pub(crate) async fn undrain_all(shared: &Shared) {
    let undo = async |client: Client| -> Result<Vec<WorkerId>, CallError> {
        let mut opened = Vec::new();
        for worker in client.workers().await? {
            if worker.intake == Intake::Drained {
                opened.extend(client.drain(WorkerSelector::Number(worker.worker), Drain::Undo).await?);
            }
        }
        Ok(opened)
    };
    // A worker may have left in between.
    let _ = ask_leader(shared, shared.request_time(), &undo).await;
}
