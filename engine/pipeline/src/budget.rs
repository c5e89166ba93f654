//! Division of samples among tiles for a frame with a time limit, from the clock and the benefit of samples.
//!
//! Every tile gets 1 sample a pixel, then 4. These are a **pilot**, which determines how the other samples are divided. For a given
//! number of rays, the mean of the squared relative errors of the blocks is least if each tile has samples in proportion to its
//! relative standard deviation over the square root of the cost of a sample (\[neyman1934\]). Costs are counted in rays, so the
//! division is a function of the samples. The clock only determines the total number of samples, from the rays of the round before
//! and the seconds that they took.
//!
//! **The pilot does not count in the image.** A tile whose pilot missed a rare bright path gets fewer samples than it should. If
//! the pilot counted there, too, it would have a greater weight than in a tile that found such a path, and images would be too
//! dark. After the pilot no decision depends on samples: the number of each tile is a fixed share, times a number from the clock
//! for the whole frame. If the pilot is more than an eighth of the work that fits into the time, all tiles get equal numbers of
//! samples instead, and all of them count.

use crate::round::RoundVerdict;
use crate::settings::MAX_SPP;
use femc_film::sampling_state::TimedProgress;
use femc_film::{SamplingState, TileErrors};

/// Number of samples a pixel of the pilot.
pub(crate) const PILOT_SPP: u32 = 4;
/// Maximum share of the pilot in the work that fits into the time after it.
const PILOT_SHARE: f64 = 0.125;
/// Maximum share of the time at which the pilot may end. If it would end later, it is not traced.
const PILOT_END: f64 = 0.6;
/// Share of the remaining time for a round, if more than [`LAST_ROUND_SHARE`] of the time is left. The next round corrects its
/// clock.
const ROUND_SHARE: f64 = 0.7;
/// Remaining share of the time up to which a round uses all of it.
const LAST_ROUND_SHARE: f64 = 0.15;
/// Remaining share of the time up to which the frame is done.
const DONE_SHARE: f64 = 0.012;
/// Range of the samples of a tile, as shares of the mean. The limits exist because the pilot is a guess.
const SHARE_RANGE: std::ops::RangeInclusive<f64> = 0.25..=16.0;
/// Seconds per pixel of a round apart from its rays, for uniting the tiles and deciding. It is used until they are measured, and as
/// a maximum. The pilot is also slower because it is the first to load the scene.
const ROUND_SECONDS: f64 = 2.5e-6;

/// Returns the verdict after a round of a frame with a time limit of `seconds`.
/// - `elapsed`: seconds from the frame's first lease until now;
/// - `has_next_round`: whether another round may follow.
pub(crate) fn verdict(
    seconds: f64,
    tiles: &[TileErrors],
    state: &mut SamplingState,
    elapsed: f64,
    has_next_round: bool,
) -> RoundVerdict {
    let progress = &mut state.progress;
    let work: u64 = tiles.iter().map(|tile| tile.rays).sum();
    let max_spp = tiles.iter().map(|tile| tile.samples.end).max().unwrap_or(0);
    let now = RenderSpeed::estimate(progress, elapsed, work, tiles);
    // After a round its tiles are united. After the last one the image is made, which takes about as long.
    let left = seconds - elapsed - 2.0 * now.round;
    if !has_next_round || left <= DONE_SHARE * seconds {
        return RoundVerdict::Done;
    }
    let is_pilot = progress.shares.is_empty() && max_spp == PILOT_SPP;
    let before = std::mem::replace(progress, TimedProgress { seconds: elapsed, rays: work, ..progress.clone() });
    if is_pilot {
        progress.pilot = (elapsed - before.seconds, work - before.rays.min(work));
    }
    if progress.shares.is_empty() {
        let pilot_end = elapsed * f64::from(PILOT_SPP) / f64::from(max_spp.max(1));
        if max_spp < PILOT_SPP && pilot_end <= PILOT_END * seconds {
            return RoundVerdict::Steps(vec![PILOT_SPP; tiles.len()]);
        }
        let is_cheap = work as f64 <= PILOT_SHARE * now.rate * left;
        if is_pilot && is_cheap {
            (progress.first_sample, progress.rays, progress.shares) = (PILOT_SPP, 0, shares(tiles));
        } else {
            progress.shares = vec![1.0; tiles.len()];
        }
    }
    let part = if left > LAST_ROUND_SHARE * seconds { ROUND_SHARE } else { 1.0 };
    let steps = allocate_samples(part * left * now.rate, tiles, progress);
    let is_more = steps.iter().zip(tiles).any(|(&steps, tile)| steps > tile.samples.end);
    if is_more { RoundVerdict::Steps(steps) } else { RoundVerdict::Done }
}

