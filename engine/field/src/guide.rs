//! Where a leaf's light comes from: a mixture of lobes, for drawing directions.

use femc_math::elementary::sin_cos;
use femc_math::glam::Vec3A;
use femc_math::{Frame, cross};
use std::f32::consts::PI;

/// Most lobes of a leaf.
pub const LOBES: usize = 8;

/// Light through a place in space: through a gap, or from a source. It is a density over the plane through the place across the view, which
/// falls as `(1 + q)^-3`, with q = 1 on an ellipse: a Student distribution, whose long tails find what is somewhat beside. From each point of
/// the leaf the place lies in another direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    /// The place, prepared frame, m.
    pub target: Vec3A,
    /// Half axes of the ellipse, perpendicular to each other, m: as long as root two of the standard deviation.
    pub axes: [Vec3A; 2],
    /// Share of the leaf's irradiance that comes from there.
    pub share: f32,
}

impl Lobe {
    /// As wide in all directions.
    /// - `along`: the view, unit;
    /// - `spread`: mean square distance from the place, m2.
    pub fn round(target: Vec3A, along: Vec3A, spread: f32, share: f32) -> Self {
        let frame = Frame::from_normal(along);
        let radius = spread.max(f32::MIN_POSITIVE).sqrt();
        Self { target, axes: [Vec3A::X, Vec3A::Y].map(|axis| frame.to_world(axis) * radius), share }
    }
}

/// What is known of where the light of a leaf comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Guide {
    /// Index of its first lobe, and their number: [`LOBES`] at most.
    pub first: u32,
    /// Their number.
    pub count: u32,
    /// Share of directions to be drawn by the lobes, in [0, 1); 0: none.
    pub share: f32,
}

/// Least half axis of a lobe over its distance, an angle of half a degree.
const NARROW: f32 = 0.01;

/// The lobes of a leaf as seen from one of its points.
#[derive(Clone, Copy, Debug)]
pub struct Directions {
    /// By axis and lobe: the plane's unit normal, away from the point; the ellipse's axes over their squared lengths.
    normals: [[f32; LOBES]; 3],
    across: [[[f32; LOBES]; 3]; 2],
    /// Distance of the plane, m; the point's place in it, in half axes.
    heights: [f32; LOBES],
    places: [[f32; LOBES]; 2],
    /// Half axes, m, and density in the middle of the plane, 1/m2, times the lobe's share.
    lengths: [[f32; LOBES]; 2],
    peaks: [f32; LOBES],
    shares: [f32; LOBES],
    /// Share of directions to be drawn by the lobes.
    pub share: f32,
}

impl Directions {
    /// Of lobes, at a point; `None` where there are none.
    #[inline]
    pub fn new(lobes: &[Lobe], share: f32, point: Vec3A) -> Option<Self> {
        const NONE: [f32; LOBES] = [0.0; LOBES];
        let mut out = Self {
            normals: [NONE; 3],
            across: [[NONE; 3]; 2],
            heights: [1.0; LOBES],
            places: [NONE; 2],
            lengths: [NONE; 2],
            peaks: NONE,
            shares: NONE,
            share,
        };
        let mut sum = 0.0;
        for (k, lobe) in lobes.iter().enumerate().take(LOBES) {
            let way = lobe.target - point;
            let distance = way.length();
            let [a, b] = lobe.axes.map(|axis| axis.length());
            let (wide_a, wide_b) = (a.max(NARROW * distance), b.max(NARROW * distance));
            let [u, v] = [lobe.axes[0] / (a * wide_a), lobe.axes[1] / (b * wide_b)];
            let normal = cross(lobe.axes[0], lobe.axes[1]) / (a * b);
            let height = normal.dot(way);
            let (normal, height) = if height < 0.0 { (-normal, -height) } else { (normal, height) };
            // From a point in the plane there is nothing to be seen of it.
            if !(height > 1e-3 * distance && lobe.share > 0.0 && lobe.share.is_finite()) {
                continue;
            }
            for axis in 0..3 {
                out.normals[axis][k] = normal[axis];
                (out.across[0][axis][k], out.across[1][axis][k]) = (u[axis], v[axis]);
            }
            (out.heights[k], out.places[0][k], out.places[1][k]) = (height, -u.dot(way), -v.dot(way));
            (out.lengths[0][k], out.lengths[1][k]) = (wide_a, wide_b);
            (out.peaks[k], out.shares[k]) = (2.0 / (PI * wide_a * wide_b), lobe.share);
            sum += lobe.share;
        }
        if !(sum > 0.0 && sum.is_finite() && share > 0.0 && out.heights.iter().all(|height| height.is_finite())) {
            return None;
        }
        out.shares = out.shares.map(|share| share / sum);
        for k in 0..LOBES {
            out.peaks[k] *= out.shares[k];
        }
        Some(out)
    }

