//! Light statistics: combines the statistics that tiles have collected about the paths of their samples, and selects the samples
//! that count in the frame.

use femc_model::{Failure, Role};
use femc_pipeline::paths::{LightStatistics, PortionKey};

use super::inputs::{expected_samples, for_each_input, previous_stops, tiling};
use super::{Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

/// Combines all path statistics that the task reads.
pub(super) fn combine_statistics(task: &Task, tools: &Tools) -> Result<LightStatistics, Failure> {
    let mut all: Option<LightStatistics> = None;
    for_each_input(task, Role::Paths, tools, |bytes| {
        let part = LightStatistics::decode(bytes).map_err(|error| error.to_string())?;
        match &mut all {
            Some(all) => all.merge_untrimmed(part).map_err(|error| error.to_string()),
            None => {
                all = Some(part);
                Ok(())
            }
        }
    })?;
    let mut all =
        all.ok_or_else(|| settings_failure("invalid job graph: a stage that combines light statistics has no inputs"))?;
    all.trim();
    Ok(all)
}

/// Encodes the statistics of the samples that count in the frame. The bytes do not depend on which worker rendered what, or in
/// which parts.
pub(super) fn encode_frame_statistics(task: &Task, tools: &Tools) -> Result<Vec<u8>, Failure> {
    let watch = Stopwatch::start();
    let all = combine_statistics(task, tools)?;
    let stops = previous_stops(task, tools)?;
    let begin = stops.as_ref().map_or(0, |stops| stops.progress.first_sample);
    let end = |tile: u32, half: u8| {
        let stop = stops.as_ref().and_then(|stops| stops.ends.get(tile as usize));
        stop.map_or(u32::MAX, |ends| ends[usize::from(half)])
    };
    let counted = tools.install(task, || all.into_image_samples(begin, end));
    // Each tile must hold exactly the samples that it was given and that count.
    let wanted = (0..tiling(task)?.count() as u32).flat_map(|tile| {
        let given = expected_samples(task, tile as usize).end;
        [0, 1].map(|half| PortionKey { tile, half, begin, end: given.min(end(tile, half)) })
    });
    if !wanted.eq(counted.portions.keys().copied()) {
        let message = "the light statistics do not belong to the samples that count".to_owned();
        return Err(Failure::Panicked { message });
    }
    tracing::debug!(
        samples = counted.samples(),
        paths = counted.paths.len(),
        share = counted.share(),
        seconds = watch.seconds(),
        "combined the light statistics"
    );
    Ok(tools.install(task, || counted.encode()))
}
