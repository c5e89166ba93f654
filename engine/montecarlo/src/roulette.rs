//! Russian roulette.

use crate::dimensions as dim;
use crate::path_state::{PathEnd, PathState};
use crate::record::Termination;
use crate::square;
use std::ops::ControlFlow;

/// Number of rays after which Russian roulette may end a path.
const RR_MIN_RAYS: u32 = 4;
/// Threshold of Russian roulette in a scene without media. A path survives with certainty while its weight is at least this. A
/// threshold of 1 would end paths earlier: on Cornell boxes that costs a quarter more variance and saves 15 % of the work.
const RR_THRESHOLD: f32 = 0.25;
/// Threshold of Russian roulette in a scene with media. There, later vertices of a path cost more (each also has a segment of fog)
/// and contribute less.
const RR_THRESHOLD_IN_MEDIA: f32 = 0.8;
/// Minimum survival probability by the field's expectation, relative to the probability by the weight alone.
const RR_MIN_SURVIVAL: f32 = 0.5;
/// Number of rays after which a path may end even without loss of throughput.
const LONG_PATH: u32 = 128;
/// Number of rays after which a long path ends with a higher probability.
const VERY_LONG_PATH: u32 = 1 << 16;

impl PathState {
    /// Performs Russian roulette, and ends paths with a throughput of 0.
    ///
    /// The survival probability is the remaining weight over the threshold. Where little is absorbed, a path of many segments keeps
    /// its weight. Weights that grew with every segment would have infinite variance. A long path ends all the same: its
    /// probability to have `n` rays is `LONG_PATH / n`, so that weights grow no faster than paths, and the square of that over
    /// `VERY_LONG_PATH`, so that the mean length is bounded in endless fog that absorbs nothing.
    ///
    /// If a field knows the light that arrives at a vertex, this determines the probability (\[vorba2016\]). A path that a guide has
    /// sent toward much light has a small weight for that reason and is worth continuing. A path of great weight in the dark is
    /// not. The field may be wrong, so the survival probability is at least [`RR_MIN_SURVIVAL`] times that by the weight.
    /// - `survival`: light that the field expects of the path from here on, relative to that from the first vertex on.
    #[inline(always)]
    pub fn roulette<const MEDIA: bool>(&mut self, survival: Option<f32>) -> ControlFlow<PathEnd> {
        if self.survives::<MEDIA>(survival) {
            return ControlFlow::Continue(());
        }
        let is_left = self.throughput.max_element() > 0.0;
        ControlFlow::Break(self.end(if is_left { Termination::Roulette } else { Termination::Absorbed }))
    }

    /// Performs Russian roulette as [`Self::roulette`] does, and returns whether the path continues.
    #[inline]
    pub fn survives<const MEDIA: bool>(&mut self, survival: Option<f32>) -> bool {
        let most = self.throughput.max_element();
        if !self.throughput.is_finite() || most <= 0.0 {
            return false;
        }
        let Some(q) = survival_probability::<MEDIA>(self.rays, most * self.roulette_scale, survival) else {
            return true;
        };
        self.stream.seek(self.base + dim::ROULETTE);
        if self.stream.next_1d() >= q {
            return false;
        }
        self.throughput /= q;
        true
    }
}

/// Returns the survival probability of a path. `None`: the path is too short for roulette.
/// - `weight`: weight of the path without the changes by guides and refraction.
#[inline(always)]
fn survival_probability<const MEDIA: bool>(rays: u32, weight: f32, survival: Option<f32>) -> Option<f32> {
    if rays < RR_MIN_RAYS {
        return None;
    }
    let threshold = if MEDIA { RR_THRESHOLD_IN_MEDIA } else { RR_THRESHOLD };
    let mut q = (weight / threshold).min(1.0);
    if let Some(survival) = survival {
        q = survival.clamp(RR_MIN_SURVIVAL * q, 1.0);
    }
    if rays > LONG_PATH {
        let long_survival = (rays - 1) as f32 / rays as f32;
        q *= if rays > VERY_LONG_PATH { square(long_survival) } else { long_survival };
    }
    Some(q)
}
