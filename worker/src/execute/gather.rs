//! The tiles of a group: their union, as sums for the next round and as resolved pixels for the merge.

use std::ops::Range;

use bytes::Bytes;
use femc_film::Piece;
use femc_model::{Artefact, Failure, GatherResult, More, Parts, Phase, TaskResult};

use super::union::union;
use super::{Product, Tools};
use crate::clock::Stopwatch;
use crate::sums;
use crate::table::Task;

pub(crate) fn gather(
    task: &Task,
    span: Range<u32>,
    parts: &Parts,
    more: More,
    tools: &Tools,
) -> Result<Product, Failure> {
    task.enter(Phase::Working);
    let watch = Stopwatch::start();
    let frame = union(task, span.clone(), parts, tools)?;
    let piece = tools.install(task, || Piece::of(&frame, span.start as usize..span.end as usize));
    let piece = piece.map_err(|error| Failure::Settings { message: error.to_string() })?;
    let mut artefacts = vec![Bytes::from(tools.install(task, || piece.encode()))];
    let pixels = Artefact::of(&artefacts[0]);
    let sums = (more == More::Rounds).then(|| {
        let bytes = Bytes::from(tools.install(task, || sums::encode(&frame)));
        let sums = Artefact::of(&bytes);
        artefacts.push(bytes);
        sums
    });
    tracing::debug!(tiles = parts.tiles.len(), bad = piece.bad().total(), seconds = watch.seconds(), "gathered");
    Ok(Product { result: TaskResult::Gather(GatherResult { sums, pixels, seconds: watch.seconds() }), artefacts })
}
