//! The decision task: measures the errors of a frame's tiles and decides how many samples each tile gets in the next round.
//!
//! The decision depends only on the tiles and the job's settings, by the rule of `femc_pipeline`, unless the user has set a time
//! limit.

use femc_film::{ErrorStatistics, FrameError, SamplingState, TileErrors};
use femc_model::{BlockCounts, Decision, Failure, NextRound, Phase, Role, Round, StageTemplate};
use femc_pipeline::{RoundVerdict, Settings};

use super::inputs::{previous_stops, read_groups};
use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(crate) fn decide(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    if stage.closes.is_none() {
        return Err(settings_failure("invalid job graph: a decide stage closes no loop"));
    }
    let settings: Settings = serde_json::from_str(&task.spec.settings).map_err(settings_failure)?;
    let mut tiles: Vec<TileErrors> = Vec::new();
    let account = |errors: &ErrorStatistics| (errors.tiling(), errors.tiles(), errors.samples().collect());
    read_groups(task, Role::Errors, tools, ErrorStatistics::decode, account, |errors| {
        tiles.extend(errors.into_tiles());
        Ok(())
    })?;
    let error = FrameError::from_blocks(tiles.iter().flat_map(|tile| &tile.blocks).map(|it| it.block).collect());
    let before: Option<SamplingState> = previous_stops(task, tools)?;
    let seconds = task.assignment.spec.elapsed as f64 / 1000.0;
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
    if decision != Decision::Done || readers.any(|(_, need)| need.round != Round::Previous) {
        product.put(stage, Role::Stops, || stops.encode());
    }
    product.result.decision = Some(decision);
    product.result.relative_error = error.reached_error();
    product.result.blocks = Some(BlockCounts { all: error.blocks.len() as u32, unlit: error.unlit as u32 });
    product.result.seconds = watch.seconds();
    Ok(product)
}

/// Returns the planned samples per pixel at the end of the next round, if another round may follow.
fn planned(task: &Task) -> Option<u32> {
    let next = task.assignment.task.stage.round as usize + 1;
    task.spec.rounds().get(next).copied().filter(|_| task.assignment.spec.next_round == NextRound::Possible)
}
