//! The people of a world. The seed decides everything about them before the world begins.

use std::collections::BTreeMap;
use std::time::Duration;

use bytes::Bytes;
use femc_model::{JobSpec, Refusal};
use femc_proto::{CallError, Client, CollectMode};
use femc_schedule::Config;
use futures_util::future::join_all;
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

use crate::audit::Violation;
use crate::faults::RiskyFault;
use crate::faulty_medium::FaultyMedium;
use crate::people::{
    InjectedFailure, Intervention, JobRequest, Person, Timing, ask_leader, choose_frames, drain_random_worker,
    undrain_all,
};
use crate::shared::Shared;
use crate::task_durations::JobPace;
use crate::test_jobs::TestJob;
use crate::{drill, test_jobs};

/// Habits of the people of a world.
const TIMING: Timing = Timing { poll_interval: Duration::from_millis(400), timeout: Duration::from_secs(200) };
/// Approximate number of frames of all jobs of a world.
const FRAMES: usize = 5;
/// Age below which an artifact is never garbage.
const GRACE_PERIOD: Duration = Duration::from_secs(60);
/// Bytes of a large artifact, which is sent in several pieces.
const LARGE_ARTIFACT_BYTES: usize = 5 << 19;
/// Longest time for which a worker is drained.
const MAX_DRAIN: Duration = Duration::from_secs(15);

/// The people of a world, and their job requests.
#[derive(Debug)]
pub(crate) struct Workload {
    seed: u64,
    /// Errands of each person, in order.
    people: Vec<Vec<JobRequest>>,
    /// An operator drains workers.
    drains: bool,
    /// Number of people who upload the same large artifact at once. Some of them give up and start again.
    concurrent_uploaders: u64,
    /// An operator collects garbage at the end.
    collects: bool,
    /// Jobs with very different task durations, with the time at which each is submitted.
    paced_jobs: Vec<(JobRequest, Duration)>,
}

impl Workload {
    /// Draws the cast of a seed.
    pub(crate) fn from_seed(seed: u64) -> anyhow::Result<Self> {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x0ca5_7000);
        let mut drills = Drills::from_seed(seed);
        let mut first_passes = FirstPasses::from_seed(seed);
        let count = if drills.are_enabled { rng.random_range(1..=4).max(2) } else { rng.random_range(1..=4) };
        let is_shared = rng.random_range(0..3) == 0;
        let (mut left, mut people) = (FRAMES, vec![Vec::new(); count]);
        for place in 0..2 * count {
            let number = place % count;
            let is_first = place < count;
            if left == 0 || (!is_first && rng.random_range(0..2) == 0) {
                continue;
            }
            let name = format!("person{number}");
            // Two people with one key submit the same job.
            let is_both = is_first && is_shared && number < 2 && count > 1;
            let mut own = if is_both { SmallRng::seed_from_u64(seed) } else { SmallRng::seed_from_u64(rng.random()) };
            let content = if is_both { drills.common() } else { drills.draw() };
            let lit = if is_both { first_passes.common() } else { first_passes.draw() };
            let test_job = match (content, lit) {
                (Some(content), _) => Some(drill::drill_job(content)),
                (None, Some(number)) => Some(test_jobs::first_pass_job(number)?),
                (None, None) => None,
            };
            let mut request = draw_request(&mut own, left.min(2), test_job)?;
            request.key = if is_both { "both".into() } else { format!("{name} {place}") };
            request.spec.owner = if is_both { "both".into() } else { name };
            if is_both {
                request.intervention = Intervention::Nothing;
            }
            left -= request.spec.frames.len().min(left);
            people[number].push(request);
        }
        people.retain(|requests| !requests.is_empty());
        Ok(Self {
            seed,
            people,
            drains: rng.random_range(0..3) == 0,
            concurrent_uploaders: if rng.random_range(0..8) == 0 && RiskyFault::ConcurrentUploads.is_enabled() {
                rng.random_range(2..4)
            } else {
                0
            },
            collects: seed % 16 == 5,
            paced_jobs: draw_paced_jobs(seed)?,
        })
    }

    /// Returns the farm's settings. Owners have weights, and in some worlds jobs expire.
    pub(crate) fn config(&self) -> Config {
        let mut rng = SmallRng::seed_from_u64(self.seed ^ 0x0c0f_1600);
        let owners = (0..self.people.len()).map(|number| format!("person{number}"));
        let weights: BTreeMap<String, u32> = owners.map(|owner| (owner, rng.random_range(1..4))).collect();
        let keep_ended = (rng.random_range(0..4) == 0).then(|| rng.random_range(1_500..12_000));
        // Unneeded shared results expire at once, or all but the last one, or never.
        let schedule =
            if self.paced_jobs.is_empty() { test_jobs::config(self.seed) } else { test_jobs::realistic_queue_config() };
        let shared_bytes = [0, drill::CACHE_BYTES, schedule.shared_bytes][(self.seed / 4 % 3) as usize];
        Config { weights, keep_ended, shared_bytes, ..schedule }
    }

    /// Runs all job requests, and returns when all jobs have ended.
    pub(crate) async fn run(self, shared: Shared, medium: FaultyMedium) -> turmoil::Result {
        let mut rng = SmallRng::seed_from_u64(self.seed ^ 0x11fe_0000);
        let seeds: Vec<u64> = self.people.iter().map(|_| rng.random()).collect();
        let people = self.people.iter().zip(seeds).map(|(requests, seed)| run_person(requests, seed, &shared, &medium));
        let large = large_artifact(self.seed);
        let senders =
            (0..self.concurrent_uploaders).map(|number| upload_large(&shared, &medium, &large, self.seed ^ number));
        let drains = async {
            if self.drains {
                tokio::time::sleep(Duration::from_millis(rng.random_range(0..12_000))).await;
                drain_random_worker(&shared, &mut rng, MAX_DRAIN).await;
                // A worker that was disconnected may still be drained when it reconnects.
                for _ in 0..8 {
                    tokio::time::sleep(Duration::from_secs(5)).await;
                    undrain_all(&shared).await;
                }
            }
        };
        let paced =
            self.paced_jobs.iter().map(|(request, later)| run_later(request, *later, self.seed, &shared, &medium));
        let lives = async {
            let (lived, paced, _) =
                futures_util::future::join3(join_all(people), join_all(paced), join_all(senders)).await;
            lived.into_iter().chain(paced).collect::<Vec<_>>()
        };
        tokio::pin!(drains, lives);
        // The world does not wait for the operator.
        let lived = tokio::select! {
            biased;
            lived = &mut lives => lived,
            () = &mut drains => lives.await,
        };
        lived.into_iter().collect::<anyhow::Result<Vec<()>>>()?;
        if self.collects {
            collect_garbage(&shared, &medium).await;
        }
        Ok(())
    }
}

