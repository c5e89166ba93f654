//! Who comes to the farm: people with jobs, who change their minds, and an operator.

use std::time::Duration;

use femc_model::{Control, Drain, Intake, JobId, JobSpec, JobState, JobStatus, Refusal, WorkerName};
use femc_proto::{CallError, Client, CollectMode};
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};

use super::Soak;
use super::book::Book;
use crate::audit::{Violation, account};
use crate::faults::WORKERS;
use crate::hosts::worker_name;
use crate::person::{answer, frames, insist};
use crate::shared::Shared;
use crate::stage::{self, Stage};

/// People with jobs.
pub(super) const PERSONS: u64 = 3;
/// A job that takes longer has come to nothing.
const PATIENCE: Duration = Duration::from_secs(1800);
/// Between two questions whether a job has ended.
const LOOK: Duration = Duration::from_secs(2);
/// What is younger is no garbage.
const GRACE: Duration = Duration::from_secs(300);

/// What comes to a person's mind while a job runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Whim {
    Nothing,
    PauseAWhile,
    Cancel,
    CancelAndRetry,
    Priority(u8),
}

/// How a job may end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expected {
    Done,
    Cancelled,
    /// Nobody heard whether the cancellation or the end came first.
    Either,
}

pub(super) fn name(number: u64) -> String {
    format!("person{number}")
}

fn now() -> Duration {
    turmoil::sim_elapsed().unwrap_or_default()
}

/// One job after the other, until the time is over.
pub(super) async fn person(soak: Soak, number: u64, shared: Shared, book: Book) -> turmoil::Result {
    let name = name(number);
    let mut rng = SmallRng::seed_from_u64(soak.draw(&name));
    let mut jobs = 0;
    while now() < soak.time {
        jobs += 1;
        let stage = stage::fresh(rng.random())?;
        let spec = JobSpec {
            frames: some(&stage.spec.frames, &mut rng),
            priority: rng.random_range(0..=100),
            owner: name.clone(),
            ..stage.spec.clone()
        };
        let key = Some(format!("{name} {jobs}"));
        let job = insist(&shared, async |client: Client| {
            client.put(stage.bundle.clone()).await?;
            client.submit(key.clone(), spec.clone()).await
        })
        .await;
        let outcome = tokio::time::timeout(PATIENCE, follow(job, &spec, &stage, &mut rng, &shared, &book)).await;
        let wrong = match outcome {
            Ok(wrong) => wrong?,
            Err(_) => vec![stuck(job, &shared).await],
        };
        shared.lock().wrong.extend(wrong.into_iter().map(|violation| violation.of(job)));
        book.ended(job, now());
        shared.lock().ends = crate::hosts::ends();
    }
    Ok(())
}

/// At least one of them, in their order.
fn some(frames: &[u32], rng: &mut SmallRng) -> Vec<u32> {
    let chosen: Vec<u32> = frames.iter().copied().filter(|_| rng.random_range(0..2) == 0).collect();
    if chosen.is_empty() { frames.to_vec() } else { chosen }
}

/// Stays with a job to its end, and says what was wrong with it.
async fn follow(
    job: JobId,
    spec: &JobSpec,
    stage: &Stage,
    rng: &mut SmallRng,
    shared: &Shared,
    book: &Book,
) -> anyhow::Result<Vec<Violation>> {
    let whim = whim(rng);
    let [first, second] = [0..15_000, 8_000..25_000].map(|range| Duration::from_millis(rng.random_range(range)));
    tokio::time::sleep(first).await;
    let expected = indulge(whim, job, second, shared, book).await;
    let status = loop {
        let status = insist(shared, async |client: Client| client.status(job).await).await;
        if status.state.has_ended() {
            break status;
        }
        tokio::time::sleep(LOOK).await;
    };
    let files = insist(shared, async |client: Client| frames(&client, job).await).await;
    let mut wrong = ended(spec, &status, expected);
    book.did(if status.state == JobState::Done { "done" } else { "cancelled" });
    if files.len() as u64 != u64::from(status.frames_done) {
        let (found, expected) = (files.len() as u64, status.frames_done.into());
        wrong.push(Violation::Account { what: "frames fetched", found, expected });
    }
    for (record, file) in files {
        let found = stage::pixels(file)?;
        let frame = stage.spec.frames.iter().position(|&frame| frame == record.frame).unwrap_or_default();
        if found != stage.pixels[frame] {
            wrong.push(Violation::Pixels { frame, found, expected: stage.pixels[frame].clone() });
        }
    }
    Ok(wrong)
}

