//! Checks that images are right on average and that their claimed errors are true: compares many seeds of a scene with its
//! reference.
//!
//! `cargo run --release -p femc-tests --example honesty -- SCENE.mgf REFERENCE (--error E | --spp N | --time S) [--method M] [--seeds N] [--old-rule]`
//!
//! REFERENCE: `<REFERENCE>_A.exr` and `<REFERENCE>_B.exr`, two independent images. `--old-rule` stops a tile by its own error
//! estimate. This is a control that must fail. The clock of `--time` counts rays, 1e6 per second. Prints one line of JSON.

use femc_pipeline::{Method, Settings, StopCondition};
use femc_tests::honesty::{Experiment, MeanWithError, Rule, SeedStatistics};
use femc_tests::reference::Reference;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str| args.iter().position(|arg| arg == name).and_then(|at| args.get(at + 1));
    let (scene, reference) = (args.first().ok_or("no scene")?, Path::new(args.get(1).ok_or("no reference")?));
    let stop = match (option("--error"), option("--spp"), option("--time")) {
        (Some(error), _, _) => StopCondition::Error(error.parse()?),
        (None, Some(spp), _) => StopCondition::Spp(spp.parse()?),
        (None, None, Some(seconds)) => StopCondition::Time(seconds.parse()?),
        (None, None, None) => return Err("neither --error nor --spp nor --time".into()),
    };
    let method = match option("--method").map_or("pt", String::as_str) {
        "pt" => Method::Pt,
        "fem" => Method::Fem,
        "femc" => Method::Femc,
        other => return Err(format!("--method {other}: it must be pt, fem or femc").into()),
    };
    let seeds: u64 = option("--seeds").map_or(Ok(16), |text| text.parse())?;
    let first: u64 = option("--first-seed").map_or(Ok(1), |text| text.parse())?;
    let rule = if args.iter().any(|arg| arg == "--old-rule") { Rule::Peeking } else { Rule::Settings };
    let (folder, name) = (reference.parent().ok_or("no folder")?, reference.file_name().ok_or("no name")?);
    let reference = Reference::read(folder, &name.to_string_lossy());
    let loaded = Arc::new(femc_import::load_scene_file(Path::new(scene))?.scene);
    let film = reference.size();
    let experiment = Experiment::new(&loaded, Settings { stop, method, size: Some(film), ..Settings::default() })?;
    let start = Instant::now();
    let shots = (first..first + seeds).map(|seed| experiment.render_seed(seed, rule));
    let statistics = SeedStatistics::from_seeds(&reference, shots);
    let number = |measured: MeanWithError| serde_json::json!({ "value": measured.value, "error": measured.error });
    let line = serde_json::json!({
        "scene": scene, "method": method, "stop": stop, "rule": format!("{rule:?}"), "seeds": seeds,
        "bias": number(statistics.bias), "coverage": number(statistics.coverage), "relmse": number(statistics.relmse),
        "true_over_claimed": number(statistics.true_over_claimed), "worst": number(statistics.worst),
        "drawn": number(statistics.drawn_spp), "counted": number(statistics.counted_spp), "longest": number(statistics.max_spp),
        "seconds": start.elapsed().as_secs_f64() / seeds as f64,
    });
    println!("{line}");
    Ok(())
}