/// Draws the jobs of a world that are drills.
struct Drills {
    seed: u64,
    rng: SmallRng,
    are_enabled: bool,
}

impl Drills {
    /// Decides whether the world has drills. Every third world has some.
    fn from_seed(seed: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x0d51_1100);
        let are_there = rng.random_range(0..3) == 0;
        Self { seed, rng, are_enabled: are_there }
    }

    /// Returns the content that most drills share.
    fn common(&self) -> Option<u64> {
        self.are_enabled.then_some(self.seed)
    }

    /// Draws the content of the next job, if it is a drill.
    fn draw(&mut self) -> Option<u64> {
        let own = self.rng.random();
        let content = if self.rng.random_range(0..3) > 0 { self.seed } else { own };
        (self.are_enabled && self.rng.random_range(0..4) > 0).then_some(content)
    }
}

/// Draws the jobs of a world that have a first pass.
struct FirstPasses {
    seed: u64,
    rng: SmallRng,
    are_enabled: bool,
}

impl FirstPasses {
    /// Decides whether the world has first passes. Every third world has some, with or without drills.
    fn from_seed(seed: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x0f12_5700);
        let are_there = rng.random_range(0..3) == 0;
        Self { seed, rng, are_enabled: are_there }
    }

    /// Returns the number of the job that two people submit with one key.
    fn common(&self) -> Option<u64> {
        self.are_enabled.then_some(self.seed)
    }

    /// Draws the number of the next job, if it has a first pass.
    fn draw(&mut self) -> Option<u64> {
        let number = self.rng.random();
        (self.are_enabled && self.rng.random_range(0..2) == 0).then_some(number)
    }
}

/// - `special`: job that replaces the path-traced one.
fn draw_request(rng: &mut SmallRng, most: usize, special: Option<TestJob>) -> anyhow::Result<JobRequest> {
    let rendered = test_jobs::path_traced_job(rng.random_range(0..TestJob::COUNT))?;
    let test_job = special.unwrap_or_else(|| rendered.clone());
    let injected = match rng.random_range(0..24) {
        0..4 => InjectedFailure::RandomPanics,
        4 => InjectedFailure::RepeatedPanic,
        5 if RiskyFault::WorkerKillers.is_enabled() => InjectedFailure::KillsWorker,
        _ => InjectedFailure::Nothing,
    };
    let frames = choose_frames(&test_job.spec.frames, most, rng);
    let spec = JobSpec {
        name: injected.name().into(),
        priority: if rng.random_range(0..2) == 0 { 50 } else { rng.random_range(0..=100) },
        ..test_job.with_frames(frames)
    };
    let intervention = Intervention::draw(rng);
    let pauses = [0..9_000, 1_000..12_000].map(|range| Duration::from_millis(rng.random_range(range)));
    Ok(JobRequest { key: String::new(), spec, test_job, intervention, pauses })
}

