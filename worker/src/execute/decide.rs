//! The decision task: measures the errors of a frame's tiles and decides how many samples each tile gets in the next round.
//!
//! The decision depends only on the tiles and the job's settings, by the rule of `femc_pipeline`, unless the user has set a time
//! limit.

use femc_film::{Errors, FrameError, Stops, TileErrors};
use femc_model::{Blocks, Decision, Failure, More, Phase, Role, Round, Template};
use femc_pipeline::{RoundVerdict, Settings};

use super::union::{groups, stops};
use super::{Product, Tools, unfit};
use crate::clock::Stopwatch;
use crate::table::Task;

pub(crate) fn decide(task: &Task, stage: &Template, tools: &Tools) -> Result<Product, Failure> {
    task.enter(Phase::Working);
    let watch = Stopwatch::start();
    if stage.closes.is_none() {
        return Err(unfit("invalid job graph: a decide stage closes no loop"));
    }
    let settings: Settings = serde_json::from_str(&task.spec.settings).map_err(unfit)?;
    let mut tiles: Vec<TileErrors> = Vec::new();
    let account = |errors: &Errors| (errors.tiling(), errors.tiles(), errors.samples().collect());
    groups(task, Role::Errors, tools, Errors::decode, account, |errors| {
        tiles.extend(errors.into_tiles());
        Ok(())
    })?;
    let error = FrameError::of(tiles.iter().flat_map(|tile| &tile.blocks).map(|it| it.block).collect());
    let before: Option<Stops> = stops(task, tools)?;
    let seconds = task.assignment.work.elapsed as f64 / 1000.0;
    let (verdict, stops) = settings.verdict(&tiles, before, seconds, planned(task));
    let decision = match verdict {
        RoundVerdict::Continue => Decision::Continue,
        RoundVerdict::Steps(steps) => Decision::Steps(steps),
        RoundVerdict::Done => Decision::Done,
    };
    let bad = tiles.iter().map(|tile| tile.bad).sum::<u64>();
    tracing::debug!(worst = error.worst, mean = error.mean, unlit = error.unlit, bad, ?decision, "measured the frame");
    let mut product = Product::default();
    let number = task.assignment.task.stage.number;
    let mut readers = task.spec.graph.readers(number).filter(|(_, need)| need.role == Role::Stops);
    if decision != Decision::Done || readers.any(|(_, need)| need.round != Round::Before) {
        product.put(stage, Role::Stops, || stops.encode());
    }
    product.result.decision = Some(decision);
    product.result.relative_error = error.reached();
    product.result.blocks = Some(Blocks { all: error.blocks.len() as u32, unlit: error.unlit as u32 });
    product.result.seconds = watch.seconds();
    Ok(product)
}

/// Returns the planned samples per pixel at the end of the next round, if another round may follow.
fn planned(task: &Task) -> Option<u32> {
    let next = task.assignment.task.stage.round as usize + 1;
    task.spec.rounds().get(next).copied().filter(|_| task.assignment.work.more == More::Rounds)
}
