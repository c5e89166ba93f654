//! All that there is of a frame's round: its error, and what follows; the image, if the frame is finished.

use bytes::Bytes;
use femc_fault::{Point, pass};
use femc_film::{BadSamples, FilmError, Frame, FrameImage, Piece, Provenance, ToneCurve, exr};
use femc_model::{Artefact, Decision, Failure, MergeInputs, MergeResult, More, Phase, TaskResult, Work};
use femc_pipeline::{RoundVerdict, Settings};
use rayon::prelude::*;

use super::union::{Lost, expected, tiling, union};
use super::{Product, Tools};
use crate::clock::Stopwatch;
use crate::sums;
use crate::table::Task;

/// Groups of tiles that are downloaded and put in side by side: bounds what is in memory beside the image.
const BATCH: usize = 4;

/// The frame as it is measured and shown.
struct Joined {
    image: FrameImage,
    bad: BadSamples,
    /// For the next round; those of groups are kept where they are.
    sums: Option<Frame>,
}

pub(crate) fn merge(task: &Task, tools: &Tools) -> Result<Product, Failure> {
    let Work::Merge { inputs, spp, elapsed, busy_seconds, more } = &task.assignment.work else {
        return Err(Failure::Settings { message: "no merge".into() });
    };
    task.enter(Phase::Preparing);
    let watch = Stopwatch::start();
    let read = tools.cache.scene(&task.spec, &task.client, &tools.fetch)?;
    task.enter(Phase::Working);
    task.account.prepared(watch.elapsed());
    let Joined { image, bad, sums } = match inputs {
        MergeInputs::Tiles(parts) => {
            let frame = union(task, 0..task.spec.grid.tiles(), parts, tools)?;
            let image = tools.install(task, || frame.resolve());
            Joined { image, bad: frame.bad(), sums: Some(frame) }
        }
        MergeInputs::Groups(groups) => put_together(task, groups, tools)?,
    };
    let (count, bytes) = task.assignment.work.inputs().fold((0, 0), |(n, sum), input| (n + 1, sum + input.bytes));
    tracing::debug!(inputs = count, bytes, spp, seconds = watch.seconds(), "the frame is put together");
    let error = tools.install(task, || image.error());
    let spent = *elapsed as f64 / 1000.0;
    let next = task.spec.samples(task.assignment.task.stage.round + 1).len();
    let estimate = spent * next as f64 / f64::from((*spp).max(1));
    let decision = verdict(&read.settings, error.worst, spent, estimate, *more);
    tracing::debug!(error = error.worst, bad = bad.total(), ?decision, "the frame is measured");
    let mut result = MergeResult {
        decision,
        sums: None,
        image: None,
        preview: None,
        relative_error: Some(error.worst).filter(|error| error.is_finite()),
        bad_samples: bad.total(),
        seconds: 0.0,
    };
    let mut artefacts = Vec::new();
    let mut keep = |bytes: Vec<u8>| {
        let artefact = Artefact::of(&bytes);
        artefacts.push(Bytes::from(bytes));
        Some(artefact)
    };
    match decision {
        Decision::Continue => {
            result.sums = sums.and_then(|frame| keep(tools.install(task, || sums::encode(&frame))));
        }
        Decision::Done => {
            let provenance = Provenance {
                version: env!("CARGO_PKG_VERSION").into(),
                engine: crate::engine().into(),
                settings: task.spec.settings.clone(),
                scene: read.digest.clone(),
                frame: task.assignment.task.stage.frame,
                seconds: busy_seconds + watch.seconds(),
                spp: image.mean_spp(),
                relative_error: error.worst,
                bad,
            };
            let (file, preview) =
                tools.install(task, || pictures(&image, &provenance)).map_err(|error| damaged_picture(&error))?;
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

fn damaged_picture(error: &FilmError) -> Failure {
    Failure::Panicked { message: format!("the image cannot be written: {error}") }
}

/// The pieces of all groups: every tile once, each with just the samples of these rounds.
fn put_together(task: &Task, groups: &[Artefact], tools: &Tools) -> Result<Joined, Failure> {
    let (tiling, expected) = (tiling(task)?, expected(task));
    let mut joined =
        Joined { image: FrameImage::black(tiling.width, tiling.height), bad: BadSamples::default(), sums: None };
    let (mut lost, mut past, mut covered) = (Lost::default(), 0, 0);
    for batch in groups.chunks(BATCH) {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let here = lost.fetch(task, batch, tools)?;
        let pieces: Vec<Result<Piece, FilmError>> =
            tools.install(task, || here.par_iter().map(|(_, bytes)| Piece::decode(bytes)).collect());
        for ((artefact, _), piece) in here.iter().zip(pieces) {
            pass(Point::WorkerMidMerge);
            let put = piece.and_then(|piece| {
                let tiles = piece.tiles();
                if piece.tiling() != tiling || tiles.start < past || piece.samples() != expected {
                    return Err(FilmError::Corrupt("a piece of another frame, round or place"));
                }
                covered += tiles.len();
                past = tiles.end;
                joined.bad.merge(piece.bad());
                joined.image.put(&piece)
            });
            lost.check(*artefact, put);
        }
    }
    lost.verdict()?;
    if covered == tiling.count() {
        return Ok(joined);
    }
    Err(Failure::Settings { message: format!("the groups hold {covered} tiles, the frame has {}", tiling.count()) })
}
