//! `femc plan JOB.toml` of a job with variants: shows what the variants share, and how much that saves.

use super::share::Shares;
use super::work::Work;
use crate::args::SettingsArgs;
use crate::command::plan::{Trial, trial};
use crate::exit::{Exit, Failure};
use crate::output::{Say, human, json};
use femc_pipeline::Stop;
use serde::Serialize;
use std::path::Path;

#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    shares: Shares,
    cost: Option<Cost>,
    names: Vec<String>,
}

/// Cost estimated from a trial of the first variant on this machine.
#[derive(Serialize)]
struct Cost {
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
pub fn plan(path: &Path, typed: &SettingsArgs, run: Trial, as_json: bool, say: Say) -> Result<Exit, Failure> {
    let work = Work::open(path, typed, say)?;
    let shares = Shares::count(&work, None);
    let cost = match run {
        Trial::Run => cost(&work, &shares)?,
        Trial::Skip => None,
    };
    if as_json {
        let names = work.variants.iter().map(|variant| variant.name.clone()).collect();
        json::print(say, &Report { shares, cost, names })?;
        return Ok(Exit::Done);
    }
    let rows: Vec<Vec<String>> = work
        .variants
        .iter()
        .map(|variant| vec![variant.name.clone(), variant.frames.len().to_string(), work.title(variant)])
        .collect();
    say.result(human::table(&["variant", "frames", "values"], &rows));
    say.result("");
    shares.lines().iter().for_each(|line| say.result(line));
    if let Some(cost) = cost {
        let [alone, shared] = [cost.seconds_alone, cost.seconds_shared].map(human::seconds);
        say.result(format!("estimated cost: {shared} on this machine; {alone} if nothing were shared"));
    }
    Ok(Exit::Done)
}

/// Estimates the cost; `None` if the number of samples is not known in advance.
fn cost(work: &Work, shares: &Shares) -> Result<Option<Cost>, Failure> {
    let samples = work.variants.iter().try_fold(0u64, |sum, variant| match variant.stop {
        Stop::Spp(spp) => {
            let [width, height] = variant.spec.grid.film.map(u64::from);
            Some(sum + width * height * u64::from(spp) * variant.frames.len() as u64)
        }
        Stop::Error(_) | Stop::Time(_) => None,
    });
    let Some(samples) = samples else { return Ok(None) };
    let tried = trial(&work.first, 1, 0, 0)?;
    let seconds = |prepared: usize, solved: usize, samples: u64| {
        let before = tried.prepare_seconds * prepared as f64 + tried.first_pass_seconds * solved as f64;
        before + samples as f64 / tried.samples_per_second
    };
    Ok(Some(Cost {
        prepare_seconds: tried.prepare_seconds,
        samples_per_second: tried.samples_per_second,
        seconds_alone: seconds(shares.frames, shares.frames, samples),
        seconds_shared: seconds(shares.worlds, shares.first_passes, samples - shares.samples_saved),
    }))
}
