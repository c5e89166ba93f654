//! All that there is of a frame's round: its error, and what follows; the image, if the frame is finished.

use femc_fault::{Point, pass};
use femc_film::{BadSamples, FilmError, Frame, FrameImage, Piece, Provenance, ToneCurve, exr};
use femc_model::{Decision, Failure, More, Phase, Role, Template};
use femc_pipeline::{RoundVerdict, Settings};
use rayon::prelude::*;

use super::union::{Lost, artefacts, expected, tiles, tiling, union};
use super::{Product, Tools, unfit};
use crate::clock::Stopwatch;
use crate::sums;
use crate::table::Task;

/// Pieces that are downloaded and put in side by side: bounds what is in memory beside the image.
const BATCH: usize = 4;

/// The frame as it is measured and shown.
struct Joined {
    image: FrameImage,
    bad: BadSamples,
    /// For the next round; those of pieces are kept where they are.
    sums: Option<Frame>,
}

pub(crate) fn image(task: &Task, stage: &Template, tools: &Tools) -> Result<Product, Failure> {
    task.enter(Phase::Preparing);
    let watch = Stopwatch::start();
    let read = tools.cache.scene(&task.spec, &task.client, &tools.fetch)?;
    task.enter(Phase::Working);
    task.account.prepared(watch.elapsed());
    let (work, round) = (&task.assignment.work, task.assignment.task.stage.round);
    let Joined { image, bad, sums } = if stage.needs.iter().any(|need| need.role == Role::Pixels) {
        put_together(task, tools)?
    } else {
        let frame = union(task, tiles(task, stage)?, tools)?;
        let image = tools.install(task, || frame.resolve());
        Joined { image, bad: frame.bad(), sums: Some(frame) }
    };
    let (count, bytes) = work.artefacts().fold((0, 0), |(n, sum), input| (n + 1, sum + input.bytes));
    let spp = task.spec.samples(round).end;
    tracing::debug!(inputs = count, bytes, spp, seconds = watch.seconds(), "the frame is put together");
    let error = tools.install(task, || image.error());
    let spent = work.elapsed as f64 / 1000.0;
    let next = task.spec.samples(round + 1).len();
    let estimate = spent * next as f64 / f64::from(spp.max(1));
    let decision = verdict(&read.settings, error.worst, spent, estimate, work.more);
    tracing::debug!(error = error.worst, bad = bad.total(), ?decision, "the frame is measured");
    let mut product = Product::default();
    if decision == Decision::Done {
        let provenance = Provenance {
            version: env!("CARGO_PKG_VERSION").into(),
            engine: crate::engine().into(),
            settings: task.spec.settings.clone(),
            scene: read.digest.clone(),
            frame: task.assignment.task.stage.frame,
            seconds: work.busy_seconds + watch.seconds(),
            spp: image.mean_spp(),
            relative_error: error.worst,
            bad,
        };
        let (file, preview) =
            tools.install(task, || pictures(&image, &provenance)).map_err(|error| damaged_picture(&error))?;
        product.put(stage, Role::Image, || file);
        product.put(stage, Role::Preview, || preview);
    } else if let Some(frame) = sums {
        product.put(stage, Role::Sums, || tools.install(task, || sums::encode(&frame)));
    }
    let result = &mut product.result;
    result.decision = stage.closes.map(|_| decision);
    result.relative_error = Some(error.worst).filter(|error| error.is_finite());
    result.seconds = watch.seconds();
    Ok(product)
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

/// Resolved pixels of all tiles: every tile once, each with just the samples of these rounds.
fn put_together(task: &Task, tools: &Tools) -> Result<Joined, Failure> {
    let (tiling, expected) = (tiling(task)?, expected(task));
    let mut joined =
        Joined { image: FrameImage::black(tiling.width, tiling.height), bad: BadSamples::default(), sums: None };
    let (mut lost, mut past, mut covered) = (Lost::default(), 0, 0);
    for batch in artefacts(task, Role::Pixels).chunks(BATCH) {
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
    Err(unfit(format!("the pieces hold {covered} tiles, the frame has {}", tiling.count())))
}
