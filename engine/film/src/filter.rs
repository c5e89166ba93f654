//! Pixel filters, by filter importance sampling.
//!
//! A filter is a density over the offset from the pixel's center. Offsets are sampled in proportion to it, so each sample has
//! weight 1 and belongs to exactly one pixel (\[ernst2006\]). Tiles need no borders, and pixels stay independent. The price is that
//! a sample contributes to a single pixel. All four filters are non-negative and separable.

use femc_math::elementary::double;
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;

/// A pixel filter: the density of a sample's offset from its pixel's center.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Filter {
    /// Constant over the pixel: a pixel is the mean over its area. Radius 0.5.
    #[default]
    Box,
    /// `1 - |x|`, radius 1.
    Triangle,
    /// Gaussian of standard deviation 0.5, cut at radius 1.5 (3 standard deviations).
    Gaussian,
    /// Four-term Blackman-Harris window of radius 1.5 (\[harris1978\]).
    BlackmanHarris,
}

/// Cumulative mass between the center and each border of equally wide cells of the half axis, as a fraction of the mass of the half
/// axis.
type Table = [f32; CELLS + 1];
const CELLS: usize = 512;

impl Filter {
    /// All filters.
    pub const ALL: [Self; 4] = [Self::Box, Self::Triangle, Self::Gaussian, Self::BlackmanHarris];

    /// Returns the name on the command line and in settings.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Triangle => "triangle",
            Self::Gaussian => "gaussian",
            Self::BlackmanHarris => "blackman-harris",
        }
    }

    /// Returns the largest offset along an axis, pixels.
    pub const fn radius(self) -> f32 {
        match self {
            Self::Box => 0.5,
            Self::Triangle => 1.0,
            Self::Gaussian | Self::BlackmanHarris => 1.5,
        }
    }

    /// Returns the unnormalized density along one axis at offset `x` in pixels, for `|x|` up to the radius.
    pub fn eval(self, x: f64) -> f64 {
        match self {
            Self::Box => 1.0,
            Self::Triangle => 1.0 - x.abs(),
            Self::Gaussian => double::exp(-2.0 * x * x),
            Self::BlackmanHarris => {
                let a = std::f64::consts::PI * (x / f64::from(self.radius()) + 1.0);
                0.35875 - 0.48829 * double::cos(a) + 0.14128 * double::cos(2.0 * a) - 0.01168 * double::cos(3.0 * a)
            }
        }
    }

    /// Returns the offset (x, y) from the pixel's center, pixels, for a uniform point `u` of the unit square; weight 1.
    ///
    /// Law: offsets follow [`eval`](Self::eval) (test `offsets_follow_the_filter`). The map is monotone in each coordinate, so
    /// stratified points give stratified offsets. Gaussian and Blackman-Harris are treated as constant over each of 1024 equally
    /// wide cells.
    #[inline]
    pub fn sample(self, u: [f32; 2]) -> [f32; 2] {
        match self {
            Self::Box => u.map(|u| u - 0.5),
            Self::Triangle => u.map(|u| if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 * (1.0 - u)).sqrt() }),
            Self::Gaussian | Self::BlackmanHarris => lookup(self.table(), self.radius(), u),
        }
    }
}

impl Filter {
    /// Returns the density of [`sample`](Self::sample) at an offset from the pixel's center, 1/pixel2; 0 beyond the radius.
    ///
    /// Law: it integrates to 1 (test `the_density_is_that_of_the_offsets`).
    #[inline]
    pub fn density(self, offset: [f32; 2]) -> f32 {
        let radius = self.radius();
        let along = |table: &Table, x: f32| {
            let cell = ((x.abs() / radius * CELLS as f32) as usize).min(CELLS - 1);
            (table[cell + 1] - table[cell]) * (0.5 * CELLS as f32 / radius)
        };
        if offset.iter().any(|x| x.abs() > radius) {
            return 0.0;
        }
        let [x, y] = offset;
        match self {
            Self::Box => 1.0,
            Self::Triangle => (1.0 - x.abs()) * (1.0 - y.abs()),
            Self::Gaussian | Self::BlackmanHarris => along(self.table(), x) * along(self.table(), y),
        }
    }

    /// Returns the table of a filter that has one.
    fn table(self) -> &'static Table {
        static GAUSSIAN: OnceLock<Table> = OnceLock::new();
        static BLACKMAN_HARRIS: OnceLock<Table> = OnceLock::new();
        let table = if self == Self::Gaussian { &GAUSSIAN } else { &BLACKMAN_HARRIS };
        table.get_or_init(|| tabulate(self))
    }
}

impl std::fmt::Display for Filter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// An unknown filter name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown filter {0:?}; choose box, triangle, gaussian or blackman-harris")]
pub struct UnknownFilter(pub String);

