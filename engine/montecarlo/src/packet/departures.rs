//! Departures of paths from their vertices, and the branches that wait there.

use super::paths::PathLanes;
use super::points::PointLanes;
use super::rough::RoughSurfaces;
use super::vectors::{Frames, Functions, V3};
use super::vertices::{Surfaces, Vertices};
use crate::roulette::RR_THRESHOLD;
use crate::window::copy_shift;
use femc_simd::{Kernel, Simd, Vector};
use std::f32::consts::FRAC_1_PI;

/// Branches of the paths in the lanes.
pub struct Branches {
    /// Paths that wait at their first vertices, by number of the branch - 1.
    paths: Vec<PathLanes>,
    /// Lanes in which each of these paths continues, for the lanes that were split last.
    going: Vec<u32>,
}

impl Branches {
    /// Creates the branches.
    /// - `branches`: number of branches of a path at its first vertex, with the path itself.
    pub fn new(branches: u32) -> Self {
        let count = branches.max(1) as usize - 1;
        Self { paths: std::iter::repeat_with(PathLanes::default).take(count).collect(), going: vec![0; count] }
    }

    /// Checks whether paths are split.
    pub fn exist(&self) -> bool {
        !self.paths.is_empty()
    }

    /// Returns the branches that wait in a lane that was split last: bit k for branch k.
    #[inline(always)]
    pub fn waiting(&self, lane: usize) -> u32 {
        (1..).zip(&self.going).fold(0, |bits, (branch, going)| bits | (going >> lane & 1) << branch)
    }

    /// Returns the paths of a branch.
    #[inline(always)]
    pub fn paths(&self, branch: u32) -> &PathLanes {
        &self.paths[branch as usize - 1]
    }
}

/// Adds the light of visible lamps, samples directions, and performs Russian roulette. Returns the lanes that continue.
pub struct Leave<'a> {
    pub vertices: &'a Vertices,
    /// Lanes whose shadow rays hit nothing.
    pub visible: u32,
    pub points: &'a PointLanes,
    pub paths: &'a mut PathLanes,
    /// Lanes whose paths are split into branches.
    pub split: u32,
    pub branches: &'a mut Branches,
}

impl Kernel for Leave<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u32 {
        let Self { vertices, visible, points, paths, split, branches } = self;
        let mut vertex = Departing::load(simd, vertices, points, paths);
        let light = (vertex.throughput * vertices.light.load(simd)).masked(simd.mask(visible));
        let color = paths.color.load(simd) + light;
        paths.color.replace(simd, simd.mask(vertices.used), color);
        if split != 0 {
            let is_split = simd.mask(split);
            let directions = simd.splat((1 + branches.paths.len()) as f32);
            vertex.throughput = vertex.throughput.over(directions).or_else(is_split, vertex.throughput);
            vertex.roulette_scale = is_split.select(vertex.roulette_scale * directions, vertex.roulette_scale);
            paths.roulette_scale.0 = vertex.roulette_scale.lanes();
            let mut invalid = 0;
            for branch in 0..branches.paths.len() {
                let shift = copy_shift(branch as u32 + 1, branches.paths.len() as u32 + 1);
                let departure = vertex.depart(simd, Some(shift));
                invalid |= split & !departure.valid;
                branches.going[branch] = departure.going & split;
                let waiting = &mut branches.paths[branch];
                departure.store(simd, is_split, waiting);
                waiting.roulette_scale.replace(simd, is_split, vertex.roulette_scale);
            }
            // A branch with an invalid throughput makes the sample a bad one.
            let nan = simd.splat(f32::NAN);
            vertex.throughput = V3 { x: nan, y: nan, z: nan }.or_else(simd.mask(invalid), vertex.throughput);
        }
        let departure = vertex.depart(simd, None);
        departure.store(simd, simd.mask(vertices.used), paths);
        departure.going & vertices.used
    }
}

/// Vertices in the registers.
struct Departing<'a, S: Simd> {
    vertices: &'a Vertices,
    surfaces: Surfaces<S::V>,
    frames: Frames<S::V>,
    throughput: V3<S::V>,
    roulette_scale: S::V,
    /// Random numbers of the directions.
    u: [S::V; 2],
}

