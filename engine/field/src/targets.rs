//! Targets: parallelograms and balls in space from which, or through which, much light comes. A region of the field has a pack of
//! targets and the share of its directions to sample toward each of them.
//!
//! All regions share few packs, so what a path reads at a vertex is small.

use crate::regions::RegionGrids;
use crate::{Field, Side};
use femc_geometry::Hit;
use femc_math::glam::Vec3A;
use femc_math::{Frame, Rgb, cross, warp};
use std::f32::consts::PI;

/// Maximum number of targets of a pack.
pub const PACK_TARGETS: usize = 8;

/// A part of space toward which directions are sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Directions are sampled uniformly over the area.
    Parallelogram(Parallelogram),
    /// Directions are sampled uniformly over the solid angle.
    Ball(Ball),
}

impl Target {
    /// Returns the parallelogram, if it is one.
    pub fn parallelogram(&self) -> Option<Parallelogram> {
        match *self {
            Self::Parallelogram(target) => Some(target),
            Self::Ball(_) => None,
        }
    }
}

impl From<Parallelogram> for Target {
    fn from(target: Parallelogram) -> Self {
        Self::Parallelogram(target)
    }
}

impl From<Ball> for Target {
    fn from(ball: Ball) -> Self {
        Self::Ball(ball)
    }
}

/// A ball in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Center, prepared frame, m.
    pub center: Vec3A,
    /// Radius, m.
    pub radius: f32,
}

/// A parallelogram in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parallelogram {
    /// Corner, prepared frame, m.
    pub corner: Vec3A,
    /// Edges from the corner, m.
    pub edges: [Vec3A; 2],
}

impl Parallelogram {
    /// Returns the center.
    pub fn center(&self) -> Vec3A {
        self.corner + (self.edges[0] + self.edges[1]) * 0.5
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f32 {
        cross(self.edges[0], self.edges[1]).length()
    }

    /// Returns the point at coordinates along the edges.
    pub fn point_at(&self, local: [f32; 2]) -> Vec3A {
        self.corner + self.edges[0] * local[0] + self.edges[1] * local[1]
    }

    /// Returns the position at which a segment crosses the parallelogram, as a share of its length, if it does.
    pub fn crossing(&self, from: Vec3A, to: Vec3A) -> Option<f32> {
        let along = to - from;
        let normal = cross(self.edges[0], self.edges[1]);
        let share = (self.corner - from).dot(normal) / along.dot(normal);
        if !(share > 0.0 && share < 1.0) {
            return None;
        }
        let offset = from + along * share - self.corner;
        let square = normal.length_squared();
        let place =
            [cross(offset, self.edges[1]).dot(normal) / square, cross(self.edges[0], offset).dot(normal) / square];
        place.iter().all(|at| (0.0..=1.0).contains(at)).then_some(share)
    }
}

/// Targets in a structure of arrays. Unused places have area 0: their density is 0.
#[derive(Clone, Debug, Default)]
pub struct TargetPack {
    targets: Vec<Target>,
    /// Values by axis and target: the corner, or the center of a ball; the unit normal; the vectors whose dot products with an offset
    /// from the corner are its coordinates along the edges.
    corners: [[f32; PACK_TARGETS]; 3],
    normals: [[f32; PACK_TARGETS]; 3],
    across: [[[f32; PACK_TARGETS]; 3]; 2],
    /// Lengths of the vectors `across`, 1/m.
    scales: [[f32; PACK_TARGETS]; 2],
    /// 1 over the area, 1/m2; 0 for balls.
    densities: [f32; PACK_TARGETS],
    /// Radii of balls, m; 0 for parallelograms.
    radii: [f32; PACK_TARGETS],
    has_balls: bool,
    /// Sums of the edges' lengths, m.
    diameters: [f32; PACK_TARGETS],
    /// Distance from the origin up to which coordinates of the targets lie, m. It bounds their rounding.
    extents: [f32; PACK_TARGETS],
}

/// Relative rounding of positions.
const ROUNDING: f32 = 4.0 * f32::EPSILON;

impl TargetPack {
    /// Creates a pack of at most [`PACK_TARGETS`] targets. Targets without area are never sampled.
    pub fn new(targets: &[Target]) -> Self {
        let targets = &targets[..targets.len().min(PACK_TARGETS)];
        let mut out = Self { targets: targets.to_vec(), ..Self::default() };
        for (k, target) in targets.iter().enumerate() {
            let target = match target {
                Target::Parallelogram(target) => target,
                Target::Ball(ball) => {
                    if ball.center.is_finite() && ball.radius.is_finite() && ball.radius > 0.0 {
                        (0..3).for_each(|axis| out.corners[axis][k] = ball.center[axis]);
                        out.radii[k] = ball.radius;
                        out.extents[k] = ball.center.length() + ball.radius;
                        out.has_balls = true;
                    }
                    continue;
                }
            };
            let [a, b] = target.edges;
            let cross_product = cross(a, b);
            let square = cross_product.length_squared();
            let across = [cross(b, cross_product) / square, cross(cross_product, a) / square];
            let density = 1.0 / square.sqrt();
            let is_sound = [target.corner, across[0], across[1]].iter().all(|it| it.is_finite())
                && density.is_finite()
                && density > 0.0;
            if !is_sound {
                continue;
            }
            for axis in 0..3 {
                out.corners[axis][k] = target.corner[axis];
                out.normals[axis][k] = cross_product[axis] * density;
                (out.across[0][axis][k], out.across[1][axis][k]) = (across[0][axis], across[1][axis]);
            }
            (out.scales[0][k], out.scales[1][k]) = (across[0].length(), across[1].length());
            out.densities[k] = density;
            out.diameters[k] = a.length() + b.length();
            out.extents[k] = target.corner.length() + out.diameters[k];
        }
        out
    }