/// Rendering speed of a frame.
struct RenderSpeed {
    /// Rays per second.
    rate: f64,
    /// Seconds of a round apart from its rays.
    round: f64,
}

impl RenderSpeed {
    /// Estimates the speed from the last round and the pilot's, which had fewer rays: seconds grow linearly with rays, from a fixed
    /// time per round.
    fn estimate(before: &TimedProgress, elapsed: f64, work: u64, tiles: &[TileErrors]) -> Self {
        let (seconds, rays) = ((elapsed - before.seconds).max(1e-3), work.saturating_sub(before.rays) as f64);
        let (short, few) = (before.pilot.0, before.pilot.1 as f64);
        let pixels: u64 = tiles.iter().flat_map(|tile| &tile.blocks).map(|it| it.block.rect.area()).sum();
        let most = pixels as f64 * ROUND_SECONDS;
        if few > 0.0 && rays > 2.0 * few {
            let round = ((short * rays - seconds * few) / (rays - few)).min(0.5 * seconds).clamp(0.0, most);
            return Self { rate: rays / (seconds - round), round };
        }
        // Unknown speed is assumed to be slow: a round that was too short is followed by another.
        Self { rate: rays / seconds, round: most }
    }
}

/// Returns the samples of each tile as shares of the mean tile's, from the pilot.
fn shares(tiles: &[TileErrors]) -> Vec<f64> {
    let [a, b] = SamplingState::after_first_round(tiles).floors;
    let found: Vec<Option<f64>> = tiles.iter().map(|tile| neyman_weight(tile, 0.5 * (a + b))).collect();
    let known = || found.iter().flatten();
    let mean = known().sum::<f64>() / known().count().max(1) as f64;
    // A tile without data gets the mean share.
    let share = |worth: Option<f64>| worth.map_or(1.0, |worth| worth / mean);
    found.into_iter().map(|worth| Some(share(worth)).filter(|it| it.is_finite()).unwrap_or(1.0)).map(clamp).collect()
}

fn clamp(share: f64) -> f64 {
    share.clamp(*SHARE_RANGE.start(), *SHARE_RANGE.end())
}

/// Returns the relative standard deviation of the blocks of a tile over the square root of the rays of a sample of a pixel. `None`:
/// the pilot found no light.
fn neyman_weight(tile: &TileErrors, floor: f64) -> Option<f64> {
    let (mut squares, mut pixels) = (0.0, 0.0);
    for block in tile.blocks.iter().map(|it| it.block) {
        let area = block.rect.area() as f64;
        let relative = block.variance.sqrt() / area / (block.sum / area).max(floor);
        // The variance of a block's mean falls with its area, and the weight is the area, so the result is the variance of a pixel.
        if relative.is_finite() {
            squares += relative * relative * area * area;
        }
        pixels += area;
    }
    let rays = tile.rays as f64 / pixels / f64::from(tile.samples.len().max(1));
    let worth = (squares / pixels / rays.max(1.0)).sqrt();
    (worth > 0.0).then_some(worth)
}

