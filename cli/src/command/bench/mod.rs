//! `femc bench SCENE..`: run time against error.

mod measure;
mod show;

use crate::args::{Filter, FormatArgs, SettingsArgs};
use crate::clock::Clock;
use crate::command::client;
use crate::command::interrupt::Interrupt;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::decisions::DecisionsReport;
use crate::output::{BusyIndicator, Printer, Progress, human, json};
use crate::request::{FramesChosen, ResolvedRequest};
use crate::threads;
use crate::values::{Frames, Override, Size};
use clap::Args;
use femc_film::file::write_atomic;
use femc_reports::bench::method::{Budget, Method};
use femc_reports::bench::reference::ReferenceSpec;
use femc_reports::bench::setup::Setup;
use femc_reports::bench::summary::{Ladder, Summary};
use femc_reports::bench::{Record, Run};
use measure::BenchScene;
use rayon::ThreadPool;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Measure run time against error: methods with several budgets, several seeds each, against a reference
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc bench scenes/cornell.mgf --reference cornell.exr --methods pt,adaptive --report bench.html\n  \
    femc bench box.mgf fog.mgf --reference box.exr fog.exr --spp 1,4,16,64 --error 0.5,0.2 -o bench.json\n  \
    femc bench box.mgf --reference A.exr,B.exr --methods pt --seeds 10 --json | jq .summary.methods\n\n\
    Methods: pt, femc, fem, auto (budgets: --spp), adaptive (budgets: --error). The first method is the baseline of the comparison. Only rendering \
    is timed, in this process: the scene is read and compiled before. If the independent halves REF_A.exr and REF_B.exr exist \
    beside a reference REF.exr, the noise of the reference is estimated and subtracted from mse and relmse, but not from flip.\n\
    With -o each measurement is saved as soon as it is made: rerun the command to resume after a stop. With more seeds, budgets, \
    methods or scenes, only what is new is measured.")]
pub struct BenchArgs {
    /// Scene files
    #[arg(value_name = "SCENE", required = true)]
    scenes: Vec<PathBuf>,
    /// References, one for each scene: a file, or two independent halves of one size, A.exr,B.exr
    #[arg(long, value_name = "REF.exr", required = true, num_args = 1..)]
    reference: Vec<ReferenceSpec>,
    /// Methods, separated by commas
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', default_value = "pt,adaptive", value_parser = Method::from_name)]
    methods: Vec<&'static Method>,
    /// Budgets of methods that draw a number of samples per pixel
    #[arg(long, value_name = "N,..", value_delimiter = ',', default_value = "1,4,16,64", value_parser = spp)]
    spp: Vec<f64>,
    /// Budgets of methods that stop at a relative error of every block
    #[arg(long, value_name = "E,..", value_delimiter = ',', default_value = "0.5,0.2", value_parser = relative_error)]
    error: Vec<f64>,
    /// Number of seeds; each seed is one frame for every method and budget
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=10000))]
    seeds: u64,
    /// First seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// File that keeps the measurements; those that are in it already are not repeated
    #[arg(long, short, value_name = "BENCH.json")]
    out: Option<PathBuf>,
    /// Attribute the variance of each method to the decisions of the paths, too: directions, lamps, points on lamps, distances in
    /// fog, Russian roulette. Traces N samples of some thousand pixels, each about 30 times
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "16", require_equals = true,
        value_parser = clap::value_parser!(u32).range(2..))]
    decisions: Option<u32>,
    /// Write a page with plots and tables
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    settings: BenchSettings,
}

/// Render settings that all methods share.
#[derive(Debug, Args)]
#[command(next_help_heading = "Render settings")]
struct BenchSettings {
    /// Camera to look through [default: the scene's first]
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Film size in pixels [default: the camera's]
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Frame of the clip: a single one [default: its first]
    #[arg(long, value_name = "K")]
    frames: Option<Frames>,
    /// Longest path in segments, counting the one from the camera; 0: unbounded [default: 0]
    #[arg(long, value_name = "N")]
    max_depth: Option<u32>,
    /// Pixel filter; box: a pixel is the mean luminance over its area [default: box]
    #[arg(long, value_enum)]
    filter: Option<Filter>,
    /// Threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,
    /// Override a scalar of the scene, like medium.fog.sigma_s=0.03 (repeatable)
    #[arg(long, value_name = "SELECTOR=VALUE")]
    set: Vec<Override>,
    /// Folder that contains the includes, textures and lamps of the scene, at any depth [default: the scene's folder]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
}

/// Measurements and summary, as printed and kept.
#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    record: &'a Record,
    summary: &'a Summary,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    decisions: Vec<MethodDecisions>,
}

