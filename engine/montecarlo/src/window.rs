//! Weight window: Russian roulette and splitting of paths by the light that a field expects of them.
//!
//! The light that a path still adds to its sample is its throughput times the radiance that its latest vertex scatters. A field
//! estimates this radiance. The window compares it with the light that the field expected at the first vertex (\[vorba2016\]), by
//! the root mean square over the channels, so that no channel of a colored surface becomes noisier than the others. A
//! path below the window survives with a probability. A path above it is split into copies of less weight. The field decides only
//! how many copies continue, so the mean is correct for any field.

use crate::dimensions as dim;
use crate::first_hit::first_surfaces_on_grid;
use crate::guided::SurfaceGuide;
use crate::path_state::PathState;
use crate::roulette::{RouletteRule, survivor_throughput};
use femc_field::{Field, TargetGuide};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_prepared::Prepared;
use femc_scattering::Bsdf;

/// Bounds of the light expected of a path, relative to the light expected at its first vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightWindow {
    /// Lower bound. Below it, paths survive with a probability proportional to their light. 0: Russian roulette
    /// by weight instead.
    pub lower: f32,
    /// Upper bound. Above it, paths are split. Infinite: no splitting.
    pub upper: f32,
}

impl Default for WeightWindow {
    /// A compromise, measured with earlier guides: lower bounds of 0.25 and 0.6, and an upper bound of 3, changed variance times
    /// seconds by at most 7 % in boxes. In a room that is lit through a gap, a lower bound of 0.6 gained 19 % more
    /// (`two_passes --methods pt,femc,0.6:1.5`).
    fn default() -> Self {
        Self { lower: 0.4, upper: 1.5 }
    }
}

impl WeightWindow {
    /// A window that ends and splits no path.
    pub const OPEN: Self = Self { lower: 0.0, upper: f32::INFINITY };
}

/// Minimum survival probability by the window, because the field may be wrong.
const MIN_SURVIVAL: f32 = 0.2;
/// Maximum number of copies of a path at a vertex.
const MAX_COPIES: u32 = 8;
/// Maximum number of branches of a sample, all copies together. Then its paths are not split any more.
pub(crate) const MAX_BRANCHES: u32 = 64;
/// Share of the frame's mean light that is added to the light expected at the first vertex. Otherwise, paths from dark places
/// would be split at every bright one.
pub const FRAME_SHARE: f32 = 0.02;
/// Number of camera rays by axis for the mean of the frame.
const FRAME_RAYS: u32 = 16;

/// Decision of the window at a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum WindowDecision {
    /// The field has no data, or the window has no lower bound. Russian roulette by weight applies.
    Unknown,
    /// The path survives with this probability, in (0, 1).
    Roulette(f32),
    /// The path continues as this number of copies, at least 1.
    Copies(u32),
}

impl WindowDecision {
    /// Returns the rule of Russian roulette after the decision.
    #[inline(always)]
    pub fn roulette_rule(self) -> RouletteRule {
        match self {
            Self::Unknown => RouletteRule::ByWeight,
            Self::Roulette(_) | Self::Copies(_) => RouletteRule::LongPaths,
        }
    }
}

impl WeightWindow {
    /// Decides on a path at its latest vertex.
    /// - `radiance`: radiance that the vertex scatters toward the previous vertex by the field, cd/m2;
    /// - `frame_light`: value of [`frame_light`].
    #[inline(always)]
    pub(crate) fn decide(&self, path: &mut PathState, radiance: Rgb, frame_light: f32) -> WindowDecision {
        let ahead = path.throughput * radiance;
        if !(ahead.max_element() > 0.0 && ahead.is_finite()) {
            return WindowDecision::Unknown;
        }
        if path.expected_light == Rgb::ZERO {
            path.expected_light = ahead + Rgb::splat(FRAME_SHARE * frame_light);
            return self.inside();
        }
        // A channel without light in the center has none in the sample, unless the field is wrong.
        let ratio = ahead / path.expected_light.max(Rgb::splat(f32::MIN_POSITIVE));
        self.decide_by_ratio((ratio.length_squared() * (1.0 / 3.0)).sqrt())
    }

    /// Returns the decision on a path in the window.
    #[inline(always)]
    fn inside(&self) -> WindowDecision {
        if self.lower > 0.0 { WindowDecision::Copies(1) } else { WindowDecision::Unknown }
    }

