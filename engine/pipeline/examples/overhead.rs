//! What light statistics cost: renders a frame of a scene on one thread, tile by tile as a farm does, by turns without and with statistics;
//! unites what the tiles have, and chooses a representative set.
//!
//! `cargo run --release -p femc-pipeline --example overhead -- scene.mgf 192x192 32 5`
//!
//! With `without` or `with` as a fifth word it renders once and in that way alone: to count instructions.

use femc_film::Tiling;
use femc_pipeline::paths::represent::{Bins, Distance, Target, best_of, representative};
use femc_pipeline::paths::schema::path_bins;
use femc_pipeline::paths::{PathsError, Statistics};
use femc_pipeline::{Prepared, Settings, Source, StatisticsPlan, Stop, prepare, render_tile, render_with_statistics};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Instant;

/// Paths of a representative set.
const N: usize = 5000;
/// Width and height of a tile, pixels.
const EDGE: u32 = 64;

/// What a way of rendering a frame took, the hash of its tiles, and the statistics of each.
type Rendered = (f64, blake3::Hash, Vec<Vec<u8>>);

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [file, size, samples, pairs, way @ ..] = &words[..] else {
        return Err("usage: overhead SCENE WIDTHxHEIGHT SAMPLES PAIRS [without|with]".into());
    };
    let (width, height) = size.split_once('x').ok_or("the size is WIDTHxHEIGHT")?;
    let size = Some([width.parse()?, height.parse()?]);
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let source = Source::new(Arc::new(femc_import::load_path(Path::new(file))?.scene));
    let settings = Settings { size, seed: 7, stop: Stop::Spp(samples.parse()?), ..Settings::default() };
    let prepared = prepare(&source, &settings, 1, None)?;
    if let [way] = way {
        let (seconds, hash, _) = frame(&prepared, &settings, way == "with")?;
        println!("{hash} {seconds:.3} s");
        return Ok(());
    }
    let (mut least, mut parts) = ([f64::INFINITY; 2], Vec::new());
    for _ in 0..pairs.parse::<u32>()? {
        let (without, expected, _) = frame(&prepared, &settings, false)?;
        let (with, hash, own) = frame(&prepared, &settings, true)?;
        if hash != expected {
            return Err("statistics have changed the pixels".into());
        }
        (least, parts) = ([least[0].min(without), least[1].min(with)], own);
    }
    let [without, with] = least;
    println!("rendered in {without:.3} s, with statistics in {with:.3} s: {:+.2} %", 100.0 * (with / without - 1.0));
    let all = united(&parts, without)?;
    represent(&all);
    Ok(())
}

/// Renders and packs all tiles of a frame.
fn frame(prepared: &Prepared, settings: &Settings, with: bool) -> Result<Rendered, Box<dyn Error>> {
    let [width, height] = prepared.camera.film;
    let tiling = Tiling { width, height, edge: EDGE };
    let plan = StatisticsPlan::of(prepared, settings, EDGE);
    let (cancel, progress) = (AtomicBool::new(false), AtomicU64::new(0));
    let (mut hasher, mut parts) = (blake3::Hasher::new(), Vec::new());
    let began = Instant::now();
    for rect in tiling.rects() {
        let Stop::Spp(spp) = settings.stop else { return Err("samples are not counted".into()) };
        let tile = if with {
            let done = render_with_statistics(prepared, settings, &plan, rect, 0..spp, &cancel, &progress)?;
            parts.push(done.1.encode());
            done.0.tile
        } else {
            render_tile(prepared, settings, rect, 0..spp, &cancel, &progress)?.tile
        };
        hasher.update(&tile.encode());
    }
    Ok((began.elapsed().as_secs_f64(), hasher.finalize(), parts))
}

/// Unites the tiles as the last task of a frame does.
fn united(parts: &[Vec<u8>], render: f64) -> Result<Statistics, Box<dyn Error>> {
    let began = Instant::now();
    let decoded: Result<Vec<Statistics>, PathsError> = parts.iter().map(|part| Statistics::decode(part)).collect();
    let mut decoded = decoded?.into_iter();
    let mut all = decoded.next().ok_or("no tiles")?;
    all.unite_all(decoded)?;
    let all = all.counted(0, |_, _| u32::MAX);
    let file = all.encode();
    let seconds = began.elapsed().as_secs_f64();
    println!(
        "{} of {} samples recorded ({:.3} %); the tiles send {} bytes, the file has {}",
        all.paths.len(),
        all.samples(),
        100.0 * all.share(),
        parts.iter().map(Vec::len).sum::<usize>(),
        file.len()
    );
    let paths = (all.paths.len() + all.brightest.len() + all.deepest.len()) as f64;
    println!(
        "united in {seconds:.3} s: {:.1} us a record, {:.2} % of rendering",
        1e6 * seconds / paths,
        100.0 * seconds / render
    );
    Ok(all)
}

fn represent(all: &Statistics) {
    let began = Instant::now();
    let bins: Vec<Bins> = all.paths.values().map(|path| path_bins(&all.scope, path)).collect();
    let target = Target::of(&bins);
    println!("bins of {} paths in {:.1} ms", bins.len(), 1e3 * began.elapsed().as_secs_f64());
    let candidates = &bins[..bins.len().min(8 * N)];
    println!("the first {N}: {:?}", Distance::of(candidates.iter().take(N), &target));
    for sets in [10, 100] {
        let began = Instant::now();
        let best = best_of(candidates, &target, N, sets);
        println!("best of {sets}: {best:?} in {:.1} ms", 1e3 * began.elapsed().as_secs_f64());
    }
    let began = Instant::now();
    let found = representative(candidates, &target, N);
    let milliseconds = 1e3 * began.elapsed().as_secs_f64();
    println!("exchanged: {:?} in {milliseconds:.1} ms, worth {:.0}", found.distance, found.effective);
}
