//! Compares the first pass with paths at points of a scene's surfaces:
//! `irradiance SCENE POINTS.tsv [--make COUNT] [--error E,E..]`. With `--make`, computes the points and writes the file. Otherwise
//! reads the file.
//!
//! `cargo run --release -p femc-tests --example irradiance -- ../shared/scenes-real/soda.mgf tests/references/soda.tsv`

use femc_pipeline::radiosity::{SolveOptions, solve};
use femc_pipeline::{SceneSource, Settings, prepare_frame};
use femc_tests::irradiance::{IrradiancePoint, compare, sample_points};
use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Directions per point.
const SAMPLES: u32 = 2048;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str| args.iter().position(|arg| arg == name).and_then(|at| args.get(at + 1));
    let [scene, file, ..] = &args[..] else {
        return Err("usage: irradiance SCENE POINTS.tsv [--make COUNT] [--error E,E..]".into());
    };
    let scene = Arc::new(femc_import::load_scene_file(Path::new(scene))?.scene);
    if let Some(count) = option("--make") {
        let start = Instant::now();
        let mut text = String::from(
            "# position, m\tnormal\tirradiance without what comes straight from light sources, lx\tits standard error\n",
        );
        for IrradiancePoint { position, normal, irradiance } in sample_points(&scene, count.parse()?, SAMPLES)? {
            let numbers = position.to_array().into_iter().chain(normal.to_array()).map(|x| x.to_string());
            let numbers: Vec<String> = numbers.chain(irradiance.map(|x| format!("{x:.5e}"))).collect();
            writeln!(text, "{}", numbers.join("\t"))?;
        }
        std::fs::write(file, text)?;
        println!("{:.1} s", start.elapsed().as_secs_f64());
    }
    let points =
        femc_tests::irradiance::parse_points(&std::fs::read_to_string(file)?).ok_or("a line is not eight numbers")?;
    let errors = option("--error").map_or("1,0.3,0.1", String::as_str);
    for error in errors.split(',') {
        let prepared = prepare_frame(&SceneSource::new(scene.clone()), &Settings::default(), 1, None)?;
        let (options, start) = (SolveOptions { error: error.parse()?, ..SolveOptions::default() }, Instant::now());
        let solution = solve(&prepared, &options, &AtomicBool::new(false)).map_err(|_| "cancelled")?;
        let seconds = start.elapsed().as_secs_f64();
        let report = solution.report;
        let compared = compare(&scene, &solution, &points)?;
        println!(
            "error {error}: {seconds:.2} s, {} elements, {} links, {} refused, {} MB; relmse {:.4}, {:.4} at lit ones, mean ratio {:.4} at {} points",
            report.elements,
            report.links,
            report.inexact_links,
            report.bytes >> 20,
            compared.relmse,
            compared.lit_relmse,
            compared.mean_ratio,
            compared.points
        );
    }
    Ok(())
}