/// Departures in the registers.
struct Departures<V> {
    /// Lanes that continue, and lanes with a valid throughput.
    going: u32,
    valid: u32,
    throughput: V3<V>,
    pdf: V,
    position: V3<V>,
    origin: V3<V>,
    dir: V3<V>,
}

impl<'a, S: Simd> Departing<'a, S> {
    #[inline(always)]
    fn load(simd: S, vertices: &'a Vertices, points: &PointLanes, paths: &PathLanes) -> Self {
        let surfaces = Surfaces::load(simd, points);
        Self {
            vertices,
            frames: Frames::from_normal(simd, surfaces.facing),
            surfaces,
            throughput: paths.throughput.load(simd),
            roulette_scale: simd.load(&paths.roulette_scale.0),
            u: vertices.direction_numbers.next_2d(simd),
        }
    }

    /// Samples directions, and performs Russian roulette.
    /// - `shift`: shift of the random numbers of a copy.
    #[inline(always)]
    fn depart(&self, simd: S, shift: Option<[f32; 2]>) -> Departures<S::V> {
        let Self { vertices, surfaces, frames, .. } = self;
        let mut u = self.u;
        if let Some(shift) = shift {
            u = [shifted(simd, u[0], shift[0]), shifted(simd, u[1], shift[1])];
        }
        let mut wi = simd.cosine_hemisphere(u);
        let mut pdf = simd.abs(wi.z) * simd.splat(FRAC_1_PI);
        let mut weight = vertices.reflectance.load(simd);
        if vertices.rough.used != 0 {
            let is_rough = simd.mask(vertices.rough.used);
            let rough = RoughSurfaces::new(simd, &vertices.rough, vertices.wo.load(simd));
            let mut choice = vertices.lobe_numbers.next_1d(simd);
            if let Some(shift) = shift {
                choice = shifted(simd, choice, shift[1]);
            }
            let sampled = rough.sample(u, choice);
            wi = sampled.0.or_else(is_rough, wi);
            weight = sampled.1.or_else(is_rough, weight);
            pdf = is_rough.select(sampled.2, pdf);
        }
        let dir = frames.to_world(wi);
        let throughput = self.throughput * weight;
        let valid = simd.finite(throughput.x) & simd.finite(throughput.y) & simd.finite(throughput.z);
        let mut going = valid & simd.is_positive(pdf).signs() & surfaces.sides_agree(simd, wi.z, dir);
        // Russian roulette.
        let most = throughput.max_element();
        let is_left = simd.is_positive(most);
        going &= is_left.signs();
        let q = (most * self.roulette_scale / simd.splat(RR_THRESHOLD)).min(simd.splat(1.0));
        let may_end = is_left & simd.mask(vertices.is_long) & q.lt(simd.splat(1.0));
        if may_end.signs() & going & vertices.used != 0 {
            let number = vertices.roulette_numbers.next_1d(simd);
            going &= !(may_end.signs() & q.le(number).signs());
        }
        Departures {
            going,
            valid,
            throughput: throughput.over(may_end.select(q, simd.splat(1.0))),
            pdf,
            position: surfaces.position,
            origin: simd.offset_origin(surfaces.position, surfaces.error, surfaces.normal, dir),
            dir,
        }
    }
}

impl<V: Vector> Departures<V> {
    /// Sets the next rays of the paths in the lanes of a mask.
    #[inline(always)]
    fn store<S: Simd<V = V>>(&self, simd: S, mask: V, paths: &mut PathLanes) {
        paths.throughput.replace(simd, mask, self.throughput);
        paths.pdf.replace(simd, mask, self.pdf);
        paths.previous.replace(simd, mask, self.position);
        paths.origin.replace(simd, mask, self.origin);
        paths.dir.replace(simd, mask, self.dir);
    }
}

/// Shifts random numbers in [0, 1): `wrapped`.
#[inline(always)]
fn shifted<S: Simd>(simd: S, numbers: S::V, shift: f32) -> S::V {
    let one = simd.splat(1.0);
    let sum = numbers + simd.splat(shift);
    one.le(sum).select(sum - one, sum).min(simd.splat(1.0 - f32::EPSILON / 2.0))
}
