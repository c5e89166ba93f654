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
use crate::faults::Hardship;
use crate::paces::Tempo;
use crate::people::{Curse, Errand, Manner, Person, Whim, answer, drain_a_while, open_all, some};
use crate::shared::Shared;
use crate::shelf::Shelf;
use crate::stage::Stage;
use crate::{drill, stage};

/// Habits of the people of a world.
const MANNER: Manner = Manner { look: Duration::from_millis(400), patience: Duration::from_secs(200) };
/// Approximate number of frames of all jobs of a world.
const FRAMES: usize = 5;
/// Age below which an artifact is never garbage.
const GRACE: Duration = Duration::from_secs(60);
/// Bytes of a large artifact, which is sent in several pieces.
const LARGE: usize = 5 << 19;
/// Longest time for which a worker is drained.
const DRAINED: Duration = Duration::from_secs(15);

/// The people of a world, and their errands.
#[derive(Debug)]
pub(crate) struct Cast {
    seed: u64,
    /// Errands of each person, in order.
    people: Vec<Vec<Errand>>,
    /// An operator drains workers.
    drains: bool,
    /// Number of people who upload the same large artifact at once. Some of them give up and start again.
    senders: u64,
    /// An operator collects garbage at the end.
    collects: bool,
    /// Jobs with very different task durations, with the time at which each is submitted.
    paced: Vec<(Errand, Duration)>,
}

impl Cast {
    /// Draws the cast of a seed.
    pub(crate) fn of(seed: u64) -> anyhow::Result<Self> {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x0ca5_7000);
        let mut drills = Drills::of(seed);
        let mut first_passes = FirstPasses::of(seed);
        let count = if drills.are_there { rng.random_range(1..=4).max(2) } else { rng.random_range(1..=4) };
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
            let stage = match (content, lit) {
                (Some(content), _) => Some(drill::stage(content)),
                (None, Some(number)) => Some(stage::lit(number)?),
                (None, None) => None,
            };
            let mut errand = errand(&mut own, left.min(2), stage)?;
            errand.key = if is_both { "both".into() } else { format!("{name} {place}") };
            errand.spec.owner = if is_both { "both".into() } else { name };
            if is_both {
                errand.whim = Whim::Nothing;
            }
            left -= errand.spec.frames.len().min(left);
            people[number].push(errand);
        }
        people.retain(|errands| !errands.is_empty());
        Ok(Self {
            seed,
            people,
            drains: rng.random_range(0..3) == 0,
            senders: if rng.random_range(0..8) == 0 && Hardship::Senders.is_there() {
                rng.random_range(2..4)
            } else {
                0
            },
            collects: seed % 16 == 5,
            paced: paced(seed)?,
        })
    }

    /// Returns the farm's settings. Owners have weights, and in some worlds jobs expire.
    pub(crate) fn config(&self) -> Config {
        let mut rng = SmallRng::seed_from_u64(self.seed ^ 0x0c0f_1600);
        let owners = (0..self.people.len()).map(|number| format!("person{number}"));
        let weights: BTreeMap<String, u32> = owners.map(|owner| (owner, rng.random_range(1..4))).collect();
        let keep_ended = (rng.random_range(0..4) == 0).then(|| rng.random_range(1_500..12_000));
        // Unneeded shared results expire at once, or all but the last one, or never.
        let schedule = if self.paced.is_empty() { stage::schedule(self.seed) } else { stage::paced() };
        let shared_bytes = [0, drill::BYTES, schedule.shared_bytes][(self.seed / 4 % 3) as usize];
        Config { weights, keep_ended, shared_bytes, ..schedule }
    }

    /// Runs all errands, and returns when all jobs have ended.
    pub(crate) async fn live(self, shared: Shared, shelf: Shelf) -> turmoil::Result {
        let mut rng = SmallRng::seed_from_u64(self.seed ^ 0x11fe_0000);
        let seeds: Vec<u64> = self.people.iter().map(|_| rng.random()).collect();
        let people = self.people.iter().zip(seeds).map(|(errands, seed)| live(errands, seed, &shared, &shelf));
        let large = large(self.seed);
        let senders = (0..self.senders).map(|number| send(&shared, &shelf, &large, self.seed ^ number));
        let drains = async {
            if self.drains {
                tokio::time::sleep(Duration::from_millis(rng.random_range(0..12_000))).await;
                drain_a_while(&shared, &mut rng, DRAINED).await;
                // A worker that was disconnected may still be drained when it reconnects.
                for _ in 0..8 {
                    tokio::time::sleep(Duration::from_secs(5)).await;
                    open_all(&shared).await;
                }
            }
        };
        let paced = self.paced.iter().map(|(errand, later)| comes_later(errand, *later, self.seed, &shared, &shelf));
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
            collect(&shared, &shelf).await;
        }
        Ok(())
    }
}