    /// Returns the targets.
    pub fn targets(&self) -> &[Target] {
        &self.targets
    }

    fn center(&self, k: usize) -> Vec3A {
        Vec3A::new(self.corners[0][k], self.corners[1][k], self.corners[2][k])
    }
}

/// Targets of a region as seen from a point.
#[derive(Clone, Copy, Debug)]
pub struct TargetDirections<'a> {
    pack: &'a TargetPack,
    point: Vec3A,
    /// Distance to the plane along its normal, m; and the point's coordinates along the edges.
    heights: [f32; PACK_TARGETS],
    places: [[f32; PACK_TARGETS]; 2],
    /// Versine of the angular radius of each visible ball; 0 for the others.
    caps: [f32; PACK_TARGETS],
    /// Shares of the visible targets, which sum to 1; 0 for the others.
    weights: [f32; PACK_TARGETS],
}

/// Minimum distance of a point from the plane of a target, relative to that from the target's farthest point, for the target to be
/// visible. All directions toward a visible target have a density in spite of rounding.
const MIN_HEIGHT: f32 = 1e-4;
/// Minimum cosine of a direction with a density and the normal of a target; below [`MIN_HEIGHT`].
const MIN_COSINE: f32 = 1e-5;
/// Maximum squared sine of the angular radius of a visible ball. Closer to its surface, rounding would exceed it.
const MAX_SINE2: f32 = 0.999;

impl<'a> TargetDirections<'a> {
    /// Creates the directions from a point toward the targets of a region. `None`: no target with a share is visible.
    #[inline]
    pub fn new(pack: &'a TargetPack, region: &RegionTargets, point: Vec3A) -> Option<Self> {
        const NONE: [f32; PACK_TARGETS] = [0.0; PACK_TARGETS];
        let mut out = Self { pack, point, heights: NONE, places: [NONE; 2], caps: NONE, weights: NONE };
        for k in 0..PACK_TARGETS {
            let x = pack.corners[0][k] - point.x;
            let y = pack.corners[1][k] - point.y;
            let z = pack.corners[2][k] - point.z;
            let dot = |of: &[[f32; PACK_TARGETS]; 3]| of[0][k] * x + of[1][k] * y + of[2][k] * z;
            let height = dot(&pack.normals);
            out.heights[k] = height;
            (out.places[0][k], out.places[1][k]) = (-dot(&pack.across[0]), -dot(&pack.across[1]));
            let farthest = (x * x + y * y + z * z).sqrt() + pack.diameters[k];
            let is_visible =
                (height.abs() > MIN_HEIGHT * farthest) & (pack.densities[k] > 0.0) & (region.shares[k] > 0.0);
            out.weights[k] = if is_visible { region.shares[k] } else { 0.0 };
        }
        if pack.has_balls {
            out.add_balls(region);
        }
        let whole = sum(&out.weights);
        let scale = 1.0 / whole;
        out.weights = out.weights.map(|weight| weight * scale);
        (whole > 0.0 && scale.is_finite()).then_some(out)
    }