    /// Density of [`Self::sample`] in a unit direction, 1/sr.
    #[inline]
    pub fn pdf(&self, dir: Vec3A) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.each(dir);
        ((a + e) + (b + f)) + ((c + g) + (d + h))
    }

    /// The same by lobe.
    #[inline]
    pub fn each(&self, dir: Vec3A) -> [f32; LOBES] {
        let mut each = [0.0f32; LOBES];
        let dot = |of: &[[f32; LOBES]; 3], k: usize| of[0][k] * dir.x + of[1][k] * dir.y + of[2][k] * dir.z;
        for (k, pdf) in each.iter_mut().enumerate() {
            let ahead = dot(&self.normals, k).max(1e-6);
            let distance = self.heights[k] / ahead;
            let [a, b] = [0, 1].map(|axis| self.places[axis][k] + distance * dot(&self.across[axis], k));
            let x = 1.0 / (1.0 + a * a + b * b);
            let value = self.peaks[k] * (x * x * x) * (distance * distance / ahead);
            *pdf = if ahead > 1e-6 { value } else { 0.0 };
        }
        each
    }

    /// A direction.
    /// - `choice`, `u`: numbers in [0, 1).
    #[inline]
    pub fn sample(&self, choice: f32, u: [f32; 2]) -> Vec3A {
        let (mut at, mut left) = (0, choice);
        while at + 1 < LOBES && left >= self.shares[at] {
            left -= self.shares[at];
            at += 1;
        }
        // By rounding nothing may be left for the last ones.
        while at > 0 && self.shares[at] <= 0.0 {
            at -= 1;
        }
        let radius = (1.0 / (1.0 - u[0]).sqrt() - 1.0).max(0.0).sqrt();
        let (sin, cos) = sin_cos(2.0 * PI * u[1]);
        let axis = |of: &[[f32; LOBES]; 3]| Vec3A::new(of[0][at], of[1][at], of[2][at]);
        let places = [radius * cos - self.places[0][at], radius * sin - self.places[1][at]];
        let mut way = axis(&self.normals) * self.heights[at];
        for (k, place) in places.into_iter().enumerate() {
            let length = self.lengths[k][at];
            way += axis(&self.across[k]) * (place * length * length);
        }
        way.normalize_or(Vec3A::Z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::warp;

    fn lattice(n: u32) -> impl Iterator<Item = [f32; 2]> {
        (0..n).map(move |k| [(k as f32 + 0.5) / n as f32, (k as f32 * 0.618_034).fract()])
    }

    fn some() -> Directions {
        let lobe = |target: Vec3A, spread, share| Lobe::round(target, target.normalize(), spread, share);
        let tall = [Vec3A::new(-0.1, 0.3, 0.0), Vec3A::new(0.0, 0.0, 2.0)];
        let lobes = [
            lobe(Vec3A::new(3.0, 1.0, 0.5), 0.05, 0.4),
            lobe(Vec3A::new(-1.0, 2.0, 2.0), 1.0, 0.2),
            lobe(Vec3A::new(0.0, 0.0, -5.0), 9.0, 0.1),
            Lobe { target: Vec3A::new(-3.0, -1.0, 0.5), axes: tall, share: 0.1 },
        ];
        Directions::new(&lobes, 0.5, Vec3A::new(0.1, 0.2, 0.3)).expect("lobes")
    }

    /// The shares of samples in boxes of direction are the density's (chi-square with 95 degrees of freedom: 161 at a level of 3e-5).
    #[test]
    fn samples_have_the_density() {
        let directions = some();
        const N: usize = 200_000;
        let bin = |dir: Vec3A| {
            let turn = femc_math::elementary::atan2(dir.y, dir.x) / (2.0 * PI) + 0.5;
            let [row, column] = [(dir.z + 1.0) * 4.0, turn * 12.0].map(|at| at as usize);
            row.min(7) * 12 + column.min(11)
        };
        let (mut wanted, mut got) = (vec![0.0f64; 96], vec![0.0f64; 96]);
        for z in 0..4000 {
            for turn in 0..960 {
                let dir = warp::direction((z as f32 + 0.5) / 2000.0 - 1.0, (turn as f32 + 0.5) / 960.0);
                wanted[bin(dir)] += f64::from(directions.pdf(dir)) * 4.0 * std::f64::consts::PI / (4000.0 * 960.0);
            }
        }
        // Independent numbers: a lattice would be more even than chance.
        let mut state = 1u64;
        let mut number = || {
            state = femc_math::hash::mix64(state.wrapping_add(0x9e37_79b9_7f4a_7c15));
            femc_math::hash::unit_f32((state >> 32) as u32)
        };
        for _ in 0..N {
            let choice = number();
            got[bin(directions.sample(choice, [number(), number()]))] += 1.0;
        }
        let total: f64 = wanted.iter().sum();
        assert!((total - 1.0).abs() < 1e-2, "{total}");
        let chi: f64 = wanted
            .iter()
            .zip(&got)
            .map(|(want, got)| {
                let want = want / total * N as f64;
                (got - want).powi(2) / want.max(1.0)
            })
            .sum();
        assert!(chi < 161.0, "{chi}");
    }

    #[test]
    fn a_lobe_points_from_each_point_to_the_same_place() {
        let lobes = [Lobe::round(Vec3A::new(1.0, 2.0, 3.0), Vec3A::X, 1e-4, 1.0)];
        for point in [Vec3A::ZERO, Vec3A::new(5.0, 0.0, 0.0), Vec3A::new(0.5, 2.0, 2.9)] {
            let directions = Directions::new(&lobes, 0.5, point).expect("a lobe");
            let mean: Vec3A = lattice(256).map(|u| directions.sample(0.3, u)).sum();
            assert!(mean.normalize().dot((lobes[0].target - point).normalize()) > 0.999);
        }
        assert!(Directions::new(&[], 0.5, Vec3A::ZERO).is_none(), "no lobes");
        let dark = [Lobe { share: 0.0, ..lobes[0] }];
        assert!(Directions::new(&dark, 0.5, Vec3A::ZERO).is_none(), "lobes of nothing");
        assert!(Directions::new(&lobes, 0.5, Vec3A::new(1.0, 0.0, 0.0)).is_none(), "a plane from the side");
    }
}