    /// Decides on a path.
    /// - `ratio`: its expected light, relative to that at the first vertex; positive.
    #[inline(always)]
    fn decide_by_ratio(&self, ratio: f32) -> WindowDecision {
        if ratio < self.lower {
            WindowDecision::Roulette((ratio / self.lower).max(MIN_SURVIVAL))
        } else if ratio > self.upper {
            WindowDecision::Copies(((ratio / self.upper).ceil() as u32).clamp(1, MAX_COPIES))
        } else {
            self.inside()
        }
    }
}

impl PathState {
    /// Performs the Russian roulette of the window, and returns whether the path survives.
    /// - `q`: survival probability.
    #[inline]
    pub(crate) fn survives_window(&mut self, q: f32) -> bool {
        self.stream.seek(self.base + dim::WINDOW);
        let survivor = survivor_throughput(self.throughput, q, self.stream.next_1d());
        self.throughput = survivor.unwrap_or(self.throughput);
        survivor.is_some()
    }
}

/// Returns the mean light that a field expects at the first surfaces of a frame, cd/m2.
pub(crate) fn frame_light(scene: &Prepared, field: &Field, targets: Option<&TargetGuide>) -> f32 {
    let lights = first_surfaces_on_grid(scene, [FRAME_RAYS; 2]).filter_map(|(_, surface)| {
        let light = luminance(SurfaceGuide::new(field, targets, &surface?).radiance);
        light.is_finite().then_some(light)
    });
    lights.sum::<f32>() / (FRAME_RAYS * FRAME_RAYS) as f32
}

/// Random numbers of a direction: a point in [0, 1)^2, and the choice of a lobe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DirectionNumbers {
    pub u: [f32; 2],
    pub choice: f32,
}

impl DirectionNumbers {
    /// Draws the numbers of the current ray's end. The choice is 0 if the BSDF has a single lobe.
    #[inline(always)]
    pub fn draw(path: &mut PathState, bsdf: &Bsdf) -> Self {
        path.stream.seek(path.base + dim::LOBE);
        let choice = if bsdf.has_choice() { path.stream.next_1d() } else { 0.0 };
        path.stream.seek(path.base + dim::DIRECTION);
        Self { u: path.stream.next_2d(), choice }
    }

    /// Returns the numbers of one of several copies, shifted by a point of a Hammersley set. The numbers of each copy are uniform, and
    /// the copies are evenly spread.
    pub fn of_copy(self, copy: u32, copies: u32) -> Self {
        let [across, along] = copy_shift(copy, copies);
        let [u, v] = self.u;
        Self { u: [wrapped(u + across), wrapped(v + along)], choice: wrapped(self.choice + along) }
    }
}

/// Returns the point of a Hammersley set by which the random numbers of a copy are shifted.
pub(crate) fn copy_shift(copy: u32, copies: u32) -> [f32; 2] {
    [copy as f32 / copies as f32, copy.reverse_bits() as f32 * (1.0 / 4_294_967_296.0)]
}

/// Returns the number of the random stream of a copy.
/// - `rays`: number of rays of the path so far.
#[inline(always)]
pub(crate) fn branch_number(rays: u32, copy: u32) -> u64 {
    u64::from(rays) << 32 | u64::from(copy)
}