    /// Adds the balls. A ball around the point is not visible.
    fn add_balls(&mut self, region: &RegionTargets) {
        for k in 0..PACK_TARGETS {
            let radius = self.pack.radii[k];
            let square = (self.pack.center(k) - self.point).length_squared();
            let sine2 = radius * radius / square;
            if radius > 0.0 && sine2 < MAX_SINE2 && region.shares[k] > 0.0 {
                self.caps[k] = sine2 / (1.0 + (1.0 - sine2).sqrt());
                self.weights[k] = region.shares[k];
            }
        }
    }

    /// Returns the density of [`Self::sample`] in a unit direction, 1/sr.
    #[inline]
    pub fn pdf(&self, dir: Vec3A) -> f32 {
        sum(&self.each(dir))
    }

    /// Returns the density by target. The sum is [`Self::pdf`].
    #[inline]
    pub fn each(&self, dir: Vec3A) -> [f32; PACK_TARGETS] {
        let pack = self.pack;
        let mut each = [0.0f32; PACK_TARGETS];
        for (k, pdf) in each.iter_mut().enumerate() {
            let dot = |of: &[[f32; PACK_TARGETS]; 3]| of[0][k] * dir.x + of[1][k] * dir.y + of[2][k] * dir.z;
            let ahead = dot(&pack.normals);
            // A direction parallel to the plane has no density.
            let steep = if ahead.abs() > MIN_COSINE { ahead } else { f32::INFINITY };
            let distance = self.heights[k] / steep;
            let a = self.places[0][k] + distance * dot(&pack.across[0]);
            let b = self.places[1][k] + distance * dot(&pack.across[1]);
            // A sampled direction at the edge must have its density in spite of rounding.
            let rounding = ROUNDING * (distance + pack.extents[k]);
            let margins = [ROUNDING + rounding * pack.scales[0][k], ROUNDING + rounding * pack.scales[1][k]];
            let is_inside = (distance > 0.0)
                & (a >= -margins[0])
                & (a <= 1.0 + margins[0])
                & (b >= -margins[1])
                & (b <= 1.0 + margins[1]);
            let density = self.weights[k] * pack.densities[k] * (distance * distance / steep.abs());
            *pdf = if is_inside { density } else { 0.0 };
        }
        if pack.has_balls {
            self.add_ball_densities(dir, &mut each);
        }
        each
    }

    /// Adds the densities of balls.
    fn add_ball_densities(&self, dir: Vec3A, each: &mut [f32; PACK_TARGETS]) {
        for (k, pdf) in each.iter_mut().enumerate().filter(|(k, _)| self.caps[*k] > 0.0) {
            let center = self.pack.center(k) - self.point;
            let ahead = center.dot(dir);
            let radius = self.pack.radii[k] + ROUNDING * (ahead + self.pack.extents[k]);
            if ahead > 0.0 && (center - dir * ahead).length_squared() <= radius * radius {
                *pdf = self.weights[k] / (2.0 * PI * self.caps[k]);
            }
        }
    }

    /// Returns the shares of the visible targets, which sum to 1; 0 for the others.
    pub fn weights(&self) -> &[f32; PACK_TARGETS] {
        &self.weights
    }

