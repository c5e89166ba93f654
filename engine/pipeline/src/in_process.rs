//! Rendering of a frame in the caller's process, without a farm: round by round, with the farm's decision rules.

use crate::outputs::Outputs;
use crate::render::{RenderError, RenderTask};
use crate::round::RoundVerdict;
use crate::settings::Settings;
use femc_film::{ErrorStatistics, FilmError, Frame, Rect, SamplingState, Tile, TileErrors, Tiling};
use femc_prepared::Prepared;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// A frame and its work.
#[derive(Debug)]
pub struct RenderedFrame {
    /// Samples that count. Samples after the end of a tile are held.
    pub frame: Frame,
    /// Number of samples traced, over all pixels, whether they count or not.
    pub samples: u64,
    /// Number of rays traced for them.
    pub rays: u64,
}

/// State at the end of a round, from which the next step is decided.
#[derive(Debug)]
pub struct RoundEnd<'a> {
    /// Errors of all tiles, in order.
    pub tiles: &'a [TileErrors],
    /// State left by the decision before. `None`: this is the first one.
    pub before: Option<SamplingState>,
    /// Number of rays traced so far.
    pub rays: u64,
    /// Samples a pixel at the end of the next round. `None`: this was the last one.
    pub next: Option<u32>,
}

/// Renders a frame with its settings, on the calling thread's rayon pool.
/// - `tiling`, `rounds`: values of the frame's plan;
/// - `seconds`: returns the seconds since the frame's beginning from the rays traced so far, only for
///   [`StopCondition::Time`](crate::StopCondition::Time);
/// - `cancel`, `progress`: as in a [`RenderTask`].
/// - errors: cancelled, or the plan does not belong to these settings.
pub fn render_frame(
    prepared: &Prepared,
    settings: &Settings,
    tiling: Tiling,
    rounds: &[u32],
    seconds: impl Fn(u64) -> f64,
    cancel: &AtomicBool,
    progress: &AtomicU64,
) -> Result<RenderedFrame, RenderError> {
    let draw = |rect, samples| {
        let task = RenderTask { prepared, settings, rect, samples, cancel: Some(cancel), progress: Some(progress) };
        Ok(task.render(Outputs::default())?.tile)
    };
    render_rounds(tiling, rounds, draw, |end| settings.verdict(end.tiles, end.before, seconds(end.rays), end.next))
}

/// Draws a frame round by round, with a decision rule.
/// - `rounds`: samples a pixel at the end of each round;
/// - `draw`: renders samples of a tile, on many threads at once;
/// - `decide`: returns the verdict after a round.
/// - errors: those of `draw`, and tiles that do not belong to the frame or to its samples.
pub fn render_rounds<E: From<FilmError> + Send>(
    tiling: Tiling,
    rounds: &[u32],
    draw: impl Fn(Rect, Range<u32>) -> Result<Tile, E> + Sync,
    mut decide: impl FnMut(RoundEnd<'_>) -> (RoundVerdict, SamplingState),
) -> Result<RenderedFrame, E> {
    let mut frame = Frame::new(tiling);
    let mut ends = vec![rounds.first().copied().unwrap_or(0); tiling.count()];
    let (mut stops, mut begin) = (None::<SamplingState>, 0);
    let (mut samples, mut rays) = (0, 0);
    for round in 0..rounds.len() {
        if let Some(stops) = stops.as_ref().filter(|stops| stops.progress.first_sample > begin) {
            begin = stops.progress.first_sample;
            frame = Frame::new(tiling);
        }
        let mut work: Vec<(Rect, Range<u32>)> = Vec::new();
        for (index, (rect, &end)) in tiling.rects().zip(&ends).enumerate() {
            if let Some(stops) = &stops {
                frame.hold(index, stops.ends[index])?;
            }
            let start = frame.ranges(index).last().map_or(begin, |range| range.end);
            if start < end {
                work.push((rect, start..end));
            }
        }
        samples += work.iter().map(|(rect, samples)| rect.area() * u64::from(samples.end - samples.start)).sum::<u64>();
        let drawn: Vec<Result<Tile, E>> = work.into_par_iter().map(|(rect, samples)| draw(rect, samples)).collect();
        for tile in drawn {
            let tile = tile?;
            rays += tile.rays();
            frame.insert(tile)?;
        }
        let tiles = ErrorStatistics::from_frame(&frame, 0..tiling.count())?.into_tiles();
        let next = rounds.get(round + 1).copied();
        let (verdict, left) = decide(RoundEnd { tiles: &tiles, before: stops.take(), rays, next });
        stops = Some(left);
        match (verdict, next) {
            (RoundVerdict::Continue, Some(next)) => ends.fill(next),
            (RoundVerdict::Steps(steps), _) => ends = steps,
            _ => break,
        }
    }
    Ok(RenderedFrame { frame, samples, rays })
}