/// Wraps a number in [0, 2) to [0, 1).
#[inline(always)]
fn wrapped(sum: f32) -> f32 {
    (if sum >= 1.0 { sum - 1.0 } else { sum }).min(1.0 - f32::EPSILON / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::SampleStream;

    const WINDOW: WeightWindow = WeightWindow { lower: 0.4, upper: 1.5 };

    /// Brute force over the random number: the mean number of paths times their weight is 1.
    #[test]
    fn the_mean_weight_is_unchanged() {
        const N: u32 = 1 << 12;
        for ratio in [1e-30, 1e-3, 0.02, 0.1, 0.3, 0.399, 0.4, 1.0, 1.5, 1.6, 3.0, 3.1, 11.9, 1e3, 1e30] {
            let weight = match WINDOW.decide_by_ratio(ratio) {
                WindowDecision::Unknown => panic!("{ratio}: no decision"),
                WindowDecision::Roulette(q) => {
                    assert!(ratio < WINDOW.lower && (MIN_SURVIVAL..1.0).contains(&q), "{ratio}: {q}");
                    let survivors = (0..N).filter(|k| (*k as f32 + 0.5) / (N as f32) < q).count();
                    survivors as f32 / N as f32 / q
                }
                WindowDecision::Copies(copies) => {
                    assert!(ratio >= WINDOW.lower && (1..=MAX_COPIES).contains(&copies), "{ratio}: {copies}");
                    // A copy is in the window, unless there are too many.
                    assert!(ratio / copies as f32 <= WINDOW.upper || copies == MAX_COPIES, "{ratio}: {copies}");
                    assert!(ratio / copies as f32 >= 0.5 * WINDOW.upper || copies == 1, "{ratio}: {copies}");
                    copies as f32 * (1.0 / copies as f32)
                }
            };
            assert!((weight - 1.0).abs() < 0.01, "{ratio}: {weight}");
        }
        assert!(
            [1e-30, 1.0, 1e30]
                .iter()
                .all(|ratio| WeightWindow::OPEN.decide_by_ratio(*ratio) == WindowDecision::Unknown)
        );
    }

    /// The first vertex with data is the center of the window. Vertices without data decide nothing.
    #[test]
    fn light_is_compared_with_the_first_vertex() {
        let scene = crate::test_scene::prepare("m a =\n sides 2\n rd .5\nm a\nv p =\n p 0 0 0\nsph p 1\n");
        let mut path = crate::test_scene::center_path(&scene, 1);
        let decide = |path: &mut PathState, light: f32| WINDOW.decide(path, Rgb::splat(light), 5.0);
        for unknown in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert_eq!(decide(&mut path, unknown), WindowDecision::Unknown);
        }
        assert_eq!(decide(&mut path, 0.9), WindowDecision::Copies(1));
        assert!((path.expected_light - Rgb::ONE).length() < 1e-6, "0.9 and a fiftieth of 5: {}", path.expected_light);
        assert_eq!(decide(&mut path, 1.0), WindowDecision::Copies(1));
        assert_eq!(decide(&mut path, 2.9), WindowDecision::Copies(2));
        path.throughput = Rgb::splat(0.1);
        let WindowDecision::Roulette(q) = decide(&mut path, 1.0) else { panic!("a path that may end") };
        assert!((q - 0.25).abs() < 1e-6, "{q}");
        assert_eq!(decide(&mut path, 0.0), WindowDecision::Unknown);
        // One channel of three counts by the root of a third.
        path.throughput = Rgb::new(0.3, 0.0, 0.0);
        let WindowDecision::Roulette(q) = decide(&mut path, 1.0) else { panic!("a path that may end") };
        assert!((q - 0.3 / 3f32.sqrt() / 0.4).abs() < 1e-5, "{q}");
    }

    /// The numbers of each copy are uniform. The copies lie in different parts of the square.
    #[test]
    fn numbers_of_copies_are_uniform_and_spread() {
        const N: u32 = 1 << 12;
        for copies in [2, 3, 8] {
            for copy in 0..copies {
                let mut counts = [[0u32; 8]; 3];
                for k in 0..N {
                    let drawn = SampleStream::new(1, 1, k, 0).next_2d();
                    let choice = SampleStream::new(2, 1, k, 0).next_1d();
                    let DirectionNumbers { u, choice } = DirectionNumbers { u: drawn, choice }.of_copy(copy, copies);
                    for (counts, number) in counts.iter_mut().zip([u[0], u[1], choice]) {
                        assert!((0.0..1.0).contains(&number));
                        counts[(number * 8.0) as usize] += 1;
                    }
                }
                let expected = f64::from(N) / 8.0;
                for counts in counts {
                    let chi: f64 = counts.iter().map(|n| (f64::from(*n) - expected).powi(2) / expected).sum();
                    assert!(chi < 32.0, "7 degrees of freedom, level 4e-5: {chi}");
                }
            }
            let numbers = DirectionNumbers { u: [0.9, 0.7], choice: 0.5 };
            let mut parts: Vec<u32> =
                (0..copies).map(|copy| (numbers.of_copy(copy, copies).u[0] * copies as f32) as u32).collect();
            parts.sort_unstable();
            assert!(parts.windows(2).all(|pair| pair[0] != pair[1]), "{parts:?}");
        }
        let last = 1.0 - f32::EPSILON / 2.0;
        let extreme = DirectionNumbers { u: [last; 2], choice: last };
        assert_eq!(extreme.of_copy(0, 8), extreme);
    }
}