/// Parts of the variance of a method by decision.
#[derive(Serialize)]
struct MethodDecisions {
    scene: String,
    method: &'static str,
    #[serde(flatten)]
    report: DecisionsReport,
}

/// Runs `femc bench`: measures what is missing, and prints the summary.
pub fn run(args: &BenchArgs, printer: Printer) -> Result<Exit, Failure> {
    let BenchArgs { scenes, reference, out, .. } = args;
    if scenes.len() != reference.len() {
        return Err(usage(format!(
            "--reference: {} for {}; give one for each scene, in the same order",
            human::counted_noun(reference.len() as u64, "reference"),
            human::counted_noun(scenes.len() as u64, "scene"),
        )));
    }
    let pool = threads::pool(args.settings.threads)?;
    let ladders = args.ladders();
    let seeds: Vec<u64> = (0..args.seeds).map(|place| args.seed.wrapping_add(place)).collect();
    let mut bench_scenes: Vec<BenchScene> = Vec::new();
    for (scene, spec) in scenes.iter().zip(reference) {
        let resolved = ResolvedRequest::open(scene, args.settings.to_settings_args(), printer)?;
        if resolved.frames_chosen == FramesChosen::Typed && resolved.plan.frames.len() != 1 {
            return Err(usage("--frames: a reference shows one frame; give --frames K"));
        }
        let bench_scene = BenchScene::new(resolved, spec.read()?, &spec.to_string())?;
        if bench_scenes.iter().any(|other| other.setup.name == bench_scene.setup.name) {
            let name = &bench_scene.setup.name;
            return Err(usage(format!(
                "two scenes are named {name}, so their results have the same name; rename a file"
            )));
        }
        if bench_scene.reference().noise.is_none() {
            let name = &bench_scene.setup.name;
            printer.note(format!(
                "note: {name}: the noise of the reference is unknown (no halves _A and _B) and counts as error"
            ));
        }
        bench_scenes.push(bench_scene);
    }
    let setups = bench_scenes.iter().map(|bed| bed.setup.clone()).collect();
    let mut record =
        Record::open(out.as_deref(), Setup::current(pool.current_num_threads(), femc_worker::engine()), setups)?;
    let mut bench = Bench { args, ladders: &ladders, seeds: &seeds, pool: &pool, printer };
    bench.measure(&mut record, &bench_scenes)?;
    let noises: Vec<_> = bench_scenes.iter().map(|bed| (bed.setup.name.as_str(), bed.reference().noise)).collect();
    let summary = Summary::new(&record, &noises, &ladders, &seeds);
    let decisions = bench.attribute_to_decisions(&bench_scenes)?;
    let document = Document { record: &record, summary: &summary, decisions };
    if let Some(out) = out {
        write_atomic(out, &encode_json(&document)?).map_err(failed)?;
    }
    if let Some(page) = &args.report {
        write_atomic(page, femc_reports::pages::bench::page(&record, &summary)?.as_bytes()).map_err(failed)?;
    }
    if args.format.json {
        json::print(printer, &document)?;
    } else {
        show::print(&record.setup, &summary, printer);
        for MethodDecisions { scene, method, report } in &document.decisions {
            show::print_decisions(scene, method, report, printer);
        }
    }
    Ok(Exit::Done)
}

/// A measurement series and its resources.
struct Bench<'a> {
    args: &'a BenchArgs,
    ladders: &'a [Ladder],
    seeds: &'a [u64],
    pool: &'a ThreadPool,
    printer: Printer,
}

