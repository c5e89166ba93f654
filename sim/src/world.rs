//! Runs one world from start to end.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::audit::{Violation, audit};
use crate::fault_injector::FaultInjector;
use crate::faults::FaultPlan;
use crate::faulty_medium::FaultyMedium;
use crate::hosts;
use crate::shared::Shared;
use crate::workload::Workload;

/// Step of the simulated time.
const TICK: Duration = Duration::from_millis(5);
/// Time by which all jobs must have ended.
const WORLD_TIMEOUT: Duration = Duration::from_secs(360);

/// Result of a world.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Violations that occurred.
    pub violations: Vec<Violation>,
    /// Number of times that each kind of fault took effect.
    pub fired: BTreeMap<&'static str, u32>,
    /// Simulated seconds.
    pub seconds: f64,
    /// Digest of all messages and records. Equal seeds give equal digests.
    pub trace: String,
    /// All messages, one line each, if requested.
    pub story: Vec<String>,
    /// Counts of actions of people and of ends of jobs.
    pub counts: BTreeMap<&'static str, u64>,
    /// Number of results that arrived after their lease or twice, and changed nothing.
    pub stale: u64,
}

/// Runs the world of this seed and plan. `detail`: whether all messages are kept.
pub fn run_world(seed: u64, plan: &FaultPlan, detail: RunDetail) -> anyhow::Result<Outcome> {
    let workload = Workload::from_seed(seed)?;
    align_task_ids()?;
    let shared = Shared::new(seed, detail == RunDetail::Story);
    let (medium, scheduler) = (FaultyMedium::new(&shared), workload.config());
    shared.lock().history.keep_ended = scheduler.keep_ended;
    shared.lock().charges.weights = scheduler.weights.clone();
    let mut sim = hosts::build_sim(seed, [TICK, WORLD_TIMEOUT], &shared, &medium, &scheduler);
    sim.client("people", workload.run(shared.clone(), medium.clone()));
    let mut injector = FaultInjector::default();
    injector.plan_storm(Duration::ZERO, plan, &shared);
    let broken = loop {
        match sim.step() {
            Ok(true) => break None,
            Ok(false) => injector.run_due(&mut sim, &shared, &medium),
            Err(error) => break Some(error.to_string()),
        }
    };
    let state = shared.lock();
    let mut violations = audit(&state);
    violations.extend(broken.filter(|_| state.waiting_people == 0).map(Violation::Simulation));
    Ok(Outcome {
        violations,
        fired: state.fired.clone(),
        seconds: sim.elapsed().as_secs_f64(),
        trace: state.trace.finalize().to_hex().to_string(),
        story: state.story.clone().unwrap_or_default(),
        stale: state.stale,
        counts: state.counts.clone(),
    })
}

/// Makes task numbers reproducible: every world begins at a number with the same remainder. Tokio numbers the tasks of a process,
/// and drops the tasks of a crashed host in an order that depends on these numbers. Therefore worlds of one process cannot run in
/// parallel.
pub(crate) fn align_task_ids() -> std::io::Result<()> {
    const SHARDS: u64 = 64;
    let runtime = tokio::runtime::Builder::new_current_thread().build()?;
    runtime.block_on(async {
        loop {
            let number = tokio::spawn(async { tokio::task::id().to_string() }).await.ok();
            if number.and_then(|number| number.parse::<u64>().ok()).is_none_or(|number| number % SHARDS == 0) {
                return;
            }
        }
    });
    Ok(())
}

/// Tells whether the messages of a world are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunDetail {
    /// Only the outcome is kept.
    Outcome,
    /// All messages are kept.
    Story,
}
