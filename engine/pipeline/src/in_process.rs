//! A frame rendered in the caller's process, without a farm: round by round, by the rules that the farm's decisions follow.

use crate::render::{RenderError, render_tile};
use crate::round::RoundVerdict;
use crate::settings::Settings;
use femc_film::{Errors, FilmError, Frame, Rect, Stops, Tile, TileErrors, Tiling};
use femc_prepared::Prepared;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// A frame and the work it took.
#[derive(Debug)]
pub struct RenderedFrame {
    /// The samples that count, those after a tile's end held.
    pub frame: Frame,
    /// Samples that were drawn, of all pixels, whether they count or not.
    pub samples: u64,
    /// Rays traced for them.
    pub rays: u64,
}

/// The end of a round, at which it is decided what follows.
#[derive(Debug)]
pub struct RoundEnd<'a> {
    /// The errors of all tiles, in order.
    pub tiles: &'a [TileErrors],
    /// What the decision before left; `None`: this is the first one.
    pub before: Option<Stops>,
    /// Rays traced so far.
    pub rays: u64,
    /// Samples a pixel at the end of the next round; `None`: this was the last one.
    pub next: Option<u32>,
}

/// Renders a frame by its settings, on the calling thread's rayon pool.
/// - `tiling`, `rounds`: of the frame's plan;
/// - `seconds`: since the frame's beginning, from the rays traced so far, for [`Stop::Time`](crate::Stop::Time) alone;
/// - `cancel`, `progress`: as for [`render_tile`].
/// - errors: cancelled, or the plan is not of these settings.
pub fn render_frame(
    prepared: &Prepared,
    settings: &Settings,
    tiling: Tiling,
    rounds: &[u32],
    seconds: impl Fn(u64) -> f64,
    cancel: &AtomicBool,
    progress: &AtomicU64,
) -> Result<RenderedFrame, RenderError> {
    let draw = |rect, samples| Ok(render_tile(prepared, settings, rect, samples, cancel, progress)?.tile);
    by_rounds(tiling, rounds, draw, |end| settings.verdict(end.tiles, end.before, seconds(end.rays), end.next))
}

/// Draws a frame round by round, as a rule says.
/// - `rounds`: samples a pixel at the end of each round;
/// - `draw`: samples of a tile, on many threads at once;
/// - `decide`: what follows a round.
/// - errors: those of `draw`, and tiles that are not of the frame or of its samples.
pub fn by_rounds<E: From<FilmError> + Send>(
    tiling: Tiling,
    rounds: &[u32],
    draw: impl Fn(Rect, Range<u32>) -> Result<Tile, E> + Sync,
    mut decide: impl FnMut(RoundEnd<'_>) -> (RoundVerdict, Stops),
) -> Result<RenderedFrame, E> {
    let mut frame = Frame::new(tiling);
    let mut ends = vec![rounds.first().copied().unwrap_or(0); tiling.count()];
    let (mut stops, mut begin) = (None::<Stops>, 0);
    let (mut samples, mut rays) = (0, 0);
    for round in 0..rounds.len() {
        if let Some(stops) = stops.as_ref().filter(|stops| stops.pace.begin > begin) {
            begin = stops.pace.begin;
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
            rays += tile.work();
            frame.insert(tile)?;
        }
        let tiles = Errors::of(&frame, 0..tiling.count())?.into_tiles();
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