/// Draws the jobs of a world that are drills.
struct Drills {
    seed: u64,
    rng: SmallRng,
    are_there: bool,
}

impl Drills {
    /// Decides whether the world has drills. Every third world has some.
    fn of(seed: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x0d51_1100);
        let are_there = rng.random_range(0..3) == 0;
        Self { seed, rng, are_there }
    }

    /// Returns the content that most drills share.
    fn common(&self) -> Option<u64> {
        self.are_there.then_some(self.seed)
    }

    /// Draws the content of the next job, if it is a drill.
    fn draw(&mut self) -> Option<u64> {
        let own = self.rng.random();
        let content = if self.rng.random_range(0..3) > 0 { self.seed } else { own };
        (self.are_there && self.rng.random_range(0..4) > 0).then_some(content)
    }
}

/// Draws the jobs of a world that have a first pass.
struct FirstPasses {
    seed: u64,
    rng: SmallRng,
    are_there: bool,
}

impl FirstPasses {
    /// Decides whether the world has first passes. Every third world has some, with or without drills.
    fn of(seed: u64) -> Self {
        let mut rng = SmallRng::seed_from_u64(seed ^ 0x0f12_5700);
        let are_there = rng.random_range(0..3) == 0;
        Self { seed, rng, are_there }
    }

    /// Returns the number of the job that two people submit with one key.
    fn common(&self) -> Option<u64> {
        self.are_there.then_some(self.seed)
    }

    /// Draws the number of the next job, if it has a first pass.
    fn draw(&mut self) -> Option<u64> {
        let number = self.rng.random();
        (self.are_there && self.rng.random_range(0..2) == 0).then_some(number)
    }
}

/// - `special`: job that replaces the path-traced one.
fn errand(rng: &mut SmallRng, most: usize, special: Option<Stage>) -> anyhow::Result<Errand> {
    let rendered = stage::pick(rng.random_range(0..Stage::COUNT))?;
    let stage = special.unwrap_or_else(|| rendered.clone());
    let curse = match rng.random_range(0..24) {
        0..4 => Curse::NowAndThen,
        4 => Curse::Always,
        5 if Hardship::Deadly.is_there() => Curse::Deadly,
        _ => Curse::Nothing,
    };
    let frames = some(&stage.spec.frames, most, rng);
    let spec = JobSpec {
        name: curse.name().into(),
        priority: if rng.random_range(0..2) == 0 { 50 } else { rng.random_range(0..=100) },
        ..stage.of_frames(frames)
    };
    let whim = Whim::pick(rng);
    let pauses = [0..9_000, 1_000..12_000].map(|range| Duration::from_millis(rng.random_range(range)));
    Ok(Errand { key: String::new(), spec, stage, whim, pauses })
}

