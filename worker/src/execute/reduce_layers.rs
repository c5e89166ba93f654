//! The reduce-layers task: unites and resolves the layers and features of a group of tiles, once it is known which samples count.

use std::collections::BTreeMap;

use femc_film::tile::NONE_HELD;
use femc_film::{AovPiece, AovTile};
use femc_model::{Failure, Phase, Role, StageTemplate};

use super::inputs::{LostInputs, expected_samples, previous_stops, tile_span, tiling};
use super::{Product, Tools};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn reduce_layers(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    let (tiling, stops) = (tiling(task)?, previous_stops(task, tools)?);
    let begin = stops.as_ref().map_or(0, |stops| stops.progress.first_sample);
    let span = tile_span(task, stage, Role::Layers)?;
    // Parts of each tile.
    let mut inputs: BTreeMap<u32, Vec<_>> = span.clone().map(|tile| (tile, Vec::new())).collect();
    for input in task.assignment.spec.inputs_of_role(Role::Layers) {
        inputs.entry(input.item).or_default().push(input.output.artifact);
    }
    let (mut lost, mut piece) = (LostInputs::default(), AovPiece::new(tiling, span.start as usize));
    for (place, (tile, artifacts)) in inputs.iter().enumerate() {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let ends = stops.as_ref().and_then(|stops| stops.ends.get(*tile as usize)).copied().unwrap_or(NONE_HELD);
        let mut parts = Vec::with_capacity(artifacts.len());
        let here = lost.fetch(task, artifacts, tools)?;
        tools.install(task, || {
            for (artifact, bytes) in &here {
                lost.check(*artifact, AovTile::decode(bytes).map(|part| parts.push(part)));
            }
        });
        if parts.len() < artifacts.len() {
            continue;
        }
        // A tile with missing parts or with wrong samples is rendered again.
        let given = expected_samples(task, place).end;
        let united = AovTile::from_parts(parts, begin, ends).map_err(|error| error.to_string()).and_then(|all| {
            let samples = all.samples();
            if samples.is_some_and(|samples| (samples.start, samples.end) == (begin, given)) {
                piece.put(&all, ends).map_err(|error| error.to_string())
            } else {
                Err(format!("tile {tile} has layers of samples {samples:?}, expected {begin}..{given}"))
            }
        });
        if let Err(message) = united {
            if artifacts.is_empty() {
                return Err(Failure::Panicked { message });
            }
            artifacts.iter().for_each(|artifact| lost.check(*artifact, Err(&message)));
        }
    }
    lost.finish()?;
    let mut product = Product::default();
    product.put(stage, Role::LayerPixels, || tools.install(task, || piece.encode()));
    tracing::debug!(tiles = span.len(), seconds = watch.seconds(), "combined the layers");
    product.result.seconds = watch.seconds();
    Ok(product)
}
