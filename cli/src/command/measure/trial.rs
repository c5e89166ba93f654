//! Cost of a measurement, from a trial on this machine.

use crate::clock::Clock;
use crate::exit::{Failure, failed, usage};
use crate::request::ResolvedRequest;
use crate::threads;
use femc_pipeline::measure::{MeasureRequest, measure, resolve_places};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Duration;

/// Time after which a trial starts no further reading.
const DURATION: Duration = Duration::from_millis(500);
/// Maximum number of readings of a trial, spread over the request.
const READINGS: usize = 64;

/// Size and cost of a measurement.
#[derive(Debug, Serialize)]
pub struct MeasurementCost {
    /// Readings of a frame.
    readings: usize,
    /// Tasks of a frame, without the join.
    tasks: u32,
    /// Estimated time of all frames on this machine, s.
    pub seconds: f64,
}

/// Takes some of the readings of the first frame, and estimates the cost of all.
pub fn trial(resolved: &ResolvedRequest, request: &MeasureRequest) -> Result<MeasurementCost, Failure> {
    threads::pool(resolved.threads)?.install(|| run(resolved, request))
}

fn run(resolved: &ResolvedRequest, request: &MeasureRequest) -> Result<MeasurementCost, Failure> {
    let (clock, frames) = (Clock, &resolved.plan.frames);
    let (settings, begun) = (&resolved.settings, clock.now());
    let frame = frames.first().copied().unwrap_or(1);
    let prepared = femc_pipeline::prepare_world(&resolved.source, &settings.of_measurement(), frame, None);
    let prepared = prepared.map_err(failed)?;
    let places = resolve_places(&prepared, request).map_err(|error| usage(format!("--measure: {error}")))?;
    let prepare_seconds = clock.since(begun).as_secs_f64();
    let (reading_settings, begun) = (request.settings(settings.max_depth, settings.seed), clock.now());
    let (cancel, samples) = (AtomicBool::new(false), AtomicU64::new(0));
    let mut taken = 0u32;
    for (number, place) in places.iter().enumerate().step_by(places.len().div_ceil(READINGS).max(1)) {
        let _ = measure(&prepared, number as u32, place, &reading_settings, &cancel, &samples);
        taken += 1;
        if clock.since(begun) >= DURATION {
            break;
        }
    }
    let each = clock.since(begun).as_secs_f64() / f64::from(taken.max(1));
    let seconds = (prepare_seconds + each * places.len() as f64) * frames.len() as f64;
    Ok(MeasurementCost { readings: places.len(), tasks: request.tasks(), seconds })
}

impl MeasurementCost {
    /// Returns the counts as text, like `98 readings in 13 tasks per frame`.
    pub fn text(&self) -> String {
        use crate::output::human::counted_noun;
        let (readings, tasks) =
            (counted_noun(self.readings as u64, "reading"), counted_noun(self.tasks.into(), "task"));
        format!("{readings} in {tasks} per frame")
    }
}