    /// Samples a unit direction from `u` in [0, 1)^2. The first number also picks the target, so evenly spread numbers give each target
    /// evenly spread directions.
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> Vec3A {
        let (mut at, mut left) = (0, u[0]);
        while at + 1 < PACK_TARGETS && left >= self.weights[at] {
            left -= self.weights[at];
            at += 1;
        }
        // By rounding, nothing may be left for the last targets.
        while at > 0 && self.weights[at] <= 0.0 {
            at -= 1;
        }
        let rest = (left / self.weights[at]).clamp(0.0, 1.0 - f32::EPSILON / 2.0);
        match self.pack.targets.get(at) {
            Some(Target::Parallelogram(target)) => (target.point_at([rest, u[1]]) - self.point).normalize_or(Vec3A::Z),
            Some(Target::Ball(ball)) => {
                let axis = (ball.center - self.point).normalize_or(Vec3A::Z);
                let dir = warp::direction_from_versine(f64::from(rest * self.caps[at]), u[1]);
                Frame::from_normal(axis).to_world(dir).normalize()
            }
            None => Vec3A::Z,
        }
    }
}

/// Returns the sum in an order that suits vectors.
#[inline(always)]
fn sum([a, b, c, d, e, f, g, h]: &[f32; PACK_TARGETS]) -> f32 {
    ((a + e) + (b + f)) + ((c + g) + (d + h))
}

/// Targets of a region of the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionTargets {
    /// Index of the pack.
    pub pack: u32,
    /// Share of all directions, from the BSDF and toward targets, to sample toward each target. The sum is below 1.
    pub shares: [f32; PACK_TARGETS],
    /// Ratio of the light of the region to that of the field, where paths have found that the field is wrong.
    pub light_scale: f32,
}

impl Default for RegionTargets {
    fn default() -> Self {
        Self { pack: 0, shares: [0.0; PACK_TARGETS], light_scale: 1.0 }
    }
}

impl RegionTargets {
    /// Returns the share of directions to sample toward targets, in [0, 1).
    #[inline]
    pub fn share(&self) -> f32 {
        sum(&self.shares)
    }
}

/// Targets of a frame and their shares by region of the field.
#[derive(Clone, Debug, Default)]
pub struct TargetGuide {
    packs: Vec<TargetPack>,
    by_region: Vec<RegionTargets>,
    regions: RegionGrids,
}

/// Targets for paths at a point.
#[derive(Clone, Copy, Debug)]
pub struct GuidedTargets<'a> {
    /// Index of the region.
    pub region: u32,
    /// Targets and their shares, if sampling them is worthwhile.
    pub targets: Option<(&'a TargetPack, &'a RegionTargets)>,
    /// Irradiance near the point, lx by channel, without direct light from light sources. It is the field's, times a factor of the
    /// region.
    pub light: Rgb,
}

impl TargetGuide {
    /// Creates the guide of a field.
    /// - `by_region`: targets by region;
    /// - `region_by_leaf`: index of the region by leaf of the field.
    pub fn new(field: &Field, packs: Vec<TargetPack>, by_region: Vec<RegionTargets>, region_by_leaf: &[u32]) -> Self {
        let regions = RegionGrids::new(&field.roots, &field.cells, &field.leaves, region_by_leaf);
        Self { packs, by_region, regions }
    }

    /// Creates the guide of a field with a region for each leaf, and without targets. It still has the light of the field.
    pub fn without_targets(field: &Field) -> Self {
        let leaves: Vec<u32> = (0..field.leaves.len() as u32).collect();
        Self::new(field, Vec::new(), Vec::new(), &leaves)
    }

    /// Replaces the targets. The regions stay.
    /// - `by_region`: targets by region.
    pub fn set_targets(&mut self, packs: Vec<TargetPack>, by_region: Vec<RegionTargets>) {
        (self.packs, self.by_region) = (packs, by_region);
    }

    /// Returns the packs of targets.
    pub fn packs(&self) -> &[TargetPack] {
        &self.packs
    }

    /// Returns the targets by region.
    pub fn by_region(&self) -> &[RegionTargets] {
        &self.by_region
    }