/// Draws two more people in every fourth world. The tasks of one take milliseconds, those of the other seconds. Each has frames to
/// finish while the other's tasks wait. A separate random sequence keeps the other worlds unchanged.
fn paced(seed: u64) -> anyhow::Result<Vec<(Errand, Duration)>> {
    let mut rng = SmallRng::seed_from_u64(seed ^ 0x0c0d_7e30);
    if rng.random_range(0..4) > 0 {
        return Ok(Vec::new());
    }
    let mut errand = |tempo: Tempo, rounds: usize, frames: usize| {
        let stage = stage::even(rounds)?;
        let frames = stage.spec.frames[..frames].to_vec();
        let spec = JobSpec { owner: tempo.owner().into(), ..stage.of_frames(frames) };
        let later = Duration::from_millis(rng.random_range(0..6_000));
        let key = tempo.owner().to_owned();
        anyhow::Ok((Errand { key, spec, stage, whim: Whim::Nothing, pauses: [Duration::ZERO; 2] }, later))
    };
    Ok(vec![errand(Tempo::Quick, 3, 3)?, errand(Tempo::Slow, 1, 2)?])
}

async fn comes_later(
    errand: &Errand,
    later: Duration,
    seed: u64,
    shared: &Shared,
    shelf: &Shelf,
) -> anyhow::Result<()> {
    tokio::time::sleep(later).await;
    live(std::slice::from_ref(errand), seed ^ u64::from(errand.stage.spec.rounds().len() as u32), shared, shelf).await
}

async fn live(errands: &[Errand], seed: u64, shared: &Shared, shelf: &Shelf) -> anyhow::Result<()> {
    let mut rng = SmallRng::seed_from_u64(seed);
    shared.lock().left += 1;
    for errand in errands {
        Person { shared, shelf, rng: &mut rng, manner: MANNER }.runs(errand).await?;
    }
    shared.lock().left -= 1;
    Ok(())
}

/// Returns the bytes of a large artifact that differs from all others.
fn large(seed: u64) -> Bytes {
    let block: [u8; 32] = *blake3::hash(&seed.to_le_bytes()).as_bytes();
    block.iter().copied().cycle().take(LARGE).collect()
}

/// Uploads a large artifact that others upload at the same time. The first try may be abandoned and repeated. No upload may be
/// refused because of another one.
async fn send(shared: &Shared, shelf: &Shelf, bytes: &Bytes, seed: u64) {
    let mut rng = SmallRng::seed_from_u64(seed);
    let put = async |client: Client| {
        let is_well = shelf.is_well();
        let put = client.put(bytes.clone()).await;
        if let Err(CallError::Refused(Refusal::Unavailable { message })) = &put
            && is_well
            && shelf.is_well()
        {
            shared.lock().wrong.push(Violation::Upload { message: message.clone() });
        }
        put
    };
    if rng.random_range(0..2) == 0 {
        let patience = Duration::from_millis(rng.random_range(20..200));
        if tokio::time::timeout(patience, answer(shared, shared.asks(), &put)).await.is_err() {
            shared.lock().did("abandoned an upload");
        }
    }
    if answer(shared, shared.asks(), &put).await.is_ok() {
        shared.lock().did("sent something large");
    }
}

/// Collects garbage when all jobs have ended and all artifacts are old. Then the store must contain exactly the artifacts that the
/// log references.
async fn collect(shared: &Shared, shelf: &Shelf) {
    tokio::time::sleep(GRACE + Duration::from_secs(5)).await;
    let collect = async |client: Client| client.collect(CollectMode::Remove, GRACE).await;
    let asked = shared.asks();
    if answer(shared, asked, &collect).await.is_err() {
        return;
    }
    let mut state = shared.lock();
    state.did("garbage collected");
    let Ok(ledger) = state.disk.ledger() else { return };
    let (there, named) = (shelf.all(), ledger.references());
    let missing = named.difference(&there).filter(|digest| !state.harmed.contains(digest)).count();
    let left = there.difference(&named).count();
    if left > 0 || missing > 0 {
        state.wrong.push(Violation::Garbage { left: left as u64, missing: missing as u64 });
    }
}
