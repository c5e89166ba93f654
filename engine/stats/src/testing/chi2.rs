//! Chi-square test of a sampler on the sphere against its density.
//!
//! The sphere is divided into cells of equal polar angle and azimuth about +z. Adaptive cubature integrates the density over each
//! cell, samples are counted per cell, and cells that expect fewer than five samples are pooled (\[cochran1952\]; the use on
//! directions follows \[subr2007\]). Draws without a result (`None`) have a cell of their own, whose mass is 1 minus the integral
//! of the density. A sampler that loses directions must therefore account for the loss in its density.
//!
//! The horizon of +z is a border of cells (an even number of polar rows), so densities that stop there are integrated well.

use super::gamma;
use std::f64::consts::{PI, TAU};

/// Expected count below which cells are pooled.
const MIN_EXPECTED_COUNT: f64 = 5.0;
/// Share of all samples that may fall where the density is zero (directions rounded over a border).
const MAX_STRAY_SHARE: f64 = 1e-5;
/// Mass of draws without a result that the cubature cannot tell from zero.
const NEGLIGIBLE: f64 = 1e-4;

/// Result of a chi-square test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chi2 {
    /// Sum of (observed - expected)^2 / expected over the pooled cells.
    pub statistic: f64,
    /// Degrees of freedom: pooled cells less one.
    pub dof: usize,
    /// Probability of a statistic this large or larger if the sampler is right. It is 0 when samples fell into cells of zero
    /// density, and NaN (which no level accepts) when a single pooled cell leaves nothing to test.
    pub p: f64,
    /// Integral of the density over the sphere: 1 for a sampler that never returns `None`.
    pub integral: f64,
    /// Number of samples that fell into cells of zero density.
    pub stray: u64,
}

impl Chi2 {
    /// Panics with the figures unless `p` is at least `level` and the density integrates to at most 1 (to 0.1 %).
    pub fn expect(&self, level: f64, label: &str) {
        assert!(self.p >= level, "{label}: samples do not follow the density at level {level:e}: {self:?}");
        assert!(self.integral <= 1.001, "{label}: the density integrates to more than 1: {self:?}");
    }
}

/// Resolution of the division of the sphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cells {
    /// Number of rows of equal polar angle; even, so that the horizon is a border.
    pub theta: usize,
    /// Number of columns of equal azimuth.
    pub phi: usize,
}

impl Default for Cells {
    fn default() -> Self {
        Self { theta: 20, phi: 40 }
    }
}

/// Tests `n` draws of `sample` against `pdf`.
/// - `pdf`: density of a unit direction, 1/sr (without delta parts).
/// - `sample`: draws number 0..n; a unit direction, or `None` for a draw without a result.
/// - a direction with a NaN makes `p` zero.
pub fn sphere_test(
    pdf: impl Fn([f64; 3]) -> f64,
    mut sample: impl FnMut(u64) -> Option<[f64; 3]>,
    cells: Cells,
    n: u64,
) -> Chi2 {
    let mass = integrate_cells(&pdf, cells);
    let integral: f64 = mass.iter().sum();
    let mut expected: Vec<f64> = mass.iter().map(|m| m * n as f64).collect();
    expected.push((1.0 - integral).max(0.0) * n as f64);
    let mut observed = vec![0u64; expected.len()];
    for i in 0..n {
        let cell = match sample(i) {
            None => expected.len() - 1,
            Some(d) if d.iter().all(|c| c.is_finite()) => cell_of(d, cells),
            Some(_) => return Chi2 { statistic: f64::NAN, dof: 0, p: 0.0, integral, stray: 0 },
        };
        observed[cell] += 1;
    }
    // Rounding errors of the cubature leave some mass for draws without a result: below 1e-4, none are expected.
    let missing = expected.len() - 1;
    if expected[missing] < NEGLIGIBLE * n as f64 {
        if observed[missing] as f64 > 2.0 * NEGLIGIBLE * n as f64 + 3.0 {
            return Chi2 { statistic: f64::INFINITY, dof: 0, p: 0.0, integral, stray: observed[missing] };
        }
        expected.truncate(missing);
        observed.truncate(missing);
    }
    Chi2 { integral, ..pooled_test(&expected, &observed) }
}

