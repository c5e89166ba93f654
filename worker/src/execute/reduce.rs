//! The reduce task: unites the tiles of a group, as sums for the next round, as resolved pixels for the image, and as errors for the
//! decision.

use femc_film::{ErrorStatistics, ImagePiece, sums};
use femc_model::{Failure, NextRound, Phase, Role, StageTemplate};

use super::inputs::{reduce_tiles, tile_span};
use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(crate) fn reduce(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    let span = tile_span(task, stage, Role::Tile)?;
    let frame = reduce_tiles(task, span.clone(), tools)?;
    let tiles = span.start as usize..span.end as usize;
    let piece = tools.install(task, || ImagePiece::from_frame(&frame, tiles.clone())).map_err(settings_failure)?;
    let mut product = Product::default();
    product.put(stage, Role::Pixels, || tools.install(task, || piece.encode()));
    if stage.outputs.contains(&Role::Errors) {
        let errors = tools.install(task, || ErrorStatistics::from_frame(&frame, tiles)).map_err(settings_failure)?;
        product.put(stage, Role::Errors, || errors.encode());
    }
    if task.assignment.spec.next_round == NextRound::Possible {
        product.put(stage, Role::Sums, || tools.install(task, || sums::encode(&frame)));
    }
    tracing::debug!(tiles = span.len(), bad = piece.bad_samples().total(), seconds = watch.seconds(), "united");
    product.result.seconds = watch.seconds();
    Ok(product)
}
