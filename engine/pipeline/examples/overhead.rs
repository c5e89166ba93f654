//! What hearing of paths costs: renders a frame of a scene on one thread, without statistics or, with a fourth word, with them.
//!
//! `cargo run --release -p femc-pipeline --example overhead -- scene.mgf 128 16 [stats]`

use femc_film::{Rect, Tile};
use femc_pipeline::paths::represent::{Distance, Target, best_of, representative};
use femc_pipeline::paths::schema::path_bins;
use femc_pipeline::{Settings, Source, StatisticsPlan, Stop, prepare, render_tile, render_with_statistics};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let (Some(file), Some(width), Some(samples)) = (words.next(), words.next(), words.next()) else {
        return Err("usage: overhead SCENE WIDTH SAMPLES".into());
    };
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let source = Source::new(Arc::new(femc_import::load_path(Path::new(&file))?.scene));
    let width: u32 = width.parse()?;
    let spp = samples.parse()?;
    let settings = Settings { size: Some([width, width]), seed: 7, stop: Stop::Spp(spp), ..Settings::default() };
    let prepared = prepare(&source, &settings, 1, None)?;
    let [width, height] = prepared.camera.film;
    let rect = Rect { x: 0, y: 0, width, height };
    let samples = 0..spp;
    let (cancel, progress) = (AtomicBool::new(false), AtomicU64::new(0));
    let began = Instant::now();
    let (rendered, statistics) = if words.next().is_some() {
        // One tile is the whole frame.
        let plan = StatisticsPlan::of(&prepared, &settings, width.max(height));
        let (rendered, statistics) =
            render_with_statistics(&prepared, &settings, &plan, rect, samples, &cancel, &progress)?;
        (rendered, Some(statistics))
    } else {
        (render_tile(&prepared, &settings, rect, samples, &cancel, &progress)?, None)
    };
    let seconds = began.elapsed().as_secs_f64();
    let tile: &Tile = &rendered.tile;
    println!("{} {seconds:.3} s {}", blake3::hash(&tile.encode()).to_hex(), rendered.rays);
    let Some(statistics) = statistics else { return Ok(()) };
    let began = Instant::now();
    let bytes = statistics.encode();
    println!(
        "{} of {} samples recorded, {} bytes in {:.3} s",
        statistics.paths.len(),
        statistics.samples(),
        bytes.len(),
        began.elapsed().as_secs_f64()
    );
    let began = Instant::now();
    let bins: Vec<_> = statistics.paths.values().map(|path| path_bins(&statistics.scope, path)).collect();
    let target = Target::of(&bins);
    println!("bins and target in {:.3} s", began.elapsed().as_secs_f64());
    let candidates = &bins[..bins.len().min(8 * N)];
    println!("the first: {:?}", Distance::of(candidates.iter().take(N), &target));
    for sets in [10, 100] {
        let began = Instant::now();
        let best = best_of(candidates, &target, N, sets);
        println!("best of {sets}: {best:?} in {:.3} s", began.elapsed().as_secs_f64());
    }
    let began = Instant::now();
    let found = representative(candidates, &target, N);
    let (distance, effective) = (found.distance, found.effective);
    println!("exchanged: {distance:?} in {:.3} s, worth {effective:.0}", began.elapsed().as_secs_f64());
    Ok(())
}

/// Paths of a representative set.
const N: usize = 5000;
