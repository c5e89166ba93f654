//! Estimate of the samples that a frame needs, from a render of the frame at a few pixels with the rule of the whole frame.
//!
//! A block of 16 x 16 pixels of a smaller film covers more of the scene, at about the noise of a block of the large one. The mean
//! of the samples that its blocks need is about that of the frame's. It is an estimate, not a bound.

use crate::in_process::render_rounds;
use crate::outputs::Outputs;
use crate::render::{RenderError, RenderTask};
use crate::round::RoundVerdict;
use crate::settings::{Settings, StopCondition};
use femc_film::{TileErrors, Tiling};
use femc_prepared::Prepared;

/// Approximate number of pixels of a pilot: 15 blocks.
pub(crate) const PIXELS: f64 = 3840.0;
/// Edge of a block and of a tile, pixels.
const EDGE: u32 = 16;

/// Returns the film of a pilot for a film of this size, pixels.
pub fn film_size(size: [u32; 2]) -> [u32; 2] {
    scaled_film_size(size, PIXELS)
}

/// Returns a film of the same shape with about `pixels` pixels.
pub(crate) fn scaled_film_size([width, height]: [u32; 2], pixels: f64) -> [u32; 2] {
    let scale = (pixels / (f64::from(width) * f64::from(height))).sqrt().min(1.0);
    [width, height].map(|edge| ((f64::from(edge) * scale).round() as u32).clamp(1, edge.max(1)))
}

/// Estimates the mean number of samples a pixel that tiles need for [`StopCondition::Error`]. `None` for other stops.
/// - `prepared`: frame of `settings` at the size [`film_size`];
/// - `should_stop`: polled after each round. If it ends early, the missing samples are extrapolated: errors fall with the root of
///   the samples.
/// - errors: the film is invalid.
pub fn estimate_samples(
    prepared: &Prepared,
    settings: &Settings,
    should_stop: impl Fn() -> bool,
) -> Result<Option<f64>, RenderError> {
    let StopCondition::Error(most) = settings.stop else { return Ok(None) };
    let [width, height] = prepared.camera.film;
    let tiling = Tiling::new(width, height, EDGE)?;
    let rounds = settings.rounds();
    let last = rounds.last().copied().unwrap_or(1);
    let draw = |rect, samples| -> Result<_, RenderError> {
        Ok(RenderTask::new(prepared, settings, rect, samples).render(Outputs::default())?.tile)
    };
    let mut likely = 0.0;
    render_rounds(tiling, &rounds, draw, |end| {
        let (verdict, stops) = settings.verdict(end.tiles, end.before, 0.0, end.next);
        let needs = |(tile, ends): (&TileErrors, &[u32; 2])| {
            let drawn = f64::from(tile.samples.end);
            if ends.iter().all(|&end| end <= tile.samples.end) {
                return drawn;
            }
            let worst = (0..ends.len()).map(|half| tile.worst_error(half, stops.floors[half], 2.0 * most));
            let error = worst.filter(|error| error.is_finite()).fold(most, f64::max);
            (drawn * (error / most).powi(2)).clamp(drawn, f64::from(last))
        };
        let areas = tiling.rects().map(|rect| rect.area() as f64);
        let sum: f64 = end.tiles.iter().zip(&stops.ends).map(needs).zip(areas).map(|(n, area)| n * area).sum();
        likely = sum / (f64::from(width) * f64::from(height));
        (if should_stop() { RoundVerdict::Done } else { verdict }, stops)
    })?;
    Ok(Some(likely))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pilot_is_small_and_of_the_film_s_shape() {
        assert_eq!(film_size([1920, 1080]), [83, 46]);
        assert_eq!(film_size([40, 30]), [40, 30]);
        assert_eq!(film_size([1, 1]), [1, 1]);
    }
}
