//! Distances along a ray with the density of the angle subtended at a point (\[kulla2012\]).
//!
//! With h the distance of the point from the ray, `pdf(t) = h / (delta (h^2 + t'^2))`, t' the distance from the foot of the
//! perpendicular and delta the angle of the whole segment. The inverse is written from the segment's start,
//! `t = sin(x) (h^2 + a^2) / (h cos(x) - a sin(x))`, a = t' at the start and x = u delta: nothing cancels for points far
//! beside, before or behind the segment.

use femc_math::elementary::double::{atan2, sin_cos};
use femc_math::glam::Vec3A;

/// Sampling of distances on `[0, t_max]` of one ray about one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equiangular {
    /// Distance of the point from the ray, m, > 0.
    h: f64,
    /// Coordinate of the ray's origin from the foot of the perpendicular, m.
    a: f64,
    /// Angle of the segment at the point, rad; 0 if there is nothing to sample.
    delta: f64,
    t_max: f64,
}

impl Equiangular {
    /// - `origin`, m; `dir`: unit; `t_max`: m, may be infinite; `center`: the point, m.
    /// - `least_distance`: the point is treated as no nearer to the ray than this, m, > 0 (1e-6 of the scene's extent).
    pub fn new(origin: Vec3A, dir: Vec3A, t_max: f32, center: Vec3A, least_distance: f32) -> Self {
        let v = center.as_dvec3() - origin.as_dvec3();
        let dir = dir.as_dvec3();
        let a = -v.dot(dir);
        // A peak narrower than the spacing of f32 distances around it could be sampled, but not told where.
        let resolved = (32.0 * f64::from(f32::EPSILON) * a.abs()).max(f64::MIN_POSITIVE.sqrt());
        let h = v.cross(dir).length().max(f64::from(least_distance)).max(resolved);
        let t_max = f64::from(t_max);
        // The angle between the two ends, from the sine and cosine of the difference; the limit where t_max is infinite.
        let delta = if t_max == f64::INFINITY { atan2(h, a) } else { atan2(h * t_max, h * h + a * (a + t_max)) };
        Self { h, a, delta: if t_max > 0.0 { delta } else { 0.0 }, t_max }
    }

    /// A distance, m, and its density, 1/m, from `u` in [0, 1). `None` on an empty segment.
    #[inline]
    pub fn sample(&self, u: f32) -> Option<(f32, f32)> {
        let (sin, cos) = sin_cos(f64::from(u) * self.delta);
        let t = sin * (self.h * self.h + self.a * self.a) / (self.h * cos - self.a * sin);
        let t = if t.is_nan() { 0.0 } else { t.clamp(0.0, self.t_max.min(f64::from(f32::MAX))) } as f32;
        let pdf = self.pdf(t);
        (pdf > 0.0).then_some((t, pdf))
    }

