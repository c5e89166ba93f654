//! Paths of the lanes between two rays, and their beginning at the camera.

use super::vectors::{FloatLanes, V3, VectorLanes};
use femc_geometry::RayLanes;
use femc_math::Rgb;
use femc_prepared::camera::View;
use femc_simd::{Kernel, Lanes, Simd, Vector, WIDTH};

/// Parts of the paths that change at each vertex. The others are in [`PathState`](crate::path_state::PathState).
#[derive(Default)]
pub struct PathLanes {
    /// Lanes whose segment begins at a vertex that was scattered in lanes.
    pub scattered: u32,
    /// Positions of those vertices, and the densities of the segments' directions, 1/sr.
    pub previous: VectorLanes,
    pub pdf: FloatLanes,
    /// Rays to trace next.
    pub origin: VectorLanes,
    pub dir: VectorLanes,
    pub time: FloatLanes,
    pub throughput: VectorLanes,
    /// Light so far, cd/m2.
    pub color: VectorLanes,
    pub roulette_scale: FloatLanes,
}

impl PathLanes {
    /// Begins a path with the throughput 1.
    #[inline(always)]
    pub fn begin(&mut self, lane: usize) {
        self.scattered &= !(1 << lane);
        self.throughput.set(lane, Rgb::ONE);
        self.color.set(lane, Rgb::ZERO);
        self.roulette_scale.set(lane, 1.0);
    }

    /// Continues the path of a lane as one of `other`, which was scattered in lanes.
    #[inline(always)]
    pub fn copy_lane(&mut self, lane: usize, other: &Self) {
        self.scattered |= 1 << lane;
        self.previous.set(lane, other.previous.get(lane));
        self.pdf.set(lane, other.pdf.get(lane));
        self.origin.set(lane, other.origin.get(lane));
        self.dir.set(lane, other.dir.get(lane));
        self.throughput.set(lane, other.throughput.get(lane));
        self.roulette_scale.set(lane, other.roulette_scale.get(lane));
    }

    /// Returns the next rays.
    #[inline(always)]
    pub fn rays(&self) -> RayLanes<'_> {
        const INFINITE: &Lanes = &Lanes([f32::INFINITY; WIDTH]);
        RayLanes { origin: &self.origin.0, dir: &self.dir.0, t_max: INFINITE, time: &self.time.0 }
    }
}

/// Computes the rays of paths that begin.
pub struct CameraRays<'a> {
    /// View of a camera at rest without a lens.
    pub view: &'a View,
    /// Lanes of the paths.
    pub lanes: u32,
    /// Positions on the film, pixels.
    pub film: &'a [FloatLanes; 2],
    pub paths: &'a mut PathLanes,
}

impl Kernel for CameraRays<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { view, lanes, film: [x, y], paths } = self;
        let begins = simd.mask(lanes);
        let [right, down] = view.steps;
        let x = simd.load(&x.0) - simd.splat(view.middle[0]);
        let y = simd.load(&y.0) - simd.splat(view.middle[1]);
        let dir = V3::splat(simd, view.toward) + V3::splat(simd, right).scale(x) + V3::splat(simd, down).scale(y);
        let dir = dir.over(dir.dot(dir).sqrt());
        paths.dir.replace(simd, begins, dir);
        paths.origin.replace(simd, begins, V3::splat(simd, view.origin));
    }
}
