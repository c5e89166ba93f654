//! `femc fireflies FRAME.exr SCENE`: attributes the error of a frame's noisiest blocks by tracing their samples again.

mod frame;
mod print;
mod report;

use crate::args::FormatArgs;
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::decisions::DecisionsReport;
use crate::output::{BusyIndicator, Printer, Progress, ProgressSnapshot, json};
use crate::request::{load_scene, with_root_prefix};
use clap::Args;
use femc_pipeline::variance_attribution::{Lamps, VarianceAttribution};
use femc_pipeline::variance_by_decision::{VarianceByDecision, WeightedPixel};
use femc_pipeline::{Prepared, SceneSource};
use frame::{Frame, WorstBlock};
use report::{FirefliesReport, Names};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Attribute the error of a frame's noisiest blocks: bounce, technique, object and lamp
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc fireflies drive/roundabout.0012.exr scenes/roundabout.mgf\n  \
    femc fireflies box.exr scenes/cornell-fog.mgf --blocks 3\n  \
    femc fireflies box.exr scenes/cornell-fog.mgf --json | jq '.origins[0]'\n  \
    femc fireflies box.exr scenes/cornell-fog.mgf --decisions    # directions, lamps, distances, roulette\n\n\
    A sample is a function of the settings, which the file states. The samples of the blocks with the largest relative_error.Y \
    are traced again, and each contribution is recorded. A share is the covariance of an origin's contributions with the samples \
    of their pixels, divided by the variance: shares add up to 100 %, and are negative if light is missing where the rest is \
    bright. For frames with --error or --time, the samples that count are found from the pixel's value. This can fail for a pixel \
    in which samples were left out; then its first samples are used (`unlike` counts such pixels).\n\n\
    SCENE must be the scene of the frame, and this femc must have the same build of the engine. Overrides, camera, size and \
    frame number are in the file.")]
pub struct FirefliesArgs {
    /// Frame, as written by femc
    #[arg(value_name = "FRAME.exr")]
    frame: PathBuf,
    /// Its scene file
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Number of blocks to examine
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    blocks: u32,
    /// Attribute the variance to the decisions of the paths, too: directions, lamps, points on lamps, distances in fog, Russian
    /// roulette. Traces N samples of each pixel, each about 30 times
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "16", require_equals = true,
        value_parser = clap::value_parser!(u32).range(2..))]
    decisions: Option<u32>,
    /// Folder that contains the includes, textures and lamps of the scene, at any depth [default: the scene's folder]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    #[command(flatten)]
    format: FormatArgs,
}

/// Runs `femc fireflies`.
pub fn run(args: &FirefliesArgs, printer: Printer) -> Result<Exit, Failure> {
    let frame = Frame::read(&args.frame)?;
    let (root, loaded) = load_scene(&args.scene, args.root.as_deref())?;
    let other_scene = || {
        let (frame, scene) = (args.frame.display(), args.scene.display());
        usage(format!(
            "{frame} was rendered from another scene than {scene} is now; give its scene, or render it again"
        ))
    };
    let source =
        SceneSource::new(Arc::new(loaded.scene)).variant(&frame.settings.overrides).map_err(|_| other_scene())?;
    if source.scene().digest().to_string() != frame.scene {
        return Err(other_scene());
    }
    let prepared = femc_pipeline::prepare_frame(&source, &frame.settings, frame.number, None).map_err(failed)?;
    if prepared.camera.film != [frame.width, frame.height] {
        return Err(other_scene());
    }
    let worst = frame.worst_blocks(args.blocks as usize);
    let lamps = Lamps::new(&prepared);
    let accounts = attribute_variance(&frame, &prepared, &lamps, &worst, printer);
    let names = Names { prepared: &prepared, lamps: &lamps, display_path: &|file| with_root_prefix(&root, file) };
    let mut report = FirefliesReport::new(&args.frame, &args.scene, &frame, &worst, &accounts, &names);
    report.decisions =
        args.decisions.map(|samples| attribute_to_decisions(&frame, &prepared, &worst, samples, printer));
    if args.format.json {
        json::print(printer, &report)?;
    } else {
        print::print(printer, &report);
    }
    Ok(Exit::Done)
}

/// Attributes the variance of samples of the blocks to decisions. Each block counts by its relative variance.
fn attribute_to_decisions(
    frame: &Frame,
    prepared: &Prepared,
    worst: &[WorstBlock],
    samples: u32,
    printer: Printer,
) -> DecisionsReport {
    let busy = BusyIndicator::new(printer, "samples are traced again for each of their decisions");
    let pixels: Vec<WeightedPixel> = worst
        .iter()
        .flat_map(|block| {
            let weight = 1.0 / (block.scale * block.scale);
            block.rect.pixels().map(move |pixel| WeightedPixel { pixel, weight })
        })
        .collect();
    let found = VarianceByDecision::from_replay(prepared, &frame.settings, &pixels, 0..samples);
    drop(busy);
    DecisionsReport::new(&found)
}

/// Returns the accounts of the blocks, in order.
fn attribute_variance(
    frame: &Frame,
    prepared: &Prepared,
    lamps: &Lamps,
    worst: &[WorstBlock],
    printer: Printer,
) -> Vec<VarianceAttribution> {
    let (mut progress, samples) = (Progress::new(printer, Clock), AtomicU64::new(0));
    let mut accounts = Vec::new();
    for block in worst {
        let done = accounts.len() as u64;
        progress.show(&ProgressSnapshot {
            frames: 1,
            tiles: worst.len() as u64,
            tiles_done: done,
            samples: samples.load(Ordering::Relaxed),
            fraction: done as f64 / worst.len() as f64,
            ..ProgressSnapshot::default()
        });
        let expected = |pixel| frame.pixel(pixel);
        accounts.push(VarianceAttribution::from_replay(
            prepared,
            &frame.settings,
            lamps,
            block.rect,
            expected,
            &samples,
        ));
    }
    accounts
}
