//! Test jobs: small scenes, their jobs, and their frames as the engine renders them without a farm.

use std::collections::BTreeMap;
use std::num::{NonZeroU32, NonZeroU64};
use std::sync::{Arc, LazyLock};

use anyhow::Context as _;
use bytes::Bytes;
use femc_film::{Frame, Image, Tiling, exr, pixel_digest};
use femc_import::Bundle;
use femc_model::{Digest, Grid, JobNotes, JobSpec, Role};
use femc_pipeline::{Method, Settings, StopCondition};
use femc_schedule::Config;
use femc_worker::Cache;

/// A lamp over a floor, in fog that thickens with time.
const SCENE: &str = "
camera main =
    origin 0 -3 1
    target 0 0 0.5
    fov 40
    film 16 12
time 0 1 2
vary medium.haze.sigma_s = 0 0.05 1 0.4
medium haze =
    sigma_s 0.05
mbox haze -1 -1 -1 1 1 1
m gray =
    c
    rd 0.6
m bright =
    c
    ed 2000
v a =
    p -2 -2 0
v b =
    p 2 -2 0
v c =
    p 2 2 0
v d =
    p -2 2 0
m gray
f a b c d
v e =
    p 0 0 1.2
m bright
sph e 0.2
";

/// Returns a scene without fog and with a wall. It is static while the camera zooms.
/// - `reflectance`: of floor and wall.
fn static_scene(reflectance: f64) -> String {
    let wall = "v g =\n    p -2 2 2\nv h =\n    p 2 2 2\nm gray\nf d c h g\n";
    let scene = SCENE.replace("mbox haze -1 -1 -1 1 1 1\n", "").replace("rd 0.6", &format!("rd {reflectance}"));
    scene.replace("vary medium.haze.sigma_s = 0 0.05 1 0.4", "vary camera.main.fov = 0 40 1 30") + wall
}

pub(crate) const FRAMES: [u32; 3] = [1, 2, 3];
const FILM: [u32; 2] = [16, 12];
const TILE: u32 = 8;

/// Prepared scenes and frames, shared by all workers of all worlds. Preparing them again would test nothing.
pub(crate) static CACHE: LazyLock<Cache> = LazyLock::new(|| Cache::new(16));

/// A job, its bundle, and its expected frames.
#[derive(Debug, Clone)]
pub(crate) struct TestJob {
    pub(crate) spec: JobSpec,
    pub(crate) bundle: Bytes,
    /// Role of a frame's result: an image, or the answer of a drill.
    pub(crate) result_role: Role,
    /// Digest of the pixels or of the answer of each frame.
    pub(crate) digests: Vec<String>,
    /// Light transport method, and number of blocks of its first pass.
    pub(crate) method_and_blocks: (Method, u32),
}

impl TestJob {
    /// Number of jobs that [`path_traced_job`] chooses from.
    pub(crate) const COUNT: u64 = (2 * ROUNDS.len() * FANS.len()) as u64;

    /// Returns the job with groups of at most `fan` tiles.
    fn with_fan(&self, fan: NonZeroU32) -> Self {
        let Grid { film, tile } = self.spec.grid;
        let tiling = Tiling { width: film[0], height: film[1], edge: tile };
        let (method, blocks) = self.method_and_blocks;
        let graph = femc_pipeline::job_graph(&tiling, self.spec.rounds(), fan, method);
        let graph = femc_pipeline::split_first_pass(graph, method, blocks);
        let spec = JobSpec { graph, ..self.spec.clone() };
        Self { spec, ..self.clone() }
    }

    /// Returns the job with these frames only.
    pub(crate) fn with_frames(&self, frames: Vec<u32>) -> JobSpec {
        let contents = self.spec.contents.iter().map(|(_, key)| (frames.len() as u32, *key)).collect();
        JobSpec { frames, contents, ..self.spec.clone() }
    }

    /// Computes the digest of a finished frame's result.
    pub(crate) fn digest(&self, file: Bytes) -> anyhow::Result<String> {
        if self.result_role != Role::Image {
            return Ok(Digest::compute(&file).to_string());
        }
        let image: Image = exr::decode(std::io::Cursor::new(file))?.image;
        Ok(pixel_digest(&image).to_string())
    }
}

