//! How far the noise of frames moves the mean of an animation from frame to frame: frames of a scene by `--error`, many seeds each,
//! beside the same frames by many samples.
//!
//! `cargo run --release -p femc-tests --example drive -- [SCENE.mgf] [--error E] [--first FRAME] [--frames N] [--seeds N]`
//!
//! Without arguments: 12 frames of the drive (`scenes/roundabout.mgf`) from frame 50 on at `--error 0.1`, 8 seeds. A line a frame: its
//! mean luminance (cd/m2), the noise of that mean in one frame (standard deviation over the seeds, in % of the mean), the change from
//! the frame before by both, and by how many standard errors they differ. It ends with exit code 1 where that is more than 5.

use femc_pipeline::{Settings, Stop};
use femc_tests::honesty::{Experiment, Measured, Rule};
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

/// Samples a pixel, and seeds, of what is true.
const TRUE: (u32, u64) = (32, 4);

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str| args.iter().position(|arg| arg == name).and_then(|at| args.get(at + 1));
    let file = args.first().filter(|arg| !arg.starts_with("--")).map_or("scenes/roundabout.mgf", String::as_str);
    let error: f64 = option("--error").map_or(Ok(0.1), |text| text.parse())?;
    let first: u32 = option("--first").map_or(Ok(50), |text| text.parse())?;
    let count: u32 = option("--frames").map_or(Ok(12), |text| text.parse())?;
    let seeds: u64 = option("--seeds").map_or(Ok(8), |text| text.parse())?;
    if count < 2 || seeds < 2 {
        return Err(
            "there is a change between two frames, and noise between two seeds: --frames and --seeds are at least 2"
                .into(),
        );
    }
    let scene = Arc::new(femc_import::load_path(Path::new(file))?.scene);
    let measure = |frame: u32, stop: Stop, seeds: std::ops::Range<u64>| -> Result<(Measured, f64), Box<dyn Error>> {
        let experiment = Experiment::of_frame(&scene, Settings { stop, ..Settings::default() }, frame)?;
        let shots: Vec<(f64, f64)> =
            seeds.map(|seed| experiment.shot(seed, Rule::Settings)).map(|it| (it.mean(), it.drawn)).collect();
        let drawn = shots.iter().map(|it| it.1).sum::<f64>() / shots.len() as f64;
        Ok((Measured::mean(&shots.iter().map(|it| it.0).collect::<Vec<_>>()), drawn))
    };
    let head = ["frame", "mean cd/m2", "samples", "noise %", "change %", "true %", "sigmas"];
    println!("{}", head.map(|it| format!("{it:>12}")).concat());
    let (mut before, mut worst, mut squares, mut noise) = (None, 0f64, 0.0, 0.0);
    for frame in first..first + count {
        let (found, drawn) = measure(frame, Stop::Error(error), 1..seeds + 1)?;
        let (truth, _) = measure(frame, Stop::Spp(TRUE.0), 1001..1001 + TRUE.1)?;
        let spread = found.error * (seeds as f64).sqrt() / found.value;
        noise += spread * spread / f64::from(count);
        print!("{frame:>12}{:>12.5}{drawn:>12.1}{:>12.3}", found.value, 100.0 * spread);
        if let Some((found_before, truth_before)) = before {
            let (a, b) = (change(found_before, found), change(truth_before, truth));
            let sigmas = (a.value - b.value) / a.error.hypot(b.error);
            worst = worst.max(sigmas.abs());
            squares += sigmas * sigmas / f64::from(count - 1);
            print!("{:>12.3}{:>12.3}{sigmas:>12.2}", 100.0 * a.value, 100.0 * b.value);
        }
        println!();
        before = Some((found, truth));
    }
    println!(
        "noise of a frame's mean {:.3} %, of its change {:.3} % (rms); changes differ by {worst:.2} standard errors at most, {:.2} rms",
        100.0 * noise.sqrt(),
        100.0 * (2.0 * noise).sqrt(),
        squares.sqrt()
    );
    Ok(if worst <= 5.0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The relative change from one mean to the next.
fn change(from: Measured, to: Measured) -> Measured {
    let ratio = to.value / from.value;
    Measured { value: ratio - 1.0, error: ratio * (to.error / to.value).hypot(from.error / from.value) }
}
