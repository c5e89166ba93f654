//! All tiles of a frame's round: their union, its error, and what follows; the image, if the frame is finished.

use bytes::Bytes;
use femc_film::{FilmError, Frame, FrameImage, Provenance, SampleRange, Tile, Tiling, ToneCurve, exr};
use femc_model::{Artefact, Decision, Failure, MergeResult, More, Phase, TaskResult, Work};
use femc_pipeline::{RoundVerdict, Settings};
use rayon::prelude::*;

use super::{Product, Tools};
use crate::clock::Stopwatch;
use crate::sums;
use crate::table::Task;

/// Tiles that are downloaded and taken in side by side: bounds what is in memory beside the frame.
const BATCH: usize = 16;

pub(crate) fn merge(task: &Task, tools: &Tools) -> Result<Product, Failure> {
    let Work::Merge { previous, tiles, spp, elapsed, busy_seconds, more } = &task.assignment.work else {
        return Err(Failure::Settings { message: "no merge".into() });
    };
    task.enter(Phase::Preparing);
    let watch = Stopwatch::start();
    let read = tools.cache.scene(&task.spec, &task.client, &tools.fetch)?;
    task.enter(Phase::Working);
    let frame = union(task, *previous, tiles, tools)?;
    let (image, error) = tools.pool.install(|| {
        let image = frame.resolve();
        let error = image.error();
        (image, error)
    });
    let spent = *elapsed as f64 / 1000.0;
    let next = task.spec.samples(task.assignment.task.stage.round + 1).len();
    let estimate = spent * next as f64 / f64::from((*spp).max(1));
    let decision = verdict(&read.settings, error.worst, spent, estimate, *more);
    let mut result = MergeResult {
        decision,
        sums: None,
        image: None,
        preview: None,
        relative_error: Some(error.worst).filter(|error| error.is_finite()),
        bad_samples: frame.bad().total(),
        seconds: 0.0,
    };
    let mut artefacts = Vec::new();
    let mut keep = |bytes: Vec<u8>| {
        let artefact = Artefact::of(&bytes);
        artefacts.push(Bytes::from(bytes));
        Some(artefact)
    };
    match decision {
        Decision::Continue => result.sums = keep(tools.pool.install(|| sums::encode(&frame))),
        Decision::Done => {
            let provenance = Provenance {
                version: env!("CARGO_PKG_VERSION").into(),
                settings: task.spec.settings.clone(),
                scene: read.digest.clone(),
                frame: task.assignment.task.stage.frame,
                seconds: busy_seconds + watch.seconds(),
                spp: frame.mean_spp(),
                relative_error: error.worst,
                bad: frame.bad(),
            };
            let (file, preview) = tools.pool.install(|| pictures(&image, &provenance)).map_err(damaged_picture)?;
            result.image = keep(file);
            result.preview = keep(preview);
        }
    }
    result.seconds = watch.seconds();
    Ok(Product { result: TaskResult::Merge(result), artefacts })
}

fn verdict(settings: &Settings, error: f64, spent: f64, next: f64, more: More) -> Decision {
    match settings.verdict(error, spent, next, more == More::Last) {
        RoundVerdict::Continue => Decision::Continue,
        RoundVerdict::Done => Decision::Done,
    }
}

fn pictures(image: &FrameImage, provenance: &Provenance) -> Result<(Vec<u8>, Vec<u8>), FilmError> {
    let preview = || ToneCurve::auto([&image.color]).picture(&image.color).to_png();
    let (file, preview) = rayon::join(|| exr::encode(image, provenance), preview);
    Ok((file?, preview?))
}

fn damaged_picture(error: FilmError) -> Failure {
    Failure::Panicked { message: format!("the image cannot be written: {error}") }
}

/// The sums of the rounds before and the tiles of this one. Whole: every tile holds just the samples of these rounds.
fn union(task: &Task, previous: Option<Artefact>, tiles: &[Artefact], tools: &Tools) -> Result<Frame, Failure> {
    let grid = task.spec.grid;
    let tiling = Tiling::new(grid.film[0], grid.film[1], grid.tile);
    let mut frame = Frame::new(tiling.map_err(|error| Failure::Settings { message: error.to_string() })?);
    if let Some(previous) = previous {
        let bytes = tools.fetch.all(&task.client, &[previous])?;
        for tile in tools.pool.install(|| sums::decode(&bytes[0])).map_err(|error| damaged(previous, &error))? {
            frame.insert(tile).map_err(|error| damaged(previous, &error))?;
        }
    }
    for batch in tiles.chunks(BATCH) {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let bytes = tools.fetch.all(&task.client, batch)?;
        let decoded: Vec<Result<Tile, FilmError>> =
            tools.pool.install(|| bytes.par_iter().map(|bytes| Tile::decode(bytes)).collect());
        for (artefact, tile) in batch.iter().zip(decoded) {
            tile.and_then(|tile| frame.insert(tile)).map_err(|error| damaged(*artefact, &error))?;
        }
    }
    let rounds = 0..=task.assignment.task.stage.round;
    let expected: Vec<SampleRange> = rounds.map(|round| task.spec.samples(round).into()).collect();
    for (index, artefact) in (0..frame.tiling().count()).zip(tiles) {
        if frame.ranges(index) != expected {
            let message = format!("tile {index} holds the samples {:?}, not {expected:?}", frame.ranges(index));
            return Err(Failure::DamagedInput { digest: artefact.digest, message });
        }
    }
    Ok(frame)
}

fn damaged(artefact: Artefact, error: &FilmError) -> Failure {
    Failure::DamagedInput { digest: artefact.digest, message: error.to_string() }
}
