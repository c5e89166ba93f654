//! Distance sampling along a ray in fog, in proportion to the light of one source that is scattered there (airlight).
//!
//! The distribution uses the angle theta at the source, which a ray segment subtends. As a function of theta, the scattered light
//! is smooth: it is the product of the transmittance to eye and source, the phase function and the profile of the source
//! (\[kulla2012\]). The angle is divided into equal cells. Within a cell, directions follow the chord between the directions at its
//! ends, so a position is a quotient of two linear functions. The density over the chord interpolates linearly between its values
//! at the ends. Sampling a distance and evaluating its density therefore need only basic arithmetic.

use crate::light_sampler::approx::{arc_tangent, attenuation, inverse_cos_power, sine_cosine};
use crate::tree::Node;
use femc_math::glam::Vec3A;
use femc_simd::{Kernel, Lanes, Level, Simd, Vector, WIDTH};

/// Number of cells between the evaluated angles.
const CELLS: usize = WIDTH - 1;
/// Term that is added to every relative density, as a fraction of the mean, so that light between the evaluated angles is still
/// sampled.
const DENSITY_FLOOR: f32 = 0.05;
/// Tolerance of cosines.
const COSINE_TOLERANCE: f32 = 1e-3;

/// A segment of a ray and a source beside it.
#[derive(Clone, Copy, Debug)]
pub struct EquiangularSegment {
    /// Vector from the source to the nearest point of the ray's line, m.
    foot: Vec3A,
    dir: Vec3A,
    /// Distance of the source from the line, with a lower bound, m.
    h: f32,
    /// Coordinate of the segment's start relative to the foot, m.
    start: f32,
    /// Distances from the start at the evaluated angles, m, and the cosines of these angles.
    distances: [f32; WIDTH],
    cosines: [f32; WIDTH],
}

/// Properties of fog and source along the ray, at the distances of [`EquiangularSegment::distances`].
#[derive(Clone, Copy, Debug)]
pub struct SegmentMedium {
    /// Optical depth from the eye.
    pub depth: [f32; WIDTH],
    /// Scattering coefficient, in any unit.
    pub scattering: [f32; WIDTH],
    /// Extinction between the ray and the source, 1/m.
    pub extinction: f32,
    /// Schlick's parameter of the phase function (\[blasi1993\]).
    pub phase: f32,
}