impl std::str::FromStr for Filter {
    type Err = UnknownFilter;

    fn from_str(name: &str) -> Result<Self, UnknownFilter> {
        Self::ALL.into_iter().find(|f| f.name() == name).ok_or_else(|| UnknownFilter(name.into()))
    }
}

#[inline]
fn lookup(table: &Table, radius: f32, u: [f32; 2]) -> [f32; 2] {
    u.map(|u| {
        let v = 2.0 * u - 1.0;
        let mass = v.abs().min(1.0);
        // The cell whose mass ends at or above `mass`; the table starts at 0 and ends at 1.
        let cell = table[1..CELLS].partition_point(|&below| below < mass);
        let t = (mass - table[cell]) / (table[cell + 1] - table[cell]);
        let x = (cell as f32 + t.min(1.0)) * (radius / CELLS as f32);
        if v < 0.0 { -x } else { x }
    })
}

/// Integrates the right half of the filter by the midpoint rule with 64 points per cell; the left half is its mirror image.
fn tabulate(filter: Filter) -> Table {
    const POINTS: usize = 64;
    let width = f64::from(filter.radius()) / (CELLS * POINTS) as f64;
    let mut below = [0.0; CELLS + 1];
    for cell in 0..CELLS {
        let points = (0..POINTS).map(|i| filter.eval(((cell * POINTS + i) as f64 + 0.5) * width));
        below[cell + 1] = below[cell] + points.sum::<f64>();
    }
    below.map(|b| (b / below[CELLS]) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::SampleStream;
    use femc_stats::testing::{chi2::pooled_test, sidak};

    #[test]
    fn offsets_follow_the_filter() {
        let (n, cells) = (200_000u32, 60);
        let level = sidak(1e-3, 2 * Filter::ALL.len());
        for filter in Filter::ALL {
            let radius = f64::from(filter.radius());
            let mass: Vec<f64> = (0..cells)
                .map(|c| {
                    let at = |s: usize| ((c * 100 + s) as f64 + 0.5) / (cells * 100) as f64;
                    (0..100).map(|s| filter.eval((2.0 * at(s) - 1.0) * radius)).sum()
                })
                .collect();
            let total: f64 = mass.iter().sum();
            let expected: Vec<f64> = mass.iter().map(|m| m / total * f64::from(n)).collect();
            for axis in 0..2 {
                let mut observed = vec![0u64; cells];
                for i in 0..n {
                    // One point from each of many pixels, because the test needs independent points.
                    let d = f64::from(filter.sample(SampleStream::new(5, 0, i, 0).next_2d())[axis]);
                    assert!(d.abs() <= radius);
                    observed[(((d / radius + 1.0) / 2.0 * cells as f64) as usize).min(cells - 1)] += 1;
                }
                pooled_test(&expected, &observed).expect(level, filter.name());
            }
        }
    }

    #[test]
    fn the_density_is_that_of_the_offsets() {
        for filter in Filter::ALL {
            let (n, radius) = (600, filter.radius());
            let at = |i: u32| (2.0 * (i as f32 + 0.5) / n as f32 - 1.0) * radius;
            let cell = (2.0 * f64::from(radius) / f64::from(n)).powi(2);
            let all = (0..n * n).map(|i| f64::from(filter.density([at(i % n), at(i / n)])));
            assert!((all.sum::<f64>() * cell - 1.0).abs() < 1e-3, "{filter}");
            assert_eq!(filter.density([1.01 * radius, 0.0]), 0.0);
            let ratio = f64::from(filter.density([0.3, 0.1]) / filter.density([0.0; 2]));
            let expected = filter.eval(0.3) * filter.eval(0.1) / filter.eval(0.0).powi(2);
            assert!((ratio - expected).abs() < 0.01, "{filter}: {ratio} {expected}");
        }
    }

    #[test]
    fn box_covers_the_pixel_and_filters_are_symmetric_and_monotone() {
        assert_eq!(Filter::Box.sample([0.0, 0.75]), [-0.5, 0.25]);
        for filter in Filter::ALL {
            let mut last = -filter.radius();
            for i in 0..=4096 {
                let u = i as f32 / 4096.0;
                let [x, mirrored] = filter.sample([u, 1.0 - u]);
                assert!((x + mirrored).abs() < 1e-6 && x >= last, "{filter} at {u}");
                last = x;
            }
            assert_eq!(filter.sample([0.0, 0.5]), [-filter.radius(), 0.0]);
        }
    }

    #[test]
    fn names_parse_back_and_unknown_ones_are_refused() {
        for filter in Filter::ALL {
            assert_eq!(filter.name().parse(), Ok(filter));
        }
        assert!("mitchell".parse::<Filter>().unwrap_err().to_string().contains("blackman-harris"));
    }
}
