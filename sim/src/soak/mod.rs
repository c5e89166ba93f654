//! Runs one world for a long time: people submit job after job and change their minds, storms of faults come and go, an operator
//! drains workers and removes garbage. At the end the farm must not be larger than in the middle.
//!
//! A job is audited some minutes after its end. Then all its data is dropped, except that the log must not mention it any more.

mod audit_queue;
mod gauge;
mod people;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use femc_schedule::Config;
use serde::Serialize;

use crate::audit::Violation;
use crate::fault_injector::FaultInjector;
use crate::faults::FaultPlan;
use crate::faulty_medium::FaultyMedium;
use crate::hosts;
use crate::shared::Shared;
use crate::test_jobs;
use crate::world::{RunDetail, align_task_ids};
use audit_queue::AuditQueue;
pub use gauge::Measurement;

/// Step of the simulated time. Most of the real time is spent on steps in which nothing happens.
const TICK: Duration = Duration::from_millis(20);
/// Time from the start of one storm to the next. The second half is quiet, so that jobs end.
const CYCLE: Duration = Duration::from_secs(60);
/// Time after which an ended job expires.
const KEEP_ENDED: Duration = Duration::from_secs(600);
/// Time limit for the last jobs after people stop submitting.
const FINAL_TIMEOUT: Duration = Duration::from_secs(3600);
/// Number of measurements.
const MEASUREMENTS: u32 = 24;

/// Settings of a long run.
#[derive(Debug, Clone, Copy)]
pub struct Soak {
    /// Seed that decides everything.
    pub seed: u64,
    /// Simulated time for which people submit jobs.
    pub time: Duration,
    /// Tells whether all messages are kept, which takes memory.
    pub detail: RunDetail,
}

/// Result of a long run.
#[derive(Debug, Clone, Serialize)]
pub struct SoakReport {
    /// Violations that occurred.
    pub violations: Vec<String>,
    /// Measurements, oldest first.
    pub gauges: Vec<Measurement>,
    /// Counts of actions of people and of ends of jobs.
    pub counts: BTreeMap<&'static str, u64>,
    /// Number of times that each kind of fault took effect.
    pub fired: BTreeMap<&'static str, u32>,
    /// Most records of the log beside a snapshot.
    pub longest_log: usize,
    /// Simulated seconds.
    pub seconds: f64,
    /// Digest of all messages and records.
    pub trace: String,
    /// All messages, one line each, if requested.
    #[serde(skip)]
    pub story: Vec<String>,
}

impl Soak {
    /// Runs until the end or the first violation. Calls `on_measurement` with each measurement.
    pub fn run(&self, mut on_measurement: impl FnMut(&Measurement)) -> anyhow::Result<SoakReport> {
        align_task_ids()?;
        let begun = Instant::now();
        let shared = Shared::new(self.seed, self.detail == RunDetail::Story);
        let (medium, audit_queue) = (FaultyMedium::new(&shared), AuditQueue::default());
        let config = Config { keep_ended: Some(KEEP_ENDED.as_millis() as u64), ..test_jobs::chunked_config() };
        shared.lock().history.keep_ended = config.keep_ended;
        let mut sim = hosts::build_sim(self.seed, [TICK, self.time + FINAL_TIMEOUT], &shared, &medium, &config);
        for number in 0..people::PERSONS {
            sim.client(
                people::name(number),
                people::person(*self, number, shared.clone(), medium.clone(), audit_queue.clone()),
            );
        }
        sim.client("operator", people::operator(*self, shared.clone()));
        let (mut injector, mut storms, mut gauges) = (FaultInjector::default(), 0, Vec::new());
        let broken = loop {
            match sim.step() {
                Ok(true) => break None,
                Ok(false) => {}
                Err(error) => break Some(Violation::Simulation(error.to_string())),
            }
            let now = sim.elapsed();
            injector.run_due(&mut sim, &shared, &medium);
            if now >= CYCLE * storms && now < self.time {
                injector.plan_storm(now, &FaultPlan::storm(self.storm(storms)), &shared);
                audit_queue.audit_due(&shared, now);
                storms += 1;
            }
            if now >= self.time / MEASUREMENTS * gauges.len() as u32 && gauges.len() <= MEASUREMENTS as usize {
                let gauge = Measurement::read(now, begun.elapsed(), &shared, &medium, &audit_queue)?;
                on_measurement(&gauge);
                gauges.push(gauge);
            }
            if !shared.lock().violations.is_empty() {
                break None;
            }
        };
        audit_queue.audit_due(&shared, Duration::MAX);
        let state = shared.lock();
        let grown = gauge::growth(&gauges, self.time);
        let violations = state.violations.iter().cloned().chain(broken).chain(grown);
        Ok(SoakReport {
            violations: violations.map(|violation| violation.to_string()).collect(),
            gauges,
            counts: state.counts.clone(),
            fired: state.fired.clone(),
            longest_log: state.disk.max_records,
            seconds: sim.elapsed().as_secs_f64(),
            trace: state.trace.finalize().to_hex().to_string(),
            story: state.story.clone().unwrap_or_default(),
        })
    }

    /// Returns the seed of a storm.
    fn storm(&self, number: u32) -> u64 {
        self.draw(&format!("storm {number}"))
    }

    /// Draws a number for a purpose.
    fn draw(&self, purpose: &str) -> u64 {
        let hash = blake3::hash(format!("{} {purpose}", self.seed).as_bytes());
        let first = hash.as_bytes().first_chunk().copied();
        u64::from_le_bytes(first.unwrap_or_default())
    }
}