/// Time that a farm waits for workers of a missing build, in milliseconds. The default is longer than a world lasts.
const ORPHAN_TIMEOUT: u64 = 5_000;

/// Returns settings without sample chunks. Workers hold many tiles.
fn unchunked_config() -> Config {
    Config { ahead: 100_000, orphaned_after: ORPHAN_TIMEOUT, ..Config::default() }
}

/// Returns settings with sample chunks of one sample per pixel.
pub(crate) fn chunked_config() -> Config {
    let chunk = NonZeroU64::new(u64::from(TILE * TILE)).unwrap_or(NonZeroU64::MIN);
    Config {
        chunk_size: chunk,
        work_per_lease: 2_000,
        min_work_per_lease: 500,
        orphaned_after: ORPHAN_TIMEOUT,
        ..Config::default()
    }
}

/// Rounds of the jobs: one or several. Later rounds are long enough to be cut into sample chunks.
const ROUNDS: [&[u32]; 4] = [&[2], &[1, 2, 4], &[12], &[3, 5, 12]];

/// Most tiles of a group, out of four: one group, or a tree of even or uneven groups.
const FANS: [NonZeroU32; 4] = [NonZeroU32::MAX, NonZeroU32::MIN, TWO, TWO.saturating_add(1)];
const TWO: NonZeroU32 = NonZeroU32::MIN.saturating_add(1);

/// Jobs with two seeds for each list of rounds and each grouping. Another seed gives other pixels.
static PATH_TRACED_JOBS: LazyLock<Result<Vec<TestJob>, String>> = LazyLock::new(|| {
    let kinds = (0..2).flat_map(|seed| ROUNDS.map(|rounds| render_path_traced(rounds, seed)));
    let kinds: Vec<TestJob> = kinds.collect::<anyhow::Result<_>>().map_err(|error| format!("{error:#}"))?;
    Ok(FANS.iter().flat_map(|&fan| kinds.iter().map(move |stage| stage.with_fan(fan))).collect())
});

/// Returns the job of this number.
pub(crate) fn path_traced_job(number: u64) -> anyhow::Result<&'static TestJob> {
    let stages = PATH_TRACED_JOBS.as_ref().map_err(|error| anyhow::anyhow!("{error}"))?;
    stages.get((number % stages.len() as u64) as usize).context("a stage")
}

/// Jobs with a first pass. Jobs of one scene share it. There are two scenes, one round or several, and first passes solved by one
/// task or in blocks.
static FIRST_PASS_JOBS: LazyLock<Result<Vec<TestJob>, String>> = LazyLock::new(|| {
    let lights = [(Method::Fem, 1), (Method::Femc, 3), (Method::Fem, 2)];
    let kinds = lights.into_iter().flat_map(|light| {
        [0.3, 0.6].into_iter().flat_map(move |gray| [ROUNDS[0], ROUNDS[1]].map(|rounds| (light, gray, rounds)))
    });
    let lit = kinds.map(|(light, reflectance, rounds)| render_job(&static_scene(reflectance), light, rounds, 0));
    lit.collect::<anyhow::Result<_>>().map_err(|error| format!("{error:#}"))
});

/// Returns the job of this number among those with a first pass.
pub(crate) fn first_pass_job(number: u64) -> anyhow::Result<TestJob> {
    let stages = FIRST_PASS_JOBS.as_ref().map_err(|error| anyhow::anyhow!("{error}"))?;
    let count = stages.len() as u64;
    let job = stages.get((number % count) as usize).context("a stage")?;
    Ok(job.with_fan(FANS[(number / count % 4) as usize]))
}

/// Returns the farm's settings for cutting tasks, by number.
pub(crate) fn config(number: u64) -> Config {
    if number % 4 < 2 { unchunked_config() } else { chunked_config() }
}

/// Returns settings without sample chunks. Workers hold as many tasks as real ones.
pub(crate) fn realistic_queue_config() -> Config {
    Config { ahead: Config::default().ahead, ..unchunked_config() }
}

