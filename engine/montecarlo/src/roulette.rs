//! Russian roulette.

use crate::dimensions as dim;
use crate::path_state::PathState;
use crate::record::{PathEnd, Termination};
use crate::square;
use femc_math::Rgb;
use std::ops::ControlFlow;

/// Number of rays after which Russian roulette may end a path.
pub(crate) const RR_MIN_RAYS: u32 = 4;
/// Threshold of Russian roulette in a scene without media. A path survives with certainty while its weight is at least this. A
/// threshold of 1 would end paths earlier: on Cornell boxes that costs a quarter more variance and saves 15 % of the work.
pub(crate) const RR_THRESHOLD: f32 = 0.25;
/// Threshold of Russian roulette in a scene with media. There, later vertices of a path cost more (each also has a segment of fog)
/// and contribute less.
const RR_THRESHOLD_IN_MEDIA: f32 = 0.8;
/// Number of rays after which a path may end even without loss of throughput.
pub(crate) const LONG_PATH: u32 = 128;
/// Number of rays after which a long path ends with a higher probability.
const VERY_LONG_PATH: u32 = 1 << 16;

/// Rule by which Russian roulette ends paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RouletteRule {
    /// By the weight of the path. Long paths end, too.
    ByWeight,
    /// Only long paths end, because a weight window has decided on the others.
    LongPaths,
}

impl PathState {
    /// Performs Russian roulette, and ends paths with a throughput of 0.
    ///
    /// The survival probability is the remaining weight over the threshold. Where little is absorbed, a path of many segments keeps
    /// its weight. Weights that grew with every segment would have infinite variance. A long path ends all the same: its
    /// probability to have `n` rays is `LONG_PATH / n`, so that weights grow no faster than paths, and the square of that over
    /// `VERY_LONG_PATH`, so that the mean length is bounded in endless fog that absorbs nothing.
    ///
    #[inline(always)]
    pub fn roulette<const MEDIA: bool>(&mut self, rule: RouletteRule) -> ControlFlow<Termination> {
        if self.survives::<MEDIA>(rule) {
            return ControlFlow::Continue(());
        }
        let is_left = self.throughput.max_element() > 0.0;
        ControlFlow::Break(self.end(if is_left { PathEnd::Roulette } else { PathEnd::Absorbed }))
    }

    /// Performs Russian roulette as [`Self::roulette`] does, and returns whether the path continues.
    #[inline]
    fn survives<const MEDIA: bool>(&mut self, rule: RouletteRule) -> bool {
        let most = self.throughput.max_element();
        if !self.throughput.is_finite() || most <= 0.0 {
            return false;
        }
        let Some(q) = survival_probability::<MEDIA>(self.rays, most * self.roulette_scale, rule) else {
            return true;
        };
        if q >= 1.0 {
            return true;
        }
        self.stream.seek(self.base + dim::ROULETTE);
        let Some(throughput) = survivor_throughput(self.throughput, q, self.stream.next_1d()) else { return false };
        self.throughput = throughput;
        true
    }
}

/// Returns the throughput of a path that survives with probability `q`; `None`: it ends. `u` is in [0, 1).
#[inline(always)]
pub(crate) fn survivor_throughput(throughput: Rgb, q: f32, u: f32) -> Option<Rgb> {
    // A probability that is NaN must reach the film as a bad sample.
    if u >= q { None } else { Some(throughput / q) }
}

/// Returns the survival probability of a path. `None`: the path is too short for roulette.
/// - `weight`: weight of the path without the changes by guides and refraction.
#[inline(always)]
fn survival_probability<const MEDIA: bool>(rays: u32, weight: f32, rule: RouletteRule) -> Option<f32> {
    if rays < RR_MIN_RAYS {
        return None;
    }
    let threshold = if MEDIA { RR_THRESHOLD_IN_MEDIA } else { RR_THRESHOLD };
    let mut q = match rule {
        RouletteRule::ByWeight => (weight / threshold).min(1.0),
        RouletteRule::LongPaths => 1.0,
    };
    if rays > LONG_PATH {
        let long_survival = (rays - 1) as f32 / rays as f32;
        q *= if rays > VERY_LONG_PATH { square(long_survival) } else { long_survival };
    }
    Some(q)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RAYS: [u32; 10] = [1, 3, 4, 5, 100, 128, 129, 1000, 65_536, 65_537];
    const WEIGHTS: [f32; 7] = [0.02, 0.1, 0.2, 0.25, 0.5, 0.8, 3.0];

    fn probability(has_media: bool, rays: u32, weight: f32, rule: RouletteRule) -> Option<f32> {
        if has_media {
            survival_probability::<true>(rays, weight, rule)
        } else {
            survival_probability::<false>(rays, weight, rule)
        }
    }

    /// Brute force over the random number: the mean throughput after the roulette is the throughput before.
    #[test]
    fn mean_throughput_is_unchanged() {
        const N: u32 = 1 << 14;
        let before = Rgb::new(0.3, 0.02, 0.9);
        for has_media in [false, true] {
            for (rays, weight) in RAYS.into_iter().flat_map(|rays| WEIGHTS.map(|weight| (rays, weight))) {
                for rule in [RouletteRule::ByWeight, RouletteRule::LongPaths] {
                    let Some(q) = probability(has_media, rays, weight, rule) else { continue };
                    let after = |k: u32| survivor_throughput(before, q, (k as f32 + 0.5) / N as f32);
                    let sum: f64 = (0..N).filter_map(after).map(|after| f64::from(after.y)).sum();
                    let ratio = sum / f64::from(N) / f64::from(before.y);
                    // The number of survivors is q N, rounded.
                    let tolerance = 0.5 / f64::from(q * N as f32) + 1e-6;
                    assert!((ratio - 1.0).abs() < tolerance, "{rays} {weight} {rule:?}: {ratio}");
                }
            }
        }
    }

    #[test]
    fn short_paths_survive_and_heavy_ones_until_they_are_long() {
        for has_media in [false, true] {
            assert_eq!(probability(has_media, RR_MIN_RAYS - 1, 1e-9, RouletteRule::ByWeight), None);
            for rays in RR_MIN_RAYS..=LONG_PATH {
                assert_eq!(probability(has_media, rays, 1.0, RouletteRule::ByWeight), Some(1.0));
                assert_eq!(probability(has_media, rays, 1e-9, RouletteRule::LongPaths), Some(1.0));
            }
        }
        assert_eq!(probability(false, 4, 0.5 * RR_THRESHOLD, RouletteRule::ByWeight), Some(0.5));
        assert_eq!(probability(true, 4, 0.5 * RR_THRESHOLD_IN_MEDIA, RouletteRule::ByWeight), Some(0.5));
    }

    /// The probability of having `n` rays is `LONG_PATH / n`, and falls with the square after `VERY_LONG_PATH`.
    #[test]
    fn long_paths_without_loss_end_as_documented() {
        for rule in [RouletteRule::ByWeight, RouletteRule::LongPaths] {
            let survival = |rays| probability(true, rays, 1.0, rule);
            let reach = |n: u32| (2..=n).filter_map(survival).map(f64::from).product::<f64>();
            for n in [LONG_PATH, 2 * LONG_PATH, 1000, VERY_LONG_PATH] {
                let expected = f64::from(LONG_PATH) / f64::from(n);
                assert!((reach(n) / expected - 1.0).abs() < 1e-3, "{n}: {} for {expected}", reach(n));
            }
            let (once, twice) = (reach(VERY_LONG_PATH), reach(2 * VERY_LONG_PATH));
            assert!((twice / once - 0.25).abs() < 1e-2, "{}", twice / once);
        }
    }
}