/// Tests counts against expected counts with chi-square and pooling; `integral` is the sum of `expected` over the number of
/// samples.
pub fn pooled_test(expected: &[f64], observed: &[u64]) -> Chi2 {
    assert_eq!(expected.len(), observed.len(), "the numbers of expected and observed counts differ");
    let total: u64 = observed.iter().sum();
    let integral = expected.iter().sum::<f64>() / total.max(1) as f64;
    let mut order: Vec<usize> = (0..expected.len()).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]).then(a.cmp(&b)));
    let stray: u64 = order.iter().filter(|&&i| expected[i] <= 0.0).map(|&i| observed[i]).sum();
    let (mut bins, mut pool) = (Vec::new(), (0.0, 0u64));
    for i in order.into_iter().filter(|&i| expected[i] > 0.0) {
        pool = (pool.0 + expected[i], pool.1 + observed[i]);
        if pool.0 >= MIN_EXPECTED_COUNT {
            bins.push(std::mem::take(&mut pool));
        }
    }
    match bins.last_mut() {
        Some(last) => *last = (last.0 + pool.0, last.1 + pool.1),
        None => bins.push(pool),
    }
    let statistic: f64 =
        bins.iter().map(|&(e, o)| if e > 0.0 { (o as f64 - e) * (o as f64 - e) / e } else { 0.0 }).sum();
    let dof = bins.len() - 1;
    let p = if stray as f64 > (MAX_STRAY_SHARE * total as f64).max(3.0) || !statistic.is_finite() {
        0.0
    } else if dof == 0 {
        f64::NAN
    } else {
        gamma::upper(dof as f64 / 2.0, statistic / 2.0)
    };
    Chi2 { statistic, dof, p, integral, stray }
}

fn cell_of(d: [f64; 3], cells: Cells) -> usize {
    let theta = libm::atan2(libm::hypot(d[0], d[1]), d[2]);
    let phi = libm::atan2(d[1], d[0]);
    let phi = if phi < 0.0 { phi + TAU } else { phi };
    let row = ((theta / PI * cells.theta as f64) as usize).min(cells.theta - 1);
    let column = ((phi / TAU * cells.phi as f64) as usize).min(cells.phi - 1);
    row * cells.phi + column
}

/// Integrates `pdf` over each cell, row by row.
fn integrate_cells(pdf: &impl Fn([f64; 3]) -> f64, cells: Cells) -> Vec<f64> {
    assert!(cells.theta.is_multiple_of(2) && cells.theta * cells.phi > 1, "the number of rows must be even");
    let density = |theta: f64, phi: f64| {
        let (sin, cos) = libm::sincos(theta);
        let (s, c) = libm::sincos(phi);
        pdf([sin * c, sin * s, cos]) * sin
    };
    let (dt, dp) = (PI / cells.theta as f64, TAU / cells.phi as f64);
    let mut mass = Vec::with_capacity(cells.theta * cells.phi);
    for row in 0..cells.theta {
        for column in 0..cells.phi {
            let area = Area { t: row as f64 * dt, p: column as f64 * dp, dt, dp };
            mass.push(adaptive(&density, area, gauss(&density, area), 1e-7, 9));
        }
    }
    mass
}

#[derive(Clone, Copy)]
struct Area {
    t: f64,
    p: f64,
    dt: f64,
    dp: f64,
}

/// Splits `area` in four until the sum of the parts agrees with the whole to 1e-5 of it or to `tolerance`.
fn adaptive(f: &impl Fn(f64, f64) -> f64, area: Area, whole: f64, tolerance: f64, depth: u32) -> f64 {
    let (dt, dp) = (area.dt / 2.0, area.dp / 2.0);
    let parts = [(0.0, 0.0), (dt, 0.0), (0.0, dp), (dt, dp)].map(|(t, p)| {
        let part = Area { t: area.t + t, p: area.p + p, dt, dp };
        (part, gauss(f, part))
    });
    let sum: f64 = parts.iter().map(|p| p.1).sum();
    if depth == 0 || (sum - whole).abs() <= (1e-5 * sum.abs()).max(tolerance) {
        return sum;
    }
    parts.into_iter().map(|(part, value)| adaptive(f, part, value, tolerance / 2.0, depth - 1)).sum()
}