/// What there is to say of a job that does not end.
async fn stuck(job: JobId, shared: &Shared) -> Violation {
    let state = match answer(shared, &async |client: Client| client.status(job).await).await {
        Ok(status) => format!("{:?}, waiting: {:?}", status.state, status.waits),
        Err(refusal) => refusal.to_string(),
    };
    Violation::Stuck { seconds: PATIENCE.as_secs(), state }
}

fn whim(rng: &mut SmallRng) -> Whim {
    match rng.random_range(0..10) {
        0 => Whim::PauseAWhile,
        1 => Whim::Cancel,
        2 => Whim::CancelAndRetry,
        3 | 4 => Whim::Priority(rng.random_range(0..=100)),
        _ => Whim::Nothing,
    }
}

/// Does it; how the job may end then. What a person has asked for in vain may still be on its way: the next word waits for so long
/// that it comes last.
async fn indulge(whim: Whim, job: JobId, pause: Duration, shared: &Shared, book: &Book) -> Expected {
    let steer =
        async |control: Control| answer(shared, &async |client: Client| client.control(job, control).await).await;
    match whim {
        Whim::Nothing => Expected::Done,
        Whim::PauseAWhile => {
            if steer(Control::Pause).await.is_ok() {
                book.did("paused");
            }
            tokio::time::sleep(pause).await;
            // One that has ended meanwhile need not go on.
            let _ = steer(Control::Resume).await;
            Expected::Done
        }
        Whim::Cancel => match steer(Control::Cancel).await {
            Ok(()) => Expected::Cancelled,
            Err(_) => Expected::Either,
        },
        Whim::CancelAndRetry => {
            // What has ended cannot be cancelled, and what is done cannot be tried again: both are well.
            let _ = steer(Control::Cancel).await;
            tokio::time::sleep(pause).await;
            if steer(Control::Retry).await.is_ok() {
                book.did("retried");
            }
            Expected::Done
        }
        Whim::Priority(priority) => {
            if steer(Control::Priority(priority)).await.is_ok() {
                book.did("priority changed");
            }
            Expected::Done
        }
    }
}

fn ended(spec: &JobSpec, status: &JobStatus, expected: Expected) -> Vec<Violation> {
    match (status.state, expected) {
        (JobState::Done, Expected::Done | Expected::Either) => account(spec, status),
        (JobState::Cancelled, Expected::Cancelled | Expected::Either) => Vec::new(),
        _ => vec![Violation::Failed { state: format!("{:?} ({:?})", status.state, status.failure) }],
    }
}

/// Drains a worker now and then, lets it work again, and removes garbage.
pub(super) async fn operator(soak: Soak, shared: Shared, book: Book) -> turmoil::Result {
    let mut rng = SmallRng::seed_from_u64(soak.draw("operator"));
    while now() < soak.time {
        tokio::time::sleep(Duration::from_secs(rng.random_range(0..600))).await;
        let worker = WorkerName::Name(worker_name(rng.random_range(0..WORKERS)));
        if answer(&shared, &async |client: Client| client.drain(worker.clone(), Drain::Begin).await).await.is_ok() {
            book.did("drained");
        }
        tokio::time::sleep(Duration::from_secs(rng.random_range(0..60))).await;
        open_all(&shared).await;
        let collect = async |client: Client| client.collect(CollectMode::Remove, GRACE).await;
        if answer(&shared, &collect).await.is_ok() {
            book.did("garbage collected");
        }
    }
    // Some that are away may come back as drained, and the last jobs need one that works.
    for _ in 0..10 {
        open_all(&shared).await;
        tokio::time::sleep(Duration::from_secs(10)).await;
    }
    Ok(())
}

/// Every worker that is there may work.
async fn open_all(shared: &Shared) {
    let undo = async |client: Client| -> Result<(), CallError> {
        for worker in client.workers().await? {
            if worker.intake == Intake::Drained {
                client.drain(WorkerName::Number(worker.worker), Drain::Undo).await?;
            }
        }
        Ok(())
    };
    // One that has left in between is not there.
    let _: Result<(), Refusal> = answer(shared, &undo).await;
}