    /// Returns the targets for paths at a hit. `None` if the first pass has no surface there.
    /// - `position`: position of the hit.
    #[inline]
    pub fn at(&self, field: &Field, hit: &Hit, side: Side, position: Vec3A) -> Option<GuidedTargets<'_>> {
        let (surface, place) = field.surface_at(hit, side);
        let region = self.regions.at(surface, || place(position))?;
        let own = self.by_region.get(region.data as usize);
        let targets = own.and_then(|own| self.packs.get(own.pack as usize).map(|pack| (pack, own)));
        let light = Rgb::from(region.light) * own.map_or(1.0, |own| own.light_scale);
        Some(GuidedTargets { region: region.data, targets, light })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::hash::{mix64, unit_f32};

    fn pack() -> TargetPack {
        let target = |corner: [f32; 3], a: [f32; 3], b: [f32; 3]| {
            Parallelogram { corner: corner.into(), edges: [a.into(), b.into()] }.into()
        };
        TargetPack::new(&[
            target([3.0, 1.0, 0.5], [0.0, 1.0, 0.2], [-0.3, 0.1, 0.8]),
            target([-1.0, 2.0, -2.0], [0.4, 0.0, 0.0], [0.0, 0.0, 4.0]),
            target([-2.0, -2.0, -5.0], [4.0, 0.0, 1.0], [0.0, 4.0, 0.0]),
            Ball { center: Vec3A::new(-1.5, -0.5, 1.0), radius: 0.7 }.into(),
        ])
    }

    /// Returns a region with shares of the targets.
    fn only([a, b, c, d]: [f32; 4]) -> RegionTargets {
        RegionTargets { shares: [a, b, c, d, 0.0, 0.0, 0.0, 0.0], ..Default::default() }
    }

    /// Shares of samples in boxes of directions match the density of each target and of all (chi-square with at most 191 degrees of
    /// freedom: 280 at a level of 3e-5).
    #[test]
    fn samples_of_targets_have_the_density() {
        const N: usize = 100_000;
        let pack = pack();
        let point = Vec3A::new(0.1, 0.2, 0.3);
        let all = only([0.2, 0.05, 0.4, 0.1]);
        let alone = [0, 1, 2, 3].map(|k| only(std::array::from_fn(|at| if at == k { 0.3 } else { 0.0 })));
        let kinds = [alone[0], alone[1], alone[2], alone[3], all];
        let kinds = kinds.map(|region| TargetDirections::new(&pack, &region, point).expect("visible targets"));
        let bin = |dir: Vec3A| {
            let turn = femc_math::elementary::atan2(dir.y, dir.x) / (2.0 * PI) + 0.5;
            let [row, column] = [(dir.z + 1.0) * 4.0, turn * 24.0].map(|at| at as usize);
            row.min(7) * 24 + column.min(23)
        };
        let mut wanted = vec![[0.0f64; 5]; 192];
        for z in 0..4000 {
            for turn in 0..4800 {
                let dir = warp::direction((z as f32 + 0.5) / 2000.0 - 1.0, (turn as f32 + 0.5) / 4800.0);
                let cell = &mut wanted[bin(dir)];
                let solid_angle = 4.0 * std::f64::consts::PI / (4000.0 * 4800.0);
                (0..5).for_each(|kind| cell[kind] += f64::from(kinds[kind].pdf(dir)) * solid_angle);
            }
        }
        for (target, directions) in kinds.iter().enumerate() {
            let total: f64 = wanted.iter().map(|cell| cell[target]).sum();
            assert!((total - 1.0).abs() < 5e-3, "{target}: {total}");
            let mut found = vec![0.0f64; 192];
            for at in 0..N as u64 {
                let number = |k: u64| unit_f32((mix64(3 * at + k) >> 32) as u32);
                let dir = directions.sample([number(0), number(1)]);
                assert!(directions.pdf(dir) > 0.0, "{target}: {dir}");
                found[bin(dir)] += 1.0;
            }
            let terms = wanted.iter().zip(&found).map(|(cell, found)| {
                let wanted = cell[target] / total * N as f64;
                (found - wanted).powi(2) / wanted.max(1.0)
            });
            let chi: f64 = terms.sum();
            assert!(chi < 280.0, "{target}: {chi}");
        }
    }

