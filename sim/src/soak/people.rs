//! People of a long run: people with jobs, and an operator.

use std::time::Duration;

use femc_model::{JobId, JobSpec};
use femc_proto::{Client, CollectMode};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

use super::Soak;
use super::audit_queue::AuditQueue;
use crate::faults::RiskyFault;
use crate::faulty_medium::FaultyMedium;
use crate::people::{
    InjectedFailure, Intervention, JobRequest, Person, Timing, ask_leader, choose_frames, drain_random_worker,
    undrain_all,
};
use crate::shared::Shared;
use crate::test_jobs;

/// Number of people with jobs.
pub(super) const PERSONS: u64 = 3;
/// Habits of the people of a long run.
const TIMING: Timing = Timing { poll_interval: Duration::from_secs(2), timeout: Duration::from_secs(1800) };
/// Age below which an artifact is never garbage.
const GRACE_PERIOD: Duration = Duration::from_secs(300);
/// Longest time for which a worker is drained.
const MAX_DRAIN: Duration = Duration::from_secs(60);

pub(super) fn name(number: u64) -> String {
    format!("person{number}")
}

fn now() -> Duration {
    turmoil::sim_elapsed().unwrap_or_default()
}

/// Runs one job after the other until the time is over.
pub(super) async fn person(
    soak: Soak,
    number: u64,
    shared: Shared,
    medium: FaultyMedium,
    audit_queue: AuditQueue,
) -> turmoil::Result {
    let name = name(number);
    let mut rng = SmallRng::seed_from_u64(soak.draw(&name));
    let mut jobs = 0;
    while now() < soak.time {
        jobs += 1;
        let request = draw_request(&mut rng, &name, jobs)?;
        let job: JobId =
            Person { shared: &shared, medium: &medium, rng: &mut rng, timing: TIMING }.run_job(&request).await?;
        audit_queue.push(job, now());
        shared.lock().connection_ends = crate::hosts::connection_ends();
    }
    Ok(())
}

fn draw_request(rng: &mut SmallRng, owner: &str, number: u64) -> anyhow::Result<JobRequest> {
    let test_job = test_jobs::fresh_job(rng.random())?;
    let injected = match rng.random_range(0..32) {
        0..4 => InjectedFailure::RandomPanics,
        4 => InjectedFailure::RepeatedPanic,
        5 if RiskyFault::WorkerKillers.is_enabled() => InjectedFailure::KillsWorker,
        _ => InjectedFailure::Nothing,
    };
    let spec = JobSpec {
        name: injected.name().into(),
        frames: choose_frames(&test_job.spec.frames, test_job.spec.frames.len(), rng),
        priority: rng.random_range(0..=100),
        owner: owner.to_owned(),
        ..test_job.spec.clone()
    };
    let intervention = Intervention::draw(rng);
    let pauses = [0..15_000, 8_000..25_000].map(|range| Duration::from_millis(rng.random_range(range)));
    Ok(JobRequest { key: format!("{owner} {number}"), spec, test_job, intervention, pauses })
}

/// Drains a worker now and then, ends the drain, and removes garbage.
pub(super) async fn operator(soak: Soak, shared: Shared) -> turmoil::Result {
    let mut rng = SmallRng::seed_from_u64(soak.draw("operator"));
    while now() < soak.time {
        tokio::time::sleep(Duration::from_secs(rng.random_range(0..600))).await;
        drain_random_worker(&shared, &mut rng, MAX_DRAIN).await;
        let collect = async |client: Client| client.collect(CollectMode::Remove, GRACE_PERIOD).await;
        if ask_leader(&shared, shared.request_time(), &collect).await.is_ok() {
            shared.lock().count_action("garbage collected");
        }
    }
    // Disconnected workers may still be drained when they reconnect, and the last jobs need a working one.
    for _ in 0..10 {
        undrain_all(&shared).await;
        tokio::time::sleep(Duration::from_secs(10)).await;
    }
    Ok(())
}
