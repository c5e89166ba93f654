//! One world from its first moment to its end.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::audit::{Violation, audit};
use crate::faults::Planned;
use crate::hosts;
use crate::person::person;
use crate::shared::Shared;
use crate::shelf::Shelf;
use crate::stage;
use crate::weather::Weather;

/// Step of the simulated time.
const TICK: Duration = Duration::from_millis(5);
/// When the job must be done.
const END: Duration = Duration::from_secs(240);

/// What came of a world.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// What must never be, and was.
    pub violations: Vec<Violation>,
    /// How often each kind of fault came about.
    pub fired: BTreeMap<&'static str, u32>,
    /// Simulated seconds.
    pub seconds: f64,
    /// Digest of all that was said and written: the same seed gives the same.
    pub trace: String,
    /// All that was said, one line each, if it was asked for.
    pub story: Vec<String>,
    /// Results that came after their lease, or twice, and changed nothing.
    pub stale: u64,
}

/// Lives through the world of this seed and plan. `tells`: keep the story.
pub fn run(seed: u64, plan: &Planned, tells: Tells) -> anyhow::Result<Outcome> {
    let stage = stage::pick(seed)?;
    line_up()?;
    let (shared, shelf) = (Shared::new(seed, tells == Tells::Story), Shelf::default());
    let scheduler = femc_schedule::Config { group: stage::group(seed), ..stage.schedule.clone() };
    let mut sim = hosts::settle(seed, [TICK, END], &shared, &shelf, &scheduler);
    sim.client("person", person(shared.clone(), stage));
    let mut weather = Weather::default();
    weather.storm(Duration::ZERO, plan, &shared);
    let broken = loop {
        match sim.step() {
            Ok(true) => break None,
            Ok(false) => weather.pass(&mut sim, &shared, &shelf),
            Err(error) => break Some(error.to_string()),
        }
    };
    let state = shared.lock();
    let mut violations = audit(stage, &state);
    violations.extend(broken.filter(|_| state.end.is_some()).map(Violation::World));
    Ok(Outcome {
        violations,
        fired: state.fired.clone(),
        seconds: sim.elapsed().as_secs_f64(),
        trace: state.trace.finalize().to_hex().to_string(),
        story: state.story.clone().unwrap_or_default(),
        stale: state.end.as_ref().map_or(0, |(status, _)| status.stale_messages),
    })
}

/// Tokio numbers the tasks of a process and drops those of a crashed host in an order that follows from the numbers: begins
/// every world at a number of the same remainder. So worlds of one process do not live side by side.
pub(crate) fn line_up() -> std::io::Result<()> {
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

/// Whether a world's story is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tells {
    /// Only its outcome.
    Outcome,
    /// Every message.
    Story,
}