    #[test]
    fn directions_at_the_edges_of_far_narrow_targets_have_a_density() {
        for scale in [0.1f32, 1.0, 30.0] {
            let corner = Vec3A::new(40.0, -3.0, 2.0) * scale;
            let target = Parallelogram { corner, edges: [Vec3A::new(0.003, 0.01, 0.0), Vec3A::Z * 2.0] };
            let pack = TargetPack::new(&[target.into(), Ball { center: corner, radius: 0.003 }.into()]);
            let point = Vec3A::new(1.3, 0.7, -0.4) * scale;
            for region in [only([0.5, 0.0, 0.0, 0.0]), only([0.0, 0.5, 0.0, 0.0])] {
                let directions = TargetDirections::new(&pack, &region, point).expect("a visible target");
                for edge in (0..400u64).map(|at| unit_f32((mix64(at) >> 32) as u32)) {
                    let last = 1.0 - f32::EPSILON / 2.0;
                    for u in [[0.0, edge], [edge, 0.0], [last, edge], [edge, last]] {
                        assert!(directions.pdf(directions.sample(u)) > 0.0, "{u:?} at {scale}");
                    }
                }
            }
        }
    }

    /// Directions toward a target without a density would have too large weights.
    #[test]
    fn targets_of_no_area_or_seen_edge_on_are_not_sampled() {
        let flat = Parallelogram { corner: Vec3A::X, edges: [Vec3A::Y, Vec3A::Y] };
        let invalid = Parallelogram { corner: Vec3A::X, edges: [Vec3A::Y, Vec3A::new(0.0, 0.0, f32::NAN)] };
        let sound = Parallelogram { corner: Vec3A::X, edges: [Vec3A::Y, Vec3A::Z] };
        let pack = TargetPack::new(&[flat, invalid, sound].map(Target::from));
        let all = RegionTargets { shares: [0.1; PACK_TARGETS], ..Default::default() };
        let directions = TargetDirections::new(&pack, &all, Vec3A::ZERO).expect("a visible target");
        for at in 0..1000u64 {
            let number = |k: u64| unit_f32((mix64(2 * at + k) >> 32) as u32);
            let dir = directions.sample([number(0), number(1)]);
            assert!(directions.pdf(dir) > 0.0 && directions.pdf(-dir) == 0.0, "{dir}");
        }
        assert!(TargetDirections::new(&pack, &only([0.4, 0.4, 0.0, 0.0]), Vec3A::ZERO).is_none(), "without area");
        for point in [Vec3A::X, Vec3A::new(1.0, 5.0, -3.0), Vec3A::new(1.0 + 1e-6, 2.0, 0.5)] {
            assert!(TargetDirections::new(&pack, &all, point).is_none(), "in the plane: {point}");
        }
    }

    #[test]
    fn a_segment_crosses_a_target_inside_of_its_edges() {
        let target =
            Parallelogram { corner: Vec3A::new(1.0, -1.0, -1.0), edges: [Vec3A::Y * 2.0, Vec3A::new(0.5, 0.0, 2.0)] };
        assert!((target.area() - 4.123).abs() < 1e-3 && target.center() == Vec3A::new(1.25, 0.0, 0.0));
        let crossing = target.crossing(Vec3A::ZERO, Vec3A::X * 2.5);
        assert!((crossing.unwrap() - 0.5).abs() < 1e-6, "{crossing:?}");
        assert_eq!(target.crossing(Vec3A::ZERO, Vec3A::X), None);
        assert_eq!(target.crossing(Vec3A::ZERO, -Vec3A::X * 9.0), None);
        assert_eq!(target.crossing(Vec3A::ZERO, Vec3A::new(2.5, 2.2, 0.0)), None);
        assert_eq!(target.crossing(Vec3A::ZERO, Vec3A::Y), None, "parallel");
    }
}
