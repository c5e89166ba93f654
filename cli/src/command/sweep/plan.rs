//! `femc plan JOB.toml` of a job with variants: shows what the variants share, and how much that saves.

use super::resolved::ResolvedSweep;
use super::sharing::SharingCounts;
use crate::args::SettingsArgs;
use crate::command::plan::{Trial, trial};
use crate::exit::{Exit, Failure};
use crate::output::{Printer, human, json};
use femc_pipeline::StopCondition;
use serde::Serialize;
use std::path::Path;

#[derive(Serialize)]
struct SweepPlanReport {
    #[serde(flatten)]
    shares: SharingCounts,
    cost: Option<SweepCost>,
    names: Vec<String>,
}

/// Cost estimated from a trial of the first variant on this machine.
#[derive(Serialize)]
struct SweepCost {
    /// Time to prepare a frame from scratch, s.
    prepare_seconds: f64,
    /// Camera samples per second.
    samples_per_second: f64,
    /// Time without sharing, s.
    seconds_alone: f64,
    /// Time with sharing, s.
    seconds_shared: f64,
}

/// Plans a sweep.
pub fn plan(path: &Path, typed: &SettingsArgs, run: Trial, as_json: bool, printer: Printer) -> Result<Exit, Failure> {
    let sweep = ResolvedSweep::open(path, typed, printer)?;
    let sharing = SharingCounts::count(&sweep, None);
    let cost = match run {
        Trial::Run => cost(&sweep, &sharing)?,
        Trial::Skip => None,
    };
    if as_json {
        let names = sweep.variants.iter().map(|variant| variant.name.clone()).collect();
        json::print(printer, &SweepPlanReport { shares: sharing, cost, names })?;
        return Ok(Exit::Done);
    }
    let rows: Vec<Vec<String>> = sweep
        .variants
        .iter()
        .map(|variant| vec![variant.name.clone(), variant.frames.len().to_string(), sweep.title(variant)])
        .collect();
    printer.result(human::table(&["variant", "frames", "values"], &rows));
    printer.result("");
    sharing.lines().iter().for_each(|line| printer.result(line));
    if let Some(cost) = cost {
        let [alone, shared] = [cost.seconds_alone, cost.seconds_shared].map(human::seconds);
        printer.result(format!("estimated cost: {shared} on this machine; {alone} if nothing were shared"));
    }
    Ok(Exit::Done)
}

/// Estimates the cost; `None` if the number of samples is not known in advance.
fn cost(sweep: &ResolvedSweep, sharing: &SharingCounts) -> Result<Option<SweepCost>, Failure> {
    let samples = sweep.variants.iter().try_fold(0u64, |sum, variant| match variant.stop {
        StopCondition::Spp(spp) => {
            let [width, height] = variant.spec.grid.film.map(u64::from);
            Some(sum + width * height * u64::from(spp) * variant.frames.len() as u64)
        }
        StopCondition::Error(_) | StopCondition::Time(_) => None,
    });
    let Some(samples) = samples.filter(|_| !sweep.first.settings.measure_only) else { return Ok(None) };
    let trial_cost = trial(&sweep.first, 1, 0, 0)?;
    let seconds = |prepared: usize, solved: usize, samples: u64| {
        let before = trial_cost.prepare_seconds * prepared as f64 + trial_cost.first_pass_seconds * solved as f64;
        before + samples as f64 / trial_cost.samples_per_second
    };
    Ok(Some(SweepCost {
        prepare_seconds: trial_cost.prepare_seconds,
        samples_per_second: trial_cost.samples_per_second,
        seconds_alone: seconds(sharing.frames, sharing.frames, samples),
        seconds_shared: seconds(sharing.worlds, sharing.first_passes, samples - sharing.samples_saved),
    }))
}