/// Draws two more people in every fourth world. The tasks of one take milliseconds, those of the other seconds. Each has frames to
/// finish while the other's tasks wait. A separate random sequence keeps the other worlds unchanged.
fn draw_paced_jobs(seed: u64) -> anyhow::Result<Vec<(JobRequest, Duration)>> {
    let mut rng = SmallRng::seed_from_u64(seed ^ 0x0c0d_7e30);
    if rng.random_range(0..4) > 0 {
        return Ok(Vec::new());
    }
    let mut request = |tempo: JobPace, rounds: usize, frames: usize| {
        let test_job = test_jobs::even_job(rounds)?;
        let frames = test_job.spec.frames[..frames].to_vec();
        let spec = JobSpec { owner: tempo.owner().into(), ..test_job.with_frames(frames) };
        let later = Duration::from_millis(rng.random_range(0..6_000));
        let key = tempo.owner().to_owned();
        anyhow::Ok((
            JobRequest { key, spec, test_job, intervention: Intervention::Nothing, pauses: [Duration::ZERO; 2] },
            later,
        ))
    };
    Ok(vec![request(JobPace::Quick, 3, 3)?, request(JobPace::Slow, 1, 2)?])
}

async fn run_later(
    request: &JobRequest,
    later: Duration,
    seed: u64,
    shared: &Shared,
    medium: &FaultyMedium,
) -> anyhow::Result<()> {
    tokio::time::sleep(later).await;
    run_person(
        std::slice::from_ref(request),
        seed ^ u64::from(request.test_job.spec.rounds().len() as u32),
        shared,
        medium,
    )
    .await
}

async fn run_person(requests: &[JobRequest], seed: u64, shared: &Shared, medium: &FaultyMedium) -> anyhow::Result<()> {
    let mut rng = SmallRng::seed_from_u64(seed);
    shared.lock().waiting_people += 1;
    for request in requests {
        Person { shared, medium, rng: &mut rng, timing: TIMING }.run_job(request).await?;
    }
    shared.lock().waiting_people -= 1;
    Ok(())
}

/// Returns the bytes of a large artifact that differs from all others.
fn large_artifact(seed: u64) -> Bytes {
    let block: [u8; 32] = *blake3::hash(&seed.to_le_bytes()).as_bytes();
    block.iter().copied().cycle().take(LARGE_ARTIFACT_BYTES).collect()
}

/// Uploads a large artifact that others upload at the same time. The first try may be abandoned and repeated. No upload may be
/// refused because of another one.
async fn upload_large(shared: &Shared, medium: &FaultyMedium, bytes: &Bytes, seed: u64) {
    let mut rng = SmallRng::seed_from_u64(seed);
    let put = async |client: Client| {
        let is_well = medium.is_healthy();
        let put = client.put(bytes.clone()).await;
        if let Err(CallError::Refused(Refusal::Unavailable { message })) = &put
            && is_well
            && medium.is_healthy()
        {
            shared.lock().violations.push(Violation::UploadRefused { message: message.clone() });
        }
        put
    };
    if rng.random_range(0..2) == 0 {
        let patience = Duration::from_millis(rng.random_range(20..200));
        if tokio::time::timeout(patience, ask_leader(shared, shared.request_time(), &put)).await.is_err() {
            shared.lock().count_action("abandoned an upload");
        }
    }
    if ask_leader(shared, shared.request_time(), &put).await.is_ok() {
        shared.lock().count_action("sent something large");
    }
}

/// Collects garbage when all jobs have ended and all artifacts are old. Then the store must contain exactly the artifacts that the
/// log references.
async fn collect_garbage(shared: &Shared, medium: &FaultyMedium) {
    tokio::time::sleep(GRACE_PERIOD + Duration::from_secs(5)).await;
    let collect = async |client: Client| client.collect(CollectMode::Remove, GRACE_PERIOD).await;
    let asked_at = shared.request_time();
    if ask_leader(shared, asked_at, &collect).await.is_err() {
        return;
    }
    let mut state = shared.lock();
    state.count_action("garbage collected");
    let Ok(ledger) = state.disk.ledger() else { return };
    let (there, named) = (medium.digests(), ledger.references());
    let missing = named.difference(&there).filter(|digest| !state.damaged.contains(digest)).count();
    let left = there.difference(&named).count();
    if left > 0 || missing > 0 {
        state.violations.push(Violation::WrongGarbage { left: left as u64, missing: missing as u64 });
    }
}
