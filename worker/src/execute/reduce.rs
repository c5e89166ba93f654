//! The reduce task: combines outputs of one role. It combines the tiles of a group as sums for the next round, as resolved pixels
//! for the image, and as errors for the decision. It also combines levels for a clip's exposure and the statistics of paths.

use femc_film::{Errors, Piece};
use femc_model::{Failure, More, Phase, Role, Template};

use super::encode::levels;
use super::union::{tiles, union};
use super::{Product, Tools, layers, statistics, unfit};
use crate::clock::Stopwatch;
use crate::sums;
use crate::table::Task;

pub(crate) fn reduce(task: &Task, stage: &Template, tools: &Tools) -> Result<Product, Failure> {
    if stage.makes.contains(&Role::Levels) {
        return levels(task, stage, tools);
    }
    if stage.makes.contains(&Role::Paths) {
        return statistics::reduce(task, stage, tools);
    }
    if stage.makes.contains(&Role::LayerPixels) {
        return layers::reduce(task, stage, tools);
    }
    task.enter(Phase::Working);
    let watch = Stopwatch::start();
    let span = tiles(task, stage, Role::Tile)?;
    let frame = union(task, span.clone(), tools)?;
    let tiles = span.start as usize..span.end as usize;
    let piece = tools.install(task, || Piece::of(&frame, tiles.clone())).map_err(unfit)?;
    let mut product = Product::default();
    product.put(stage, Role::Pixels, || tools.install(task, || piece.encode()));
    if stage.makes.contains(&Role::Errors) {
        let errors = tools.install(task, || Errors::of(&frame, tiles)).map_err(unfit)?;
        product.put(stage, Role::Errors, || errors.encode());
    }
    if task.assignment.work.more == More::Rounds {
        product.put(stage, Role::Sums, || tools.install(task, || sums::encode(&frame)));
    }
    tracing::debug!(tiles = span.len(), bad = piece.bad().total(), seconds = watch.seconds(), "united");
    product.result.seconds = watch.seconds();
    Ok(product)
}