    /// Density at distance `t`, 1/m; 0 outside the segment.
    #[inline]
    pub fn pdf(&self, t: f32) -> f32 {
        let t = f64::from(t);
        if self.delta <= 0.0 || t < 0.0 || t > self.t_max {
            return 0.0;
        }
        let along = self.a + t;
        let pdf = (self.h / (self.delta * (self.h * self.h + along * along))) as f32;
        if pdf.is_finite() { pdf } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::hash::{combine, unit_f32};
    use femc_stats::testing::chi2::pooled_test;
    use femc_stats::testing::sidak;

    /// Segment length, and the point's coordinates along and beside the ray.
    const CASES: [(f32, f32, f32); 10] = [
        (10.0, 4.0, 1.0),
        (10.0, 4.0, 1e-3),
        (10.0, 0.0, 0.0),
        (10.0, -3.0, 0.5),
        (10.0, 13.0, 0.5),
        (1e4, 5e3, 1e-4),
        (1e-4, 5e3, 2.0),
        (1.0, -1e4, 1e-2),
        (f32::INFINITY, 7.0, 2.0),
        (f32::INFINITY, -7.0, 2.0),
    ];

    fn case(t_max: f32, along: f32, beside: f32) -> Equiangular {
        let dir = Vec3A::new(0.48, 0.6, 0.64);
        let across = Vec3A::new(0.8, -0.64, 0.0).normalize();
        Equiangular::new(Vec3A::ONE, dir, t_max, Vec3A::ONE + dir * along + across * beside, 1e-4)
    }

    #[test]
    fn distances_follow_the_density() {
        let level = sidak(1e-3, CASES.len());
        for (k, (t_max, along, beside)) in CASES.into_iter().enumerate() {
            let e = case(t_max, along, beside);
            // Cells at equal steps of u, their mass by the difference of arc tangents, computed apart from the code above.
            let h = e.h;
            // Coarser where the spacing of f32 distances is a good part of a cell.
            let (cells, n) = if h < 1e-5 * e.a.abs() { (10usize, 2000u64) } else { (50, 20_000) };
            let angle = |t: f64| if t.is_infinite() { std::f64::consts::FRAC_PI_2 } else { ((t + e.a) / h).atan() };
            let (low, high) = (angle(0.0), angle(f64::from(t_max)));
            let border = |i: usize| {
                let (mut a, mut b) = (0.0f64, if t_max.is_infinite() { 1e9 } else { f64::from(t_max) });
                for _ in 0..200 {
                    let m = 0.5 * (a + b);
                    if (angle(m) - low) / (high - low) < i as f64 / cells as f64 { a = m } else { b = m }
                }
                a
            };
            let borders: Vec<f64> = (1..cells).map(border).collect();
            let mut counts = vec![0u64; cells];
            for i in 0..n {
                let u = unit_f32((combine(&[k as u64, i]) >> 32) as u32);
                let (t, pdf) = e.sample(u).expect("a segment with a length");
                assert!(t >= 0.0 && t <= t_max && t.is_finite(), "{t}");
                assert!(pdf == e.pdf(t) && pdf.is_finite(), "{pdf}");
                counts[borders.partition_point(|b| *b <= f64::from(t))] += 1;
            }
            let expected = vec![n as f64 / cells as f64; cells];
            let result = pooled_test(&expected, &counts);
            assert!(result.p >= level, "{t_max} {along} {beside}: {result:?}");
        }
    }

    #[test]
    fn the_density_integrates_to_one() {
        for (t_max, along, beside) in CASES {
            let e = case(t_max, along, beside);
            // By midpoints of u: the sum of the widths of the images times the density there.
            let n = 20_000u32;
            let at = |i: u32| e.sample((f64::from(i) / f64::from(n)) as f32).map_or(0.0, |s| f64::from(s.0));
            let mut sum = 0.0;
            for i in 0..n - 1 {
                let (a, b) = (at(i), at(i + 1));
                sum += (b - a) * 0.5 * f64::from(e.pdf(a as f32) + e.pdf(b as f32));
            }
            assert!((sum - 1.0).abs() < 2e-3, "{t_max} {along} {beside}: {sum}");
        }
    }

    #[test]
    fn airlight_of_a_point_source_has_the_tabulated_values() {
        // sigma_s = sigma_t = 1, intensity 1, isotropic phase, h = 1, from t' = a to infinity: int e^{-(t-a)} e^{-d} / (4 pi d^2) dt.
        for (start, expected) in [(0.0f32, 0.015_382_72), (-2.0, 0.008_933_162), (-5.0, 5.656_51e-4)] {
            let e = Equiangular::new(Vec3A::ZERO, Vec3A::X, f32::INFINITY, Vec3A::new(-start, 1.0, 0.0), 1e-6);
            let n = 100_000u32;
            let mut sum = 0.0f64;
            for i in 0..n {
                let (t, pdf) = e.sample((i as f32 + 0.5) / n as f32).expect("an infinite segment");
                let d = f64::from(t + start).hypot(1.0);
                sum += (-f64::from(t) - d).exp() / (4.0 * std::f64::consts::PI * d * d) / f64::from(pdf);
            }
            let mean = sum / f64::from(n);
            assert!((mean / expected - 1.0).abs() < 1e-4, "from {start}: {mean} against {expected}");
        }
    }

    #[test]
    fn an_empty_segment_gives_nothing() {
        let e = case(0.0, 1.0, 1.0);
        assert_eq!((e.sample(0.3), e.pdf(0.0)), (None, 0.0));
        let e = case(10.0, 4.0, 1.0);
        assert_eq!((e.pdf(-0.1), e.pdf(10.1)), (0.0, 0.0));
    }
}