/// Returns a job that shares only its scene with jobs of other numbers.
pub(crate) fn fresh_job(number: u64) -> anyhow::Result<TestJob> {
    Ok(render_path_traced(ROUNDS[(number % 4) as usize], number)?.with_fan(FANS[(number / 4 % 4) as usize]))
}

/// Jobs of many tiles of one size: with one round, and with several.
static EVEN_JOBS: LazyLock<Result<[TestJob; 2], String>> = LazyLock::new(|| {
    const EDGE: u32 = 4;
    let even = |rounds: &[u32]| {
        render_tiled_job(SCENE, (Method::Pt, 1), rounds, 0, EDGE).map_err(|error| format!("{error:#}"))
    };
    Ok([even(ROUNDS[0])?, even(ROUNDS[1])?])
});

/// Returns a job of 12 tiles per frame, all of one size, or of 36 in three rounds.
/// - `rounds`: 1 or 3.
pub(crate) fn even_job(rounds: usize) -> anyhow::Result<TestJob> {
    let [one, several] = EVEN_JOBS.as_ref().map_err(|error| anyhow::anyhow!("{error}"))?;
    Ok(if rounds == 1 { one.clone() } else { several.clone() })
}

fn render_path_traced(rounds: &[u32], seed: u64) -> anyhow::Result<TestJob> {
    render_job(SCENE, (Method::Pt, 1), rounds, seed)
}

fn render_job(scene: &str, light: (Method, u32), rounds: &[u32], seed: u64) -> anyhow::Result<TestJob> {
    render_tiled_job(scene, light, rounds, seed, TILE)
}

/// - `edge`: edge length of a tile, in pixels.
fn render_tiled_job(
    scene: &str,
    (method, blocks): (Method, u32),
    rounds: &[u32],
    seed: u64,
    edge: u32,
) -> anyhow::Result<TestJob> {
    // This error is never reached, so every round runs.
    let stop = if let [spp] = rounds { StopCondition::Spp(*spp) } else { StopCondition::Error(1e-9) };
    // Light stored in elements has had any number of bounces.
    let max_depth = if method.has_first_pass() { 0 } else { 3 };
    let settings = Settings { stop, max_depth, seed, method, ..Settings::default() };
    let bundle = Bundle(BTreeMap::from([("haze.mgf".into(), scene.as_bytes().to_vec())]));
    let source = femc_pipeline::SceneSource::new(Arc::new(femc_import::load_scene(&bundle, "haze.mgf")?.scene));
    let spp = *rounds.last().context("a round")?;
    let (mut digests, mut contents) = (Vec::new(), Vec::new());
    for number in FRAMES {
        if method.has_first_pass() {
            let key =
                femc_pipeline::first_pass_key(&femc_pipeline::frame_key(&source, &settings, number)?, method, blocks);
            contents.push((FRAMES.len() as u32, Digest::from_bytes(key)));
        }
        let prepared = femc_pipeline::prepare_frame(&source, &settings, number, None)?;
        let tiling = Tiling::new(FILM[0], FILM[1], edge)?;
        let mut frame = Frame::new(tiling);
        for rect in tiling.rects() {
            let tile = femc_pipeline::RenderTask::new(&prepared, &settings, rect, 0..spp)
                .render(femc_pipeline::Outputs::default())?
                .tile;
            frame.insert(tile)?;
        }
        digests.push(pixel_digest(&frame.resolve().color).to_string());
    }
    contents.dedup();
    let bytes = bundle.encode()?;
    let graph = femc_pipeline::job_graph(&Tiling::new(FILM[0], FILM[1], edge)?, rounds, FANS[0], method);
    let spec = JobSpec {
        name: "haze".into(),
        bundle: Digest::compute(&bytes),
        entry: "haze.mgf".into(),
        settings: serde_json::to_string(&settings)?,
        frames: FRAMES.to_vec(),
        grid: Grid { film: FILM, tile: edge },
        graph: femc_pipeline::split_first_pass(graph, method, blocks),
        contents,
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    };
    Ok(TestJob { spec, bundle: bytes.into(), result_role: Role::Image, digests, method_and_blocks: (method, blocks) })
}