/// Angular profile of a source as seen from the ray.
#[derive(Clone, Copy, Debug)]
pub enum SourceProfile<'a> {
    /// Profile from the bounds in a light tree's node.
    Bounds(&'a Node),
    /// Given values, by distance.
    Sampled(&'a [f32; WIDTH]),
}

impl EquiangularSegment {
    /// Prepares a segment for a source.
    /// - `origin`, m; `dir`: unit; `range`: first and last distance of the segment, m, finite; `center`: of the source, m.
    /// - `min_distance`: lower bound for the distance between source and ray, m, > 0.
    #[inline]
    pub fn new(level: Level, origin: Vec3A, dir: Vec3A, range: (f32, f32), center: Vec3A, min_distance: f32) -> Self {
        // The nearest point of the line has the rounding error of the coordinates. No peak is made narrower than this error.
        let from = origin - center;
        let along = from.dot(dir);
        let foot = from - dir * along;
        let resolved = 32.0 * f32::EPSILON * along.abs();
        let h = foot.length().max(min_distance).max(resolved).max(1e-18);
        let (start, length) = (along + range.0, range.1 - range.0);
        let (distances, cosines) = level.run(EquiangularSteps { h, start, length });
        Self { foot, dir, h, start, distances, cosines }
    }

    /// Returns the distances from the segment's start at even steps of the angle, including both ends, m.
    #[inline]
    pub fn distances(&self) -> [f32; WIDTH] {
        self.distances
    }

    /// Returns the directions from the source to the points at these distances, unit.
    pub fn directions(&self) -> [Vec3A; WIDTH] {
        self.distances.map(|t| (self.foot + self.dir * (self.start + t)).normalize_or(self.dir))
    }

    /// Returns the distribution of distances.
    #[inline]
    pub fn airlight(self, level: Level, medium: &SegmentMedium, source: SourceProfile<'_>) -> Airlight {
        let (values, total) = level.run(RelativeDensities { segment: &self, medium, source });
        Airlight { distances: self.distances, cosines: self.cosines, values, total }
    }
}

/// Task that computes the distances from the start at even steps of the angle, and the cosines of the angles.
struct EquiangularSteps {
    h: f32,
    start: f32,
    length: f32,
}

impl Kernel for EquiangularSteps {
    type Output = ([f32; WIDTH], [f32; WIDTH]);

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        let c = |x| simd.splat(x);
        let Self { h, start: a, length } = self;
        let b = a + length;
        let (square_a, square_b) = (h * h + a * a, h * h + b * b);
        let (to_a, to_b) = (1.0 / square_a.sqrt(), 1.0 / square_b.sqrt());
        // Half the angle between the two ends has the tangent sin / (1 + cos).
        let tangent = h * length * to_a * to_b / (1.0 + (h * h + a * b) * to_a * to_b).max(1e-7);
        let half = arc_tangent(simd, c(tangent.max(0.0)));
        let step = simd.load(&Lanes([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]));
        // A quarter of the angle, doubled twice.
        let (s, k) = sine_cosine(simd, step * half * c(1.0 / (2 * CELLS) as f32));
        let (s, k) = (c(2.0) * s * k, c(1.0) - c(2.0) * s * s);
        let (s, k) = (c(2.0) * s * k, c(1.0) - c(2.0) * s * s);
        // Computed from the start, so that nothing cancels for sources far beside, before or behind the segment.
        let left = (c(h) * k - c(a) * s).max(c(f32::MIN_POSITIVE));
        let mut distances = (s * c(square_a) / left).max(c(0.0)).min(c(length)).lanes().0;
        let mut cosines = (left * c(to_a)).max(c(1e-9)).lanes().0;
        (distances[0], distances[CELLS]) = (0.0, length);
        (cosines[0], cosines[CELLS]) = (h * to_a, h * to_b);
        (distances, cosines)
    }
}

/// Task that computes the relative densities at the angles, and the sum of the cells.
struct RelativeDensities<'a> {
    segment: &'a EquiangularSegment,
    medium: &'a SegmentMedium,
    source: SourceProfile<'a>,
}

impl Kernel for RelativeDensities<'_> {
    type Output = ([f32; WIDTH], f32);

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        let c = |x| simd.splat(x);
        let one = c(1.0);
        let EquiangularSegment { foot, dir, h, start, distances, .. } = *self.segment;
        let place = c(start) + simd.load(&Lanes(distances));
        let distance = (c(h * h) + place * place).sqrt();
        let inverse = one / distance;
        let depth = simd.load(&Lanes(self.medium.depth)) + c(self.medium.extinction) * distance;
        // Depths are relative to the least depth, so that not every value vanishes in thick fog.
        let least = depth.lanes().0.into_iter().fold(f32::INFINITY, f32::min);
        let dimmed = attenuation(simd, (depth - c(least)).max(c(0.0)));
        let lobe = one / (one + c(self.medium.phase) * place * inverse);
        let profile = match self.source {
            SourceProfile::Sampled(values) => simd.load(&Lanes(*values)),
            SourceProfile::Bounds(node) if node.is_omnidirectional() => one,
            SourceProfile::Bounds(node) => {
                let cos = (c(node.axis.dot(foot)) + c(node.axis.dot(dir)) * place) * inverse;
                let cos = if node.two_sided { cos.max(c(0.0) - cos) } else { cos };
                let is_seen = c(-COSINE_TOLERANCE).lt(cos);
                let near = (cos.max(c(0.0)) + c(0.5 * node.radius()) * inverse).min(one).max(c(COSINE_TOLERANCE));
                let cos = is_seen.select(near, c(0.0));
                if node.exponent <= 1.0 { cos } else { cos / inverse_cos_power(simd, cos, c(node.exponent - 1.0)) }
            }
        };
        let value = simd.load(&Lanes(self.medium.scattering)) * dimmed * lobe * lobe * profile;
        let mut values = value.max(c(0.0)).min(c(1e30)).lanes().0;
        let mean = values.iter().sum::<f32>() * (1.0 / WIDTH as f32);
        // Values are scaled by the mean, because squares of tiny values would underflow.
        let scale = if mean > f32::MIN_POSITIVE { 1.0 / mean } else { 0.0 };
        for value in &mut values {
            *value = *value * scale + DENSITY_FLOOR;
        }
        let total = values.iter().sum::<f32>() - 0.5 * (values[0] + values[CELLS]);
        (values, total)
    }
}

