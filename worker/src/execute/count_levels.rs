//! The count-levels task: counts the luminance levels of a group of tiles, for the exposure of a clip.

use femc_film::{Frame, LuminanceLevels, SampleRange, Tile};
use femc_model::{Failure, Phase, Role, StageTemplate};

use super::inputs::{expected_samples, for_each_input, tile_span, tiling};
use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn count_levels(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    let levels = LuminanceLevels::from_thumbnails(&thumbnails(task, stage, tools)?);
    tracing::debug!(blocks = levels.blocks(), seconds = watch.seconds(), "counted");
    Ok(Product::of_one(stage, Role::Levels, levels.encode(), &watch))
}

/// Combines the thumbnails of a group of tiles. Checks that each tile holds exactly the samples that it was given.
fn thumbnails(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Frame, Failure> {
    let span = tile_span(task, stage, Role::Thumbnail)?;
    let small = tiling(task)?.thumbnail_tiling();
    let small =
        small.ok_or_else(|| settings_failure("the tile width of the job is not a multiple of the block size"))?;
    let mut frame = Frame::new(small);
    for_each_input(task, Role::Thumbnail, tools, |bytes| frame.insert(Tile::decode_thumbnail(bytes)?).map(drop))?;
    let mut places = (span.start as usize..span.end as usize).enumerate();
    match places.find(|&(place, index)| SampleRange::join(frame.ranges(index)) != Some(expected_samples(task, place))) {
        None => Ok(frame),
        Some((_, index)) => {
            let message = format!("thumbnail {index} has wrong samples: {:?}", frame.ranges(index));
            Err(Failure::Panicked { message })
        }
    }
}
