//! People of a long run: people with jobs, and an operator.

use std::time::Duration;

use femc_model::{JobId, JobSpec};
use femc_proto::{Client, CollectMode};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

use super::Soak;
use super::book::Book;
use crate::faults::Hardship;
use crate::people::{Curse, Errand, Manner, Person, Whim, answer, drain_a_while, open_all, some};
use crate::shared::Shared;
use crate::shelf::Shelf;
use crate::stage;

/// Number of people with jobs.
pub(super) const PERSONS: u64 = 3;
/// Habits of the people of a long run.
const MANNER: Manner = Manner { look: Duration::from_secs(2), patience: Duration::from_secs(1800) };
/// Age below which an artifact is never garbage.
const GRACE: Duration = Duration::from_secs(300);
/// Longest time for which a worker is drained.
const DRAINED: Duration = Duration::from_secs(60);

pub(super) fn name(number: u64) -> String {
    format!("person{number}")
}

fn now() -> Duration {
    turmoil::sim_elapsed().unwrap_or_default()
}

/// Runs one job after the other until the time is over.
pub(super) async fn person(soak: Soak, number: u64, shared: Shared, shelf: Shelf, book: Book) -> turmoil::Result {
    let name = name(number);
    let mut rng = SmallRng::seed_from_u64(soak.draw(&name));
    let mut jobs = 0;
    while now() < soak.time {
        jobs += 1;
        let errand = errand(&mut rng, &name, jobs)?;
        let job: JobId = Person { shared: &shared, shelf: &shelf, rng: &mut rng, manner: MANNER }.runs(&errand).await?;
        book.ended(job, now());
        shared.lock().ends = crate::hosts::ends();
    }
    Ok(())
}

fn errand(rng: &mut SmallRng, owner: &str, number: u64) -> anyhow::Result<Errand> {
    let stage = stage::fresh(rng.random())?;
    let curse = match rng.random_range(0..32) {
        0..4 => Curse::NowAndThen,
        4 => Curse::Always,
        5 if Hardship::Deadly.is_there() => Curse::Deadly,
        _ => Curse::Nothing,
    };
    let spec = JobSpec {
        name: curse.name().into(),
        frames: some(&stage.spec.frames, stage.spec.frames.len(), rng),
        priority: rng.random_range(0..=100),
        owner: owner.to_owned(),
        ..stage.spec.clone()
    };
    let whim = Whim::pick(rng);
    let pauses = [0..15_000, 8_000..25_000].map(|range| Duration::from_millis(rng.random_range(range)));
    Ok(Errand { key: format!("{owner} {number}"), spec, stage, whim, pauses })
}

/// Drains a worker now and then, ends the drain, and removes garbage.
pub(super) async fn operator(soak: Soak, shared: Shared) -> turmoil::Result {
    let mut rng = SmallRng::seed_from_u64(soak.draw("operator"));
    while now() < soak.time {
        tokio::time::sleep(Duration::from_secs(rng.random_range(0..600))).await;
        drain_a_while(&shared, &mut rng, DRAINED).await;
        let collect = async |client: Client| client.collect(CollectMode::Remove, GRACE).await;
        if answer(&shared, shared.asks(), &collect).await.is_ok() {
            shared.lock().did("garbage collected");
        }
    }
    // Disconnected workers may still be drained when they reconnect, and the last jobs need a working one.
    for _ in 0..10 {
        open_all(&shared).await;
        tokio::time::sleep(Duration::from_secs(10)).await;
    }
    Ok(())
}