/// Distribution of distances along a ray, in proportion to the light of a source that is scattered there.
#[derive(Clone, Copy, Debug)]
pub struct Airlight {
    /// Distances of the cells' ends from the segment's start, m, and the cosines of their angles.
    distances: [f32; WIDTH],
    cosines: [f32; WIDTH],
    /// Relative densities over the chords at the cells' ends.
    values: [f32; WIDTH],
    /// Sum of the cells.
    total: f32,
}

impl Airlight {
    /// Computes by how much the steps of `depth` between neighboring angles exceed 1: the mean of the excess over the distribution.
    #[inline]
    pub fn steepness(&self, depth: &[f32; WIDTH]) -> f32 {
        if depth[CELLS] - depth[0] <= 1.0 {
            return 0.0;
        }
        let excess = |k: usize| {
            let mean = 0.5 * (self.values[k] + self.values[k + 1]);
            mean * (depth[k + 1] - depth[k] - 1.0).clamp(0.0, 20.0)
        };
        (0..CELLS).map(excess).sum::<f32>() / self.total
    }

    /// Samples a distance from the segment's start, m, from `u` in [0, 1), with density [`Self::pdf`].
    #[inline]
    pub fn sample(&self, u: f32) -> f32 {
        let mut rest = u * self.total;
        let mut cell = 0;
        loop {
            let area = 0.5 * (self.values[cell] + self.values[cell + 1]);
            if rest < area || cell + 1 == CELLS {
                break;
            }
            rest -= area;
            cell += 1;
        }
        let (from, rise) = (self.values[cell], self.values[cell + 1] - self.values[cell]);
        let within = (2.0 * rest / (from + (from * from + 2.0 * rise * rest).max(0.0).sqrt())).clamp(0.0, 1.0);
        let (a, b) = (self.cosines[cell] * (1.0 - within), self.cosines[cell + 1] * within);
        let (low, high) = (self.distances[cell], self.distances[cell + 1]);
        low + (high - low) * (b / (a + b))
    }