/// Returns the total samples a pixel of each tile, so that the additional ones cost `rays` rays and each tile has its share.
fn allocate_samples(rays: f64, tiles: &[TileErrors], progress: &TimedProgress) -> Vec<u32> {
    let begin = f64::from(progress.first_sample);
    let cost: Vec<f64> = tiles.iter().map(|it| it.rays as f64 / f64::from(it.samples.len().max(1))).collect();
    // After the pilot each tile has at least one sample that counts.
    let least = |tile: &TileErrors| {
        tile.samples.end.max(progress.first_sample + u32::from(progress.first_sample > 0)).min(MAX_SPP)
    };
    let ideal = |mean: f64, (share, tile): (&f64, &TileErrors)| {
        (begin + mean * share).clamp(f64::from(least(tile)), f64::from(MAX_SPP))
    };
    let all = || progress.shares.iter().zip(tiles);
    let rays_of = |mean: f64| -> f64 {
        all().zip(&cost).map(|(it, cost)| (ideal(mean, it) - f64::from(it.1.samples.end)) * cost).sum()
    };
    let (mut low, mut high) = (0.0, 1.0);
    while rays_of(high) < rays && high < f64::from(MAX_SPP) {
        (low, high) = (high, 2.0 * high);
    }
    for _ in 0..64 {
        let middle = 0.5 * (low + high);
        if rays_of(middle) < rays { low = middle } else { high = middle }
    }
    // Rounds to whole numbers with nearly the ideal sum: the fractional threshold of a tile follows the golden ratio sequence.
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let round = |(place, it): (usize, (&f64, &TileErrors))| {
        let steps = (ideal(low, it) + (place as f64 * golden).fract()).floor() as u32;
        steps.clamp(least(it.1), MAX_SPP)
    };
    all().enumerate().map(round).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Settings, StopCondition};
    use femc_film::tile::NONE_HELD;
    use femc_film::{Block, HalfBlock, Rect, TileBlock};

    /// A tile of one block of 256 pixels with luminance 1: variance of a pixel's sample, rays of a pixel's sample.
    #[derive(Clone, Copy)]
    struct TileModel {
        variance: f64,
        rays: f64,
    }

    /// A machine and the tiles that it renders.
    struct SimulatedMachine {
        tiles: Vec<TileModel>,
        /// Rays per second.
        rate: f64,
        /// Seconds until the first ray.
        before: f64,
        /// Seconds of a round apart from its rays, and of the image.
        round: f64,
    }

    struct SimulatedFrame {
        seconds: f64,
        /// Number of samples of each tile that count.
        counted: Vec<u32>,
        begin: u32,
        rounds: usize,
    }

    impl SimulatedMachine {
        fn errors(&self, samples: &[std::ops::Range<u32>]) -> Vec<TileErrors> {
            let tile = |(model, samples): (&TileModel, &std::ops::Range<u32>)| {
                let spp = f64::from(samples.end - samples.start);
                let rect = Rect { x: 0, y: 0, width: 16, height: 16 };
                let block = Block { rect, sum: 256.0, variance: 256.0 * model.variance / spp, freedom: 256.0 };
                let halves = [HalfBlock { sum: 256.0, bound: 2.0 * block.variance }; 2];
                let work = (256.0 * spp * model.rays) as u64;
                TileErrors {
                    samples: samples.clone().into(),
                    bad: 0,
                    rays: work,
                    ends: NONE_HELD,
                    blocks: vec![TileBlock { block, halves }],
                }
            };
            self.tiles.iter().zip(samples).map(tile).collect()
        }

        fn render(&self, seconds: f64) -> SimulatedFrame {
            let settings = Settings { stop: StopCondition::Time(seconds), ..Settings::default() };
            let rounds = settings.rounds();
            let cost = |spp: u32, model: &TileModel| 256.0 * f64::from(spp) * model.rays / self.rate;
            let mut samples = vec![0..rounds[0]; self.tiles.len()];
            let mut clock = self.before + self.tiles.iter().map(|model| cost(1, model)).sum::<f64>();
            let mut stops = None;
            for round in 0.. {
                clock += self.round;
                let planned = rounds.get(round + 1).copied();
                let (verdict, left) = settings.verdict(&self.errors(&samples), stops.take(), clock, planned);
                let RoundVerdict::Steps(steps) = verdict else {
                    let counted = samples.iter().map(|it| it.end - it.start).collect();
                    return SimulatedFrame {
                        seconds: clock + self.round,
                        counted,
                        begin: left.progress.first_sample,
                        rounds: round + 1,
                    };
                };
                for ((range, steps), model) in samples.iter_mut().zip(steps).zip(&self.tiles) {
                    assert!(steps >= range.end, "fewer samples than there are");
                    clock += cost(steps - range.end, model);
                    *range = left.progress.first_sample..steps;
                }
                stops = Some(left);
            }
            unreachable!("rounds have an end")
        }
    }

    fn mixed_tiles() -> Vec<TileModel> {
        (0..200).map(|i| TileModel { variance: 0.1 * f64::from(1 + i % 9), rays: f64::from(2 + i % 5) }).collect()
    }

    #[test]
    fn a_frame_takes_its_time_on_fast_machines_and_on_slow_ones() {
        for (rate, before, round) in [(1e6, 0.0, 0.0), (3e6, 0.4, 0.03), (2e5, 1.0, 0.1), (4e7, 0.05, 0.02)] {
            let world = SimulatedMachine { tiles: mixed_tiles(), rate, before, round };
            for seconds in [10.0, 60.0, 600.0] {
                let ended = world.render(seconds);
                let error = ended.seconds / seconds - 1.0;
                assert!((-0.02..0.02).contains(&error), "{seconds} s at {rate} rays/s: {error}");
                assert!(ended.rounds < 10, "{} rounds", ended.rounds);
            }
        }
    }

    #[test]
    fn tile_samples_follow_standard_deviation_over_root_of_cost() {
        let tiles =
            [(1.0, 4.0), (4.0, 4.0), (1.0, 16.0), (4.0, 1.0)].map(|(variance, rays)| TileModel { variance, rays });
        let world = SimulatedMachine { tiles: tiles.to_vec(), rate: 1e6, before: 0.0, round: 0.0 };
        let SimulatedFrame { counted, begin, .. } = world.render(60.0);
        assert_eq!(begin, PILOT_SPP, "the pilot does not count");
        let ratio = |tile: usize| f64::from(counted[tile]) / f64::from(counted[0]);
        for (tile, expected) in [(1, 2.0), (2, 0.5), (3, 4.0)] {
            assert!((ratio(tile) / expected - 1.0).abs() < 0.01, "tile {tile}: {} for {expected}", ratio(tile));
        }
    }

    #[test]
    fn costly_pilot_counts_fully_and_tiles_get_equal_samples() {
        let world = SimulatedMachine { tiles: mixed_tiles(), rate: 2e5, before: 0.0, round: 0.1 };
        // A sample of all pixels takes one second.
        for seconds in [10.0, 20.0, 32.0] {
            let SimulatedFrame { counted, begin, seconds: taken, .. } = world.render(seconds);
            let (least, most) = (counted.iter().min().unwrap(), counted.iter().max().unwrap());
            assert!(begin == 0 && most - least <= 1, "{seconds} s: {least} to {most} samples");
            assert!((taken / seconds - 1.0).abs() < 0.02, "{seconds} s: {taken}");
        }
        let SimulatedFrame { counted, .. } = world.render(0.1);
        assert_eq!(counted, vec![1; 200], "one sample at least");
    }

    #[test]
    fn tiles_dark_or_without_error_in_the_pilot_get_a_share() {
        let mut tiles = mixed_tiles();
        tiles[7].variance = 0.0;
        let ended = SimulatedMachine { tiles, rate: 1e7, before: 0.0, round: 0.0 }.render(30.0);
        let mean = ended.counted.iter().map(|n| f64::from(*n)).sum::<f64>() / 200.0;
        assert!(f64::from(ended.counted[7]) > 0.2 * mean, "{} of {mean}", ended.counted[7]);
    }
}
