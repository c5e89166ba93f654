//! Measures the gain from a first pass. Traces equal samples with several methods, and prints the variance of their means, the
//! processor seconds, and the seconds of the first pass.
//!
//! `cargo run --release -p femc-tests --example two_passes -- SCENE.mgf.. [--methods M,..] [--spp N] [--size N] [--turns N]`
//!
//! Methods: `pt`, `femc`; parts of `femc`: `directions` (no weight window), `roulette` (no splitting), `splitting` (no roulette by
//! the window), `window` (no guided directions); and `LOWER:UPPER` (`femc` with these bounds of the window). The first method is the
//! baseline.
//!
//! One line for each scene and method:
//! - `first s`: processor seconds of the first pass and of learning the targets; `s`: of the samples;
//! - `rays`: rays and shadow rays of a sample; `guided`: vertices at which a guide samples directions;
//! - `variance`: variance of the mean of all samples of a pixel, times their number, over the pixel's squared mean + 0.01, averaged
//!   over all pixels and channels, as in relmse. Evenly spread samples have less variance than independent ones; the column `independent` ignores their spread;
//! - `±`: standard error of the variance, %, from the spread over rows of pixels;
//! - `gain`: variance times seconds of the baseline over that of the method; `with first`: with the seconds of the first pass;
//! - `z`: difference of the mean from the baseline's, in standard errors.

use femc_field::{Target, TargetGuide};
use femc_guiding::openings::Opening;
use femc_guiding::patches::Patch;
use femc_math::sampler::REPLICATES;
use femc_montecarlo::{Guidance, WeightWindow};
use femc_pipeline::radiosity::{self, SolveOptions};
use femc_pipeline::{Field, SceneSource, Settings, prepare_frame};
use femc_prepared::Prepared;
use femc_tests::clock::processor_seconds;
use femc_tests::relative_variance::{MethodStatistics, measure};
use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Guidance of the paths of a method. `None`: path tracing alone.
fn guidance<'a>(
    method: &str,
    prepared: &'a Prepared,
    field: &'a Field,
    targets: &'a TargetGuide,
) -> Result<Option<Guidance<'a>>, String> {
    let all = Guidance::new(prepared, field).with_targets(prepared, targets);
    let open = WeightWindow { lower: 0.0, upper: f32::INFINITY };
    let window = WeightWindow::default();
    Ok(Some(match method {
        "pt" => return Ok(None),
        "femc" => all,
        "directions" => Guidance { window: open, ..all },
        "roulette" => Guidance { window: WeightWindow { upper: f32::INFINITY, ..window }, ..all },
        "splitting" => Guidance { window: WeightWindow { lower: 0.0, ..window }, ..all },
        "window" => Guidance { samples_directions: false, ..all },
        bounds => {
            let bounds: Vec<f32> = bounds.split(':').filter_map(|bound| bound.parse().ok()).collect();
            let &[lower, upper] = &bounds[..] else { return Err(format!("unknown method {method}")) };
            Guidance { window: WeightWindow { lower, upper }, ..all }
        }
    }))
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut scenes, mut spp, mut size, mut turns) = (Vec::new(), 128u32, 64u32, 2u32);
    let mut methods = vec!["pt".to_owned(), "femc".to_owned()];
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or(format!("{arg} needs a value"));
        match arg.as_str() {
            "--spp" => spp = value()?.parse()?,
            "--size" => size = value()?.parse()?,
            "--methods" => methods = value()?.split(',').map(str::to_owned).collect(),
            "--turns" => turns = value()?.parse()?,
            scene => scenes.push(scene.to_owned()),
        }
    }
    if scenes.is_empty() || spp < 2 * REPLICATES as u32 {
        return Err(
            "usage: two_passes SCENE.mgf.. [--methods M,..] [--spp N] [--size N] [--turns N]; at least 8 samples"
                .into(),
        );
    }
    println!("scene\tmethod\tfirst s\ts\trays\tguided\tvariance\t±\tindependent\tgain\twith first\tz");
    for path in scenes {
        let scene = Arc::new(femc_import::load_scene_file(path.as_ref())?.scene);
        let settings = Settings { size: Some([size; 2]), ..Settings::default() };
        let prepared = prepare_frame(&SceneSource::new(scene), &settings, 1, None)?;
        let name = std::path::Path::new(&path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let start = processor_seconds().unwrap_or(0.0);
        let options = SolveOptions { error: 1.0, ..SolveOptions::default() };
        let solution = radiosity::solve(&prepared, &options, &AtomicBool::new(false)).map_err(|_| "cancelled")?;
        let first = processor_seconds().unwrap_or(0.0) - start;
        let start = processor_seconds().unwrap_or(0.0);
        let learned = femc_guiding::learn(&prepared, &solution.field, &AtomicBool::new(false)).ok_or("cancelled")?;
        let guide = learned.guide(&solution.field);
        let learning = processor_seconds().unwrap_or(0.0) - start;
        println!("{name}\tlearning {learning:.2} s, {} paths, {} rays", learned.paths, learned.rays);
        for Opening { target, share } in &learned.openings {
            let (center, [a, b]) = (target.center() + prepared.origin.as_vec3a(), target.edges);
            println!("{name}\topening {:.3} m x {:.3} m at {center:.2}, share {share:.3}", a.length(), b.length());
        }
        for Patch { target, share } in &learned.patches {
            let (center, size) = match target {
                Target::Parallelogram(it) => {
                    (it.center(), format!("{:.3} m x {:.3} m", it.edges[0].length(), it.edges[1].length()))
                }
                Target::Ball(it) => (it.center, format!("of radius {:.3} m", it.radius)),
            };
            println!("{name}\tpatch {size} at {:.2}, share {share:.3}", center + prepared.origin.as_vec3a());
        }
        let field = &solution.field;
        let guidances: Result<Vec<_>, _> =
            methods.iter().map(|method| guidance(method, &prepared, field, &guide)).collect();
        let guidances = guidances?;
        let measured = measure(&guidances, &prepared, size, spp, turns);
        let base = &measured[0];
        for (method, of) in methods.iter().zip(&measured) {
            let first = match method.as_str() {
                "pt" => 0.0,
                _ => first + learning,
            };
            let work = |of: &MethodStatistics| of.variance * of.seconds;
            println!(
                "{name}\t{method}\t{first:.2}\t{:.2}\t{:.2}\t{:.2}\t{:.5}\t{:.0}\t{:.5}\t{:.2}\t{:.2}\t{:+.2}",
                of.seconds,
                of.rays,
                of.guided,
                of.variance,
                100.0 * of.variance_error / of.variance,
                of.independent,
                work(base) / work(of),
                work(base) / (of.variance * (of.seconds + first)),
                (of.mean - base.mean) / (of.error2 + base.error2).sqrt().max(1e-30),
            );
        }
    }
    Ok(())
}