    /// Returns the density at distance `t` from the segment's start, 1/m; 0 outside the segment.
    #[inline]
    pub fn pdf(&self, t: f32) -> f32 {
        if t < 0.0 || t > self.distances[CELLS] {
            return 0.0;
        }
        let mut cell = 0;
        while cell + 1 < CELLS && t >= self.distances[cell + 1] {
            cell += 1;
        }
        let (low, high) = (self.distances[cell], self.distances[cell + 1]);
        let (a, b) = (self.cosines[cell], self.cosines[cell + 1]);
        let (before, after) = ((t - low).max(0.0) * a, (high - t).max(0.0) * b);
        let sum = before + after;
        // The distance is `low + (high - low) b x / (a (1 - x) + b x)` for position x on the chord.
        let within = before / sum;
        let mixed = a * (1.0 - within) + b * within;
        let slope = a * b * (high - low) / (mixed * mixed);
        let value = self.values[cell] + (self.values[cell + 1] - self.values[cell]) * within;
        let pdf = value / (self.total * slope);
        if pdf.is_finite() { pdf } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::LightTree;
    use crate::{EmissionCone, LightBounds};
    use femc_math::hash::{combine, unit_f32};
    use femc_stats::testing::{chi2::pooled_test, sidak};

    /// Length of a segment, the source's coordinates along and beside the ray, extinction, phase parameter.
    const CASES: [(f32, f32, f32, f32, f32); 12] = [
        (10.0, 4.0, 1.0, 0.0, 0.0),
        (10.0, 4.0, 1e-3, 0.1, 0.0),
        (10.0, 0.0, 0.0, 0.5, 0.85),
        (10.0, -3.0, 0.5, 0.2, -0.5),
        (10.0, 13.0, 0.5, 0.2, 0.85),
        (1e4, 5e3, 1e-2, 1e-3, 0.0),
        (1e-4, 5e3, 2.0, 1e-3, 0.0),
        (1.0, -1e4, 1e-2, 1e-4, 0.3),
        (100.0, 50.0, 5.0, 5.0, 0.0),
        (1e3, 1e3, 1e3, 0.1, 0.0),
        (50.0, 20.0, 2.0, 0.05, 0.95),
        (1e9, 7.0, 2.0, 1e-9, 0.0),
    ];

    fn panel(center: Vec3A, axis: Vec3A, exponent: f32) -> Node {
        let cone = EmissionCone { axis, cos_normals: 1.0, exponent, two_sided: false };
        let (low, high) = (center - Vec3A::splat(0.1), center + Vec3A::splat(0.1));
        let bounds = LightBounds { low, high, center, power: 1.0, extinction: 0.0, cone };
        LightTree::new(&[bounds]).leaves()[0]
    }

    fn case(k: usize, level: Level) -> Airlight {
        let (length, along, distance, extinction, phase) = CASES[k];
        let dir = Vec3A::new(0.48, 0.6, 0.64);
        let across = Vec3A::new(0.8, -0.64, 0.0).normalize();
        let center = Vec3A::ONE + dir * along + across * distance;
        let segment = EquiangularSegment::new(level, Vec3A::ONE, dir, (0.0, length), center, 1e-4);
        let depth = segment.distances().map(|t| extinction * t);
        let medium = SegmentMedium { depth, scattering: [1.0; WIDTH], extinction, phase };
        let node = panel(center, -across, if k.is_multiple_of(2) { 1.0 } else { 40.0 });
        segment.airlight(level, &medium, SourceProfile::Bounds(&node))
    }

    /// Integrates the density up to `t` by the midpoint rule in each cell, at even positions on its chord.
    fn share(airlight: &Airlight, t: f64) -> f64 {
        let mut sum = 0.0;
        for cell in 0..CELLS {
            let n = 400;
            let place = |i: i32| {
                let x = f64::from(i) / f64::from(n);
                let (a, b) = (f64::from(airlight.cosines[cell]) * (1.0 - x), f64::from(airlight.cosines[cell + 1]) * x);
                let (low, high) = (f64::from(airlight.distances[cell]), f64::from(airlight.distances[cell + 1]));
                (low + (high - low) * b / (a + b)).min(t)
            };
            for i in 0..n {
                let (a, b) = (place(i), place(i + 1));
                let middle = airlight.pdf((0.5 * (a + b)) as f32);
                sum += (b - a) * f64::from(middle);
            }
        }
        sum
    }

    #[test]
    fn distances_follow_the_density() {
        let level = sidak(1e-3, CASES.len());
        for (k, described) in CASES.iter().enumerate() {
            let airlight = case(k, Level::detect());
            let length = f64::from(described.0);
            let whole = share(&airlight, length);
            assert!((whole - 1.0).abs() < 3e-3, "{described:?}: {whole}");
            // Bin borders at quantiles, found by sampling with even numbers.
            let cells = if described.2 < 1e-4 * described.1.abs() { 6u32 } else { 20 };
            let border = |i: u32| f64::from(airlight.sample(i as f32 / cells as f32));
            let borders: Vec<f64> = (1..cells).map(border).collect();
            let n = 20_000u64;
            let mut counts = vec![0u64; cells as usize];
            for i in 0..n {
                let t = airlight.sample(unit_f32((combine(&[k as u64, i]) >> 32) as u32));
                assert!(t >= 0.0 && f64::from(t) <= length * 1.000_01 && t.is_finite(), "{t}");
                counts[borders.partition_point(|b| *b <= f64::from(t))] += 1;
            }
            let up_to: Vec<f64> = [0.0].into_iter().chain(borders.iter().map(|&t| share(&airlight, t))).collect();
            let mass = |i: usize| up_to.get(i + 1).copied().unwrap_or(whole) - up_to[i];
            let expected: Vec<f64> = (0..cells as usize).map(|i| mass(i) / whole * n as f64).collect();
            let result = pooled_test(&expected, &counts);
            assert!(result.p >= level, "{described:?}: {result:?}");
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_distances() {
        for k in 0..CASES.len() {
            let (fast, plain) = (case(k, Level::detect()), case(k, Level::PORTABLE));
            for i in 0..100u8 {
                let u = f32::from(i) / 100.0;
                let t = fast.sample(u);
                assert_eq!((t, fast.pdf(t)), (plain.sample(u), plain.pdf(t)));
            }
        }
    }

    #[test]
    fn point_source_airlight_matches_tables_with_little_variance() {
        // sigma_s = sigma_t = 1, intensity 1, isotropic phase, h = 1, from t' = a to (nearly) infinity.
        for (start, expected) in [(0.0f32, 0.015_382_72), (-2.0, 0.008_933_162), (-5.0, 5.656_51e-4)] {
            let level = Level::detect();
            let center = Vec3A::new(-start, 1.0, 0.0);
            let segment = EquiangularSegment::new(level, Vec3A::ZERO, Vec3A::X, (0.0, 30.0), center, 1e-6);
            let medium =
                SegmentMedium { depth: segment.distances(), scattering: [1.0; WIDTH], extinction: 1.0, phase: 0.0 };
            let airlight = segment.airlight(level, &medium, SourceProfile::Sampled(&[1.0; WIDTH]));
            let n = 100_000u32;
            let (mut sum, mut squares) = (0.0f64, 0.0f64);
            for i in 0..n {
                let t = airlight.sample((i as f32 + 0.5) / n as f32);
                let d = f64::from(t + start).hypot(1.0);
                let value =
                    (-f64::from(t) - d).exp() / (4.0 * std::f64::consts::PI * d * d) / f64::from(airlight.pdf(t));
                sum += value;
                squares += value * value;
            }
            let mean = sum / f64::from(n);
            assert!((mean / expected - 1.0).abs() < 2e-4, "from {start}: {mean} against {expected}");
            let variance = squares / f64::from(n) / (mean * mean) - 1.0;
            assert!(variance < 0.15, "from {start}: relative variance {variance}");
        }
    }

    #[test]
    fn a_source_in_the_ray_or_at_its_end_is_no_trouble() {
        for (length, along) in [(0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (1e-30, 0.0), (1e12, 1e12)] {
            let level = Level::detect();
            let segment = EquiangularSegment::new(level, Vec3A::ZERO, Vec3A::X, (0.0, length), Vec3A::X * along, 1e-6);
            let medium =
                SegmentMedium { depth: segment.distances(), scattering: [0.0; WIDTH], extinction: 1.0, phase: 0.9 };
            let airlight = segment.airlight(level, &medium, SourceProfile::Sampled(&[f32::INFINITY; WIDTH]));
            for u in [0.0, 0.3, 1.0 - f32::EPSILON / 2.0] {
                let t = airlight.sample(u);
                assert!(t >= 0.0 && t <= length && airlight.pdf(t) >= 0.0, "{length} {t} {}", airlight.pdf(t));
            }
            assert_eq!(airlight.pdf(-0.1), 0.0);
        }
    }
}
