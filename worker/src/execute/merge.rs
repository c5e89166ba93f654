//! All tiles of a frame's round: their union, its error, and what follows; the image, if the frame is finished.

use std::collections::BTreeMap;

use bytes::Bytes;
use femc_fault::{Point, pass};
use femc_film::{FilmError, Frame, FrameImage, Provenance, SampleRange, Tile, Tiling, ToneCurve, exr};
use femc_model::{Artefact, Decision, Digest, Failure, MergeResult, More, Phase, TaskResult, Work};
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
    tracing::debug!(tiles = tiles.len(), spp, seconds = watch.seconds(), "tiles are joined");
    let (image, error) = tools.install(task, || {
        let image = frame.resolve();
        let error = image.error();
        (image, error)
    });
    let spent = *elapsed as f64 / 1000.0;
    let next = task.spec.samples(task.assignment.task.stage.round + 1).len();
    let estimate = spent * next as f64 / f64::from((*spp).max(1));
    let decision = verdict(&read.settings, error.worst, spent, estimate, *more);
    tracing::debug!(error = error.worst, bad = frame.bad().total(), ?decision, "the frame is measured");
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
        Decision::Continue => result.sums = keep(tools.install(task, || sums::encode(&frame))),
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

/// The sums of the rounds before and the tiles of this one. Whole: every tile holds just the samples of these rounds, in
/// whatever parts they came. Names every input that is lost, so that all are made again at once.
fn union(task: &Task, previous: Option<Artefact>, tiles: &[Artefact], tools: &Tools) -> Result<Frame, Failure> {
    let grid = task.spec.grid;
    let tiling = Tiling::new(grid.film[0], grid.film[1], grid.tile);
    let mut frame = Frame::new(tiling.map_err(|error| Failure::Settings { message: error.to_string() })?);
    let mut lost = Lost::default();
    // What each tile of this round is made of.
    let mut parts: BTreeMap<Option<usize>, Vec<Digest>> = BTreeMap::new();
    if let Some(previous) = previous {
        for bytes in tools.fetch.all(&task.client, &[previous]) {
            let Some(bytes) = lost.note(bytes)? else { continue };
            let insert = |tiles: Vec<Tile>| tiles.into_iter().try_for_each(|tile| frame.insert(tile).map(drop));
            lost.check(previous, tools.install(task, || sums::decode(&bytes)).and_then(insert));
        }
    }
    for batch in tiles.chunks(BATCH) {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let mut here = Vec::with_capacity(batch.len());
        for (artefact, bytes) in batch.iter().zip(tools.fetch.all(&task.client, batch)) {
            here.extend(lost.note(bytes)?.map(|bytes| (*artefact, bytes)));
        }
        let decoded: Vec<Result<Tile, FilmError>> =
            tools.install(task, || here.par_iter().map(|(_, bytes)| Tile::decode(bytes)).collect());
        for ((artefact, _), tile) in here.iter().zip(decoded) {
            pass(Point::WorkerMidMerge);
            let place = tile.as_ref().ok().and_then(|tile| frame.tiling().index_of(tile.rect()));
            parts.entry(place).or_default().push(artefact.digest);
            lost.check(*artefact, tile.and_then(|tile| frame.insert(tile).map(drop)));
        }
    }
    lost.verdict()?;
    let spp = task.spec.samples(task.assignment.task.stage.round).end;
    for index in (0..frame.tiling().count()).filter(|&index| !hold(frame.ranges(index), spp)) {
        let message = format!("tile {index} holds the samples {:?}, not 0..{spp}", frame.ranges(index));
        let Some(digests) = parts.remove(&Some(index)) else { return Err(Failure::Panicked { message }) };
        lost.digests.extend(digests);
        lost.message = message;
    }
    lost.verdict()?;
    Ok(frame)
}

/// Whether the ranges, which are disjoint and ascend, are together the samples `0..spp`.
fn hold(ranges: &[SampleRange], spp: u32) -> bool {
    let end = ranges.iter().try_fold(0, |end, range| (range.start == end).then_some(range.end));
    end == Some(spp)
}

/// Inputs that are missing or damaged.
#[derive(Debug, Default)]
struct Lost {
    digests: Vec<Digest>,
    message: String,
}

impl Lost {
    /// The bytes; `None` where they are lost; a failure of another kind ends the merge.
    fn note(&mut self, bytes: Result<Bytes, Failure>) -> Result<Option<Bytes>, Failure> {
        match bytes {
            Ok(bytes) => Ok(Some(bytes)),
            Err(Failure::LostInputs { digests, message }) => {
                self.digests.extend(digests);
                self.message = message;
                Ok(None)
            }
            Err(failure) => Err(failure),
        }
    }

    fn check(&mut self, artefact: Artefact, outcome: Result<(), FilmError>) {
        if let Err(error) = outcome {
            self.digests.push(artefact.digest);
            self.message = error.to_string();
        }
    }

    fn verdict(&mut self) -> Result<(), Failure> {
        if self.digests.is_empty() {
            return Ok(());
        }
        let Self { digests, message } = std::mem::take(self);
        Err(Failure::LostInputs { digests, message })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_is_whole_in_whatever_parts_and_not_with_a_gap_or_less_or_more() {
        let whole = |bounds: &[(u32, u32)]| {
            let ranges: Vec<SampleRange> = bounds.iter().map(|&(start, end)| SampleRange { start, end }).collect();
            hold(&ranges, 12)
        };
        assert!(whole(&[(0, 12)]) && whole(&[(0, 1), (1, 7), (7, 12)]));
        for other in [&[][..], &[(0, 11)], &[(1, 12)], &[(0, 5), (6, 12)], &[(0, 12), (12, 13)]] {
            assert!(!whole(other), "{other:?}");
        }
    }
}