/// Integrates with the tensor Gauss-Legendre rule of 4 x 4 points (\[dlmf\] 3.5.22).
fn gauss(f: &impl Fn(f64, f64) -> f64, area: Area) -> f64 {
    const NODES: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
        (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    ];
    let mut sum = 0.0;
    for (x, wx) in NODES {
        let t = area.t + area.dt * 0.5 * (1.0 + x);
        for (y, wy) in NODES {
            sum += wx * wy * f(t, area.p + area.dp * 0.5 * (1.0 + y));
        }
    }
    sum * area.dt * area.dp * 0.25
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEVEL: f64 = 1e-3;

    /// Returns two uniform numbers for draw `i` (SplitMix64).
    fn uniform(i: u64) -> [f64; 2] {
        let mut draw = [0.0; 2];
        for (k, u) in draw.iter_mut().enumerate() {
            let mut x = (2 * i + k as u64 + 12_345).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            *u = ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64;
        }
        draw
    }

    fn direction(cos: f64, u: f64) -> [f64; 3] {
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let (s, c) = libm::sincos(TAU * u);
        [sin * c, sin * s, cos]
    }

    fn cosine(i: u64) -> [f64; 3] {
        let u = uniform(i);
        direction(u[0].sqrt(), u[1])
    }

    fn cosine_pdf(d: [f64; 3]) -> f64 {
        d[2].max(0.0) / PI
    }

    #[test]
    fn right_samplers_pass_and_their_densities_integrate_to_one() {
        let n = 100_000;
        let uniform_sphere = sphere_test(
            |_| 1.0 / (4.0 * PI),
            |i| Some(direction(1.0 - 2.0 * uniform(i)[0], uniform(i)[1])),
            Cells::default(),
            n,
        );
        let lambert = sphere_test(cosine_pdf, |i| Some(cosine(i)), Cells::default(), n);
        for test in [uniform_sphere, lambert] {
            assert!((test.integral - 1.0).abs() < 1e-6, "{test:?}");
            test.expect(LEVEL, "a right sampler");
        }
        assert!(lambert.dof > 300 && uniform_sphere.dof > 600);
    }

    #[test]
    fn narrow_off_axis_lobe_is_integrated_to_four_digits() {
        // Von Mises-Fisher with kappa 1e4 about a tilted axis.
        let (kappa, axis) = (1e4, [0.6, 0.0, 0.8]);
        let pdf =
            |d: [f64; 3]| kappa / TAU * libm::exp(kappa * (d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2] - 1.0));
        let test = sphere_test(pdf, |_| None, Cells::default(), 10);
        assert!((test.integral - 1.0).abs() < 1e-4, "{test:?}");
        assert_eq!(test.p, 0.0, "draws that the density does not account for");
    }

    #[test]
    fn wrong_samplers_fail() {
        let n = 100_000;
        let wrong_density =
            sphere_test(|d| f64::from(u8::from(d[2] > 0.0)) / TAU, |i| Some(cosine(i)), Cells::default(), n);
        let wrong_side = sphere_test(cosine_pdf, |i| Some(cosine(i).map(|c| -c)), Cells::default(), n);
        let slightly_tilted = sphere_test(
            cosine_pdf,
            |i| {
                let d = cosine(i);
                Some(direction((d[2] + 0.01).min(1.0), uniform(i)[1]))
            },
            Cells::default(),
            n,
        );
        let not_a_number = sphere_test(cosine_pdf, |_| Some([f64::NAN, 0.0, 1.0]), Cells::default(), 10);
        for test in [wrong_density, wrong_side, slightly_tilted, not_a_number] {
            assert!(test.p < 1e-6, "{test:?}");
        }
    }

    #[test]
    fn lost_draws_pass_only_when_the_density_lacks_their_mass() {
        let n = 100_000;
        let lossy = |i: u64| (uniform(i ^ 0x5555_0000)[0] < 0.7).then(|| cosine(i));
        sphere_test(|d| 0.7 * cosine_pdf(d), lossy, Cells::default(), n).expect(LEVEL, "thinned lambert");
        assert!(sphere_test(cosine_pdf, lossy, Cells::default(), n).p < 1e-6);
    }

    #[test]
    fn p_values_of_right_samplers_are_spread_evenly() {
        // 100 tests: the number below 0.5 is binomial, 50 +- 5; four standard deviations.
        let below = (0..100u64)
            .filter(|k| {
                let test =
                    sphere_test(cosine_pdf, |i| Some(cosine(i + k * 1_000_003)), Cells { theta: 6, phi: 6 }, 4_000);
                test.p < 0.5
            })
            .count();
        assert!((30..=70).contains(&below), "{below} of 100 p-values below one half");
    }
}
