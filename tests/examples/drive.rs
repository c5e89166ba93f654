//! Measures how much the noise of frames changes the mean of an animation from frame to frame. Renders frames of a scene with
//! `--error` and several seeds, and compares them with the same frames at 16 samples per pixel and other seeds.
//!
//! `cargo run --release -p femc-tests --example drive -- [SCENE.mgf] [--error E] [--first FRAME] [--frames N] [--seeds N]`
//!
//! Without arguments: 12 frames of the drive (`scenes/roundabout.mgf`) from frame 50 on, at `--error 0.1`, 160 x 90 pixels and 4
//! seeds. Prints one line per frame: its mean luminance (cd/m2), samples per pixel, the change from the previous frame in both
//! sets, and their difference in standard errors. The standard errors are pooled over all frames: relative to the mean, all frames
//! have the same error. The exit code is 1 if a change differs by more than 4.5 standard errors.

use femc_pipeline::{Settings, StopCondition};
use femc_tests::honesty::{Experiment, MeanWithError, Rule, SeedImage};
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

/// Samples per pixel of the reference frames. These use other seeds.
const REFERENCE_SPP: u32 = 16;

/// Width and height of a frame in pixels.
const SIZE: [u32; 2] = [160, 90];

/// Mean of a frame over its seeds.
struct FrameStatistics {
    mean: f64,
    /// Variance of the mean of one seed, relative to the squared mean.
    variance: f64,
    /// Samples drawn per pixel.
    drawn_spp: f64,
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str| args.iter().position(|arg| arg == name).and_then(|at| args.get(at + 1));
    let file = args.first().filter(|arg| !arg.starts_with("--")).map_or("scenes/roundabout.mgf", String::as_str);
    let error: f64 = option("--error").map_or(Ok(0.1), |text| text.parse())?;
    let first: u32 = option("--first").map_or(Ok(50), |text| text.parse())?;
    let count: u32 = option("--frames").map_or(Ok(12), |text| text.parse())?;
    let seeds: u64 = option("--seeds").map_or(Ok(4), |text| text.parse())?;
    if count < 2 || seeds < 2 {
        return Err("a change takes two frames, and noise two seeds: --frames and --seeds are at least 2".into());
    }
    let scene = Arc::new(femc_import::load_scene_file(Path::new(file))?.scene);
    let measure = |frame: u32, stop: StopCondition, from: u64| -> Result<FrameStatistics, Box<dyn Error>> {
        let settings = Settings { stop, size: Some(SIZE), ..Settings::default() };
        let experiment = Experiment::for_frame(&scene, settings, frame)?;
        let shots: Vec<_> = (from..from + seeds).map(|seed| experiment.render_seed(seed, Rule::Settings)).collect();
        let MeanWithError { value, error } =
            MeanWithError::mean(&shots.iter().map(SeedImage::mean).collect::<Vec<_>>());
        let drawn = shots.iter().map(|shot| shot.drawn_spp).sum::<f64>() / seeds as f64;
        Ok(FrameStatistics { mean: value, variance: (error / value).powi(2) * seeds as f64, drawn_spp: drawn })
    };
    let mut frames = Vec::new();
    for frame in first..first + count {
        frames.push((
            frame,
            measure(frame, StopCondition::Error(error), 1)?,
            measure(frame, StopCondition::Spp(REFERENCE_SPP), 1001)?,
        ));
        eprintln!("frame {frame}");
    }
    let over =
        |of: fn(&(u32, FrameStatistics, FrameStatistics)) -> f64| frames.iter().map(of).sum::<f64>() / f64::from(count);
    let (noise, noise_of_true) = (over(|it| it.1.variance), over(|it| it.2.variance));
    let sigma = (2.0 * (noise + noise_of_true) / seeds as f64).sqrt();
    println!(
        "{}",
        ["frame", "mean cd/m2", "samples", "change %", "true %", "sigmas"].map(|it| format!("{it:>12}")).concat()
    );
    let (mut worst, mut squares) = (0f64, 0.0);
    for (at, (frame, found, truth)) in frames.iter().enumerate() {
        print!("{frame:>12}{:>12.5}{:>12.1}", found.mean, found.drawn_spp);
        if let Some((_, found_before, truth_before)) = at.checked_sub(1).map(|before| &frames[before]) {
            let [change, is_true] = [found.mean / found_before.mean - 1.0, truth.mean / truth_before.mean - 1.0];
            let sigmas = (change - is_true) / sigma;
            worst = worst.max(sigmas.abs());
            squares += sigmas * sigmas / f64::from(count - 1);
            print!("{:>12.3}{:>12.3}{sigmas:>12.2}", 100.0 * change, 100.0 * is_true);
        }
        println!();
    }
    println!(
        "{count} frames; noise of a frame's mean {:.3} %, of its change {:.3} %; changes differ from the true ones by {worst:.2} standard errors at most, {:.2} rms",
        100.0 * noise.sqrt(),
        100.0 * (2.0 * noise).sqrt(),
        squares.sqrt()
    );
    Ok(if worst <= 4.5 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
