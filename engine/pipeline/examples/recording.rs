//! Measures the cost of light statistics. It renders a frame of a scene on one thread, tile by tile as a farm does, alternately
//! without and with statistics. Then it unites the tiles' statistics and chooses a representative set.
//!
//! `cargo run --release -p femc-pipeline --example recording -- scene.mgf 192x192 32 5`
//!
//! With `without` or `with` as a fifth argument it renders once and only in that way, for counting instructions.

use femc_film::{Rect, Tiling};
use femc_pipeline::paths::represent::{Distance, PathBins, Target, best_random_set, choose_representative};
use femc_pipeline::paths::schema::path_bins;
use femc_pipeline::paths::{LightStatistics, PathsError};
use femc_pipeline::{
    Outputs, Prepared, RenderTask, SceneSource, Settings, StatisticsPlan, StopCondition, prepare_frame,
};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Number of paths of a representative set.
const N: usize = 5000;
/// Width and height of a tile, pixels.
const EDGE: u32 = 64;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [file, size, samples, pairs, way @ ..] = &words[..] else {
        return Err("usage: recording SCENE WIDTHxHEIGHT SAMPLES TURNS [without|with]".into());
    };
    let (width, height) = size.split_once('x').ok_or("the size is WIDTHxHEIGHT")?;
    let size = Some([width.parse()?, height.parse()?]);
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let source = SceneSource::new(Arc::new(femc_import::load_scene_file(Path::new(file))?.scene));
    let settings = Settings { size, seed: 7, stop: StopCondition::Spp(samples.parse()?), ..Settings::default() };
    let prepared = prepare_frame(&source, &settings, 1, None)?;
    if let [way] = way {
        let (seconds, hash) = render_frame(&prepared, &settings, way == "with")?;
        println!("{hash} {seconds:.3} s");
        return Ok(());
    }
    let ([without, with], parts) = render_alternately(&prepared, &settings, pairs.parse()?)?;
    println!("rendered in {without:.3} s, with statistics in {with:.3} s: {:+.2} %", 100.0 * (with / without - 1.0));
    let all = merge_statistics(&parts, without)?;
    print_representatives(&all);
    Ok(())
}

/// Renders all tiles of a frame in one way. Returns the seconds, and the hash of the tiles.
fn render_frame(prepared: &Prepared, settings: &Settings, with: bool) -> Result<(f64, blake3::Hash), Box<dyn Error>> {
    let mut hasher = blake3::Hasher::new();
    let began = Instant::now();
    for rect in tiling(prepared).rects() {
        hasher.update(&render_encoded(prepared, settings, rect, with)?.0);
    }
    Ok((began.elapsed().as_secs_f64(), hasher.finalize()))
}

/// Seconds without and with statistics, and the statistics of the tiles.
type AlternateRuns = ([f64; 2], Vec<Vec<u8>>);

/// Renders each tile `turns` times in both ways, alternately. The seconds of a frame are the sum of the minimum of each tile: other
/// load on the machine lengthens some turns, but hardly ever all turns of a tile.
fn render_alternately(prepared: &Prepared, settings: &Settings, turns: u32) -> Result<AlternateRuns, Box<dyn Error>> {
    let (mut sums, mut parts) = ([0.0; 2], Vec::new());
    for rect in tiling(prepared).rects() {
        let (mut least, mut tiles) = ([f64::INFINITY; 2], [Vec::new(), Vec::new()]);
        let mut part = None;
        for turn in 0..2 * turns {
            let with = turn % 2 == 1;
            let began = Instant::now();
            let (tile, own) = render_encoded(prepared, settings, rect, with)?;
            let way = usize::from(with);
            least[way] = least[way].min(began.elapsed().as_secs_f64());
            tiles[way] = tile;
            part = own.or(part);
        }
        if tiles[0] != tiles[1] {
            return Err("statistics have changed the pixels".into());
        }
        parts.extend(part);
        sums = [sums[0] + least[0], sums[1] + least[1]];
    }
    Ok((sums, parts))
}

fn tiling(prepared: &Prepared) -> Tiling {
    let [width, height] = prepared.camera.film;
    Tiling { width, height, edge: EDGE }
}

/// Bytes of a tile, and of its statistics.
type EncodedTile = (Vec<u8>, Option<Vec<u8>>);

/// Renders and packs a tile, as a task of the farm does.
fn render_encoded(
    prepared: &Prepared,
    settings: &Settings,
    rect: Rect,
    with: bool,
) -> Result<EncodedTile, Box<dyn Error>> {
    let StopCondition::Spp(spp) = settings.stop else { return Err("samples are not counted".into()) };
    let plan = with.then(|| StatisticsPlan::new(prepared, settings, EDGE));
    let outputs = Outputs { statistics: plan.as_ref(), ..Outputs::default() };
    let done = RenderTask::new(prepared, settings, rect, 0..spp).render(outputs)?;
    Ok((done.tile.encode(), done.statistics.map(|part| part.encode())))
}

/// Unites the tiles as the last task of a frame does.
fn merge_statistics(parts: &[Vec<u8>], render: f64) -> Result<LightStatistics, Box<dyn Error>> {
    let began = Instant::now();
    let decoded: Result<Vec<LightStatistics>, PathsError> =
        parts.iter().map(|part| LightStatistics::decode(part)).collect();
    let mut decoded = decoded?.into_iter();
    let mut all = decoded.next().ok_or("no tiles")?;
    all.merge_all(decoded)?;
    let all = all.into_image_samples(0, |_, _| u32::MAX);
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

fn print_representatives(all: &LightStatistics) {
    let began = Instant::now();
    let bins: Vec<PathBins> = all.paths.values().map(|path| path_bins(&all.scope, path)).collect();
    let target = Target::from_paths(&bins);
    println!("bins of {} paths in {:.1} ms", bins.len(), 1e3 * began.elapsed().as_secs_f64());
    let candidates = &bins[..bins.len().min(8 * N)];
    println!("the first {N}: {:?}", Distance::between(candidates.iter().take(N), &target));
    for sets in [10, 100] {
        let began = Instant::now();
        let best = best_random_set(candidates, &target, N, sets);
        println!("best of {sets}: {best:?} in {:.1} ms", 1e3 * began.elapsed().as_secs_f64());
    }
    let began = Instant::now();
    let found = choose_representative(candidates, &target, N);
    let milliseconds = 1e3 * began.elapsed().as_secs_f64();
    println!("exchanged: {:?} in {milliseconds:.1} ms, worth {:.0}", found.distance, found.effective_size);
}