impl Bench<'_> {
    /// Measures the runs that `record` lacks, scene by scene.
    fn measure(&mut self, record: &mut Record, bench_scenes: &[BenchScene]) -> Result<(), Failure> {
        let cancel = Arc::new(AtomicBool::new(false));
        let runtime = client::runtime()?;
        let mut interrupt = runtime.block_on(async { Interrupt::listen() })?;
        let cancelled = cancel.clone();
        runtime.spawn(async move {
            interrupt.wait().await;
            cancelled.store(true, Ordering::Relaxed);
        });
        let order = run_order(self.ladders, self.seeds);
        let (all, mut done) = (order.len() * bench_scenes.len(), 0);
        let mut progress = Progress::new(self.printer, Clock);
        for bench_scene in bench_scenes {
            let name = &bench_scene.setup.name;
            let mut prepared = None;
            for &(method, budget, seed) in &order {
                if record.run(name, method, budget, seed).is_none() {
                    let text = || {
                        format!(
                            "{}/{all}: {name}, {}, {}, seed {seed}",
                            done + 1,
                            method.name,
                            method.format_budget(budget)
                        )
                    };
                    progress.update(done as f64 / all as f64, text);
                    let prepared = match &mut prepared {
                        Some(ready) => ready,
                        None => prepared.insert(bench_scene.prepare(self.pool, &cancel)?),
                    };
                    self.save_run(record, prepared.run(method, budget, seed)?)?;
                }
                done += 1;
            }
        }
        progress.finish();
        Ok(())
    }

    /// Attributes the variance of each scene and unbiased method to decisions, if that was requested.
    fn attribute_to_decisions(&self, bench_scenes: &[BenchScene]) -> Result<Vec<MethodDecisions>, Failure> {
        let Some(samples) = self.args.decisions else { return Ok(Vec::new()) };
        let cancel = AtomicBool::new(false);
        let busy = BusyIndicator::new(self.printer, "samples are traced again for each of their decisions");
        let mut all = Vec::new();
        for bench_scene in bench_scenes {
            let mut prepared = bench_scene.prepare(self.pool, &cancel)?;
            for &method in &self.args.methods {
                let traces_paths =
                    !matches!(method.transport, femc_pipeline::Method::Auto | femc_pipeline::Method::Fem);
                if traces_paths {
                    let report = prepared.attribute_to_decisions(method, samples)?;
                    let scene = bench_scene.setup.name.clone();
                    all.push(MethodDecisions { scene, method: method.name, report });
                }
            }
        }
        drop(busy);
        Ok(all)
    }

    fn save_run(&self, record: &mut Record, run: Run) -> Result<(), Failure> {
        record.runs.push(run);
        let Some(out) = &self.args.out else { return Ok(()) };
        write_atomic(out, &encode_json(record)?).map_err(failed)
    }
}

/// Returns all runs of a scene, seed by seed, with all methods side by side. A machine that slows down then slows all methods.
fn run_order(ladders: &[Ladder], seeds: &[u64]) -> Vec<(&'static Method, f64, u64)> {
    let longest = ladders.iter().map(|(_, budgets)| budgets.len()).max().unwrap_or(0);
    let at = |seed: u64, place: usize| {
        ladders.iter().filter_map(move |(method, budgets)| Some((*method, *budgets.get(place)?, seed)))
    };
    seeds.iter().flat_map(|&seed| (0..longest).flat_map(move |place| at(seed, place))).collect()
}

fn encode_json<T: Serialize>(document: &T) -> Result<Vec<u8>, Failure> {
    let mut text = serde_json::to_vec_pretty(document).map_err(failed)?;
    text.push(b'\n');
    Ok(text)
}

impl BenchArgs {
    /// Returns each method once, with each of its budgets once.
    fn ladders(&self) -> Vec<Ladder> {
        let mut ladders: Vec<Ladder> = Vec::new();
        for &method in &self.methods {
            if ladders.iter().all(|(there, _)| *there != method) {
                let typed = match method.budget {
                    Budget::Spp => &self.spp,
                    Budget::Error => &self.error,
                };
                let mut budgets: Vec<f64> = Vec::new();
                typed.iter().for_each(|budget| {
                    if !budgets.contains(budget) {
                        budgets.push(*budget);
                    }
                });
                ladders.push((method, budgets));
            }
        }
        ladders
    }
}

impl BenchSettings {
    fn to_settings_args(&self) -> SettingsArgs {
        SettingsArgs {
            camera: self.camera.clone(),
            size: self.size,
            frames: self.frames.clone(),
            max_depth: self.max_depth,
            filter: self.filter,
            set: self.set.clone(),
            root: self.root.clone(),
            ..SettingsArgs::default()
        }
    }
}

/// Parses a whole number of samples.
fn spp(text: &str) -> Result<f64, String> {
    match text.parse::<u32>() {
        Ok(number @ 1..=16_777_216) => Ok(f64::from(number)),
        _ => Err(format!("`{text}` is not a number of samples; write whole numbers from 1 to 16777216, like 1,4,16")),
    }
}

/// Parses a relative error at which frames can stop.
fn relative_error(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number < 10.0 => Ok(number),
        _ => Err(format!("`{text}` is not a relative error; write numbers above 0 and below 10, like 0.5,0.2")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_reports::bench::method::METHODS;

    #[test]
    fn methods_alternate_within_each_seed_for_any_budget_counts() {
        let ladders: Vec<Ladder> = vec![(&METHODS[0], vec![1.0, 4.0, 16.0]), (&METHODS[1], vec![0.5])];
        let shown: Vec<String> = run_order(&ladders, &[7, 8])
            .iter()
            .map(|(method, budget, seed)| format!("{seed} {} {budget}", method.name))
            .collect();
        let of = |seed| {
            [format!("{seed} pt 1"), format!("{seed} adaptive 0.5"), format!("{seed} pt 4"), format!("{seed} pt 16")]
        };
        assert_eq!(shown, [of(7), of(8)].concat());
    }
}
