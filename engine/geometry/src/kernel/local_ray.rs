use crate::tree::{Lanes, WIDTH};
use femc_math::glam::{Affine3A, Vec3A};
use femc_simd::{Integers, Simd, Vector};

/// A ray in the frame of one tree, with precomputed data for the box and triangle tests. The direction need not be unit: `t` is
/// that of the world's ray.
pub(crate) trait RayData: Copy {
    /// Returns a coordinate of the origin.
    fn origin(self, axis: usize) -> f32;
    /// Returns a coordinate of the direction.
    fn dir(self, axis: usize) -> f32;
    /// Returns the inverse of a coordinate of the direction.
    fn inverse(self, axis: usize) -> f32;
    /// Returns the axes permuted so that the direction's largest component is last, with the winding preserved (\[woop2013\]).
    fn axes(self) -> [usize; 3];
    /// Returns a coordinate of the origin along a permuted axis.
    fn permuted_origin(self, axis: usize) -> f32;
    /// Returns a coordinate of the direction along a permuted axis.
    fn permuted_dir(self, axis: usize) -> f32;
    /// Returns the shear that makes the direction parallel to the last permuted axis.
    fn shear(self, axis: usize) -> f32;
    /// Checks whether the frame is a mirror image of the world's.
    fn mirrored(self) -> bool;

    /// Returns 1 if the direction is negative along an axis, where the greatest plane is the near one, otherwise 0.
    #[inline(always)]
    fn near(self, axis: usize) -> usize {
        (self.dir(axis).to_bits() >> 31) as usize
    }

    /// Returns the origin and the direction.
    #[inline(always)]
    fn vectors(self) -> [Vec3A; 2] {
        [Vec3A::new(self.origin(0), self.origin(1), self.origin(2)), Vec3A::new(self.dir(0), self.dir(1), self.dir(2))]
    }
}

/// Permutations of the axes: twice the axis of the largest component, plus 1 if that is negative. The last two are not used.
const PERMUTATIONS: [[usize; 3]; 8] =
    [[1, 2, 0], [2, 1, 0], [2, 0, 1], [0, 2, 1], [0, 1, 2], [1, 0, 2], [0, 1, 2], [0, 1, 2]];

/// One ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalRay {
    origin: [f32; 3],
    dir: [f32; 3],
    inverse: [f32; 3],
    axes: [usize; 3],
    shear: [f32; 2],
    mirrored: bool,
}

impl LocalRay {
    #[inline(always)]
    pub fn new(origin: Vec3A, dir: Vec3A) -> Self {
        let inverse = (Vec3A::ONE / dir).to_array();
        let a = dir.abs();
        let z = if a.x > a.y {
            if a.x > a.z { 0 } else { 2 }
        } else if a.y > a.z {
            1
        } else {
            2
        };
        let d = dir.to_array();
        let axes = PERMUTATIONS[2 * z + (d[z].to_bits() >> 31) as usize];
        let scale = inverse[z];
        Self {
            origin: origin.to_array(),
            dir: d,
            inverse,
            axes,
            shear: [d[axes[0]] * scale, d[axes[1]] * scale],
            mirrored: false,
        }
    }

    /// Transforms a world ray into the frame to which `to_local` maps.
    #[inline(always)]
    pub fn transformed(origin: Vec3A, dir: Vec3A, to_local: &Affine3A, mirrored: bool) -> Self {
        let origin = to_local.transform_point3a(origin);
        let dir = to_local.transform_vector3a(dir);
        Self { mirrored, ..Self::new(origin, dir) }
    }
}

impl RayData for &LocalRay {
    #[inline(always)]
    fn origin(self, axis: usize) -> f32 {
        self.origin[axis]
    }
    #[inline(always)]
    fn dir(self, axis: usize) -> f32 {
        self.dir[axis]
    }
    #[inline(always)]
    fn inverse(self, axis: usize) -> f32 {
        self.inverse[axis]
    }
    #[inline(always)]
    fn axes(self) -> [usize; 3] {
        self.axes
    }
    #[inline(always)]
    fn permuted_origin(self, axis: usize) -> f32 {
        self.origin[self.axes[axis]]
    }
    #[inline(always)]
    fn permuted_dir(self, axis: usize) -> f32 {
        self.dir[self.axes[axis]]
    }
    #[inline(always)]
    fn shear(self, axis: usize) -> f32 {
        self.shear[axis]
    }
    #[inline(always)]
    fn mirrored(self) -> bool {
        self.mirrored
    }
}

/// Several rays in the frame of the world.
pub(crate) struct LocalRays {
    origin: [Lanes; 3],
    dir: [Lanes; 3],
    inverse: [Lanes; 3],
    permuted_origin: [Lanes; 3],
    permuted_dir: [Lanes; 3],
    shear: [Lanes; 2],
    /// Bits of the indices into [`PERMUTATIONS`].
    permutation: Lanes,
}

impl LocalRays {
    /// Computes what [`LocalRay::new`] does, in the same order.
    #[inline(always)]
    pub fn new<S: Simd>(simd: S, origin: &[Lanes; 3], dir: &[Lanes; 3]) -> Self {
        let [ox, oy, oz] = [simd.load(&origin[0]), simd.load(&origin[1]), simd.load(&origin[2])];
        let [dx, dy, dz] = [simd.load(&dir[0]), simd.load(&dir[1]), simd.load(&dir[2])];
        let one = simd.splat(1.0);
        let [ix, iy, iz] = [one / dx, one / dy, one / dz];
        let magnitude = simd.splat(f32::from_bits(0x7fff_ffff));
        let [ax, ay, az] = [dx & magnitude, dy & magnitude, dz & magnitude];
        // The axis of the largest component: x, y, or z if both masks are unset.
        let is_x = ay.lt(ax) & az.lt(ax);
        let is_y = ax.le(ay) & az.lt(ay);
        let largest = is_x.select(dx, is_y.select(dy, dz));
        let scale = is_x.select(ix, is_y.select(iy, iz));
        // The next two axes, swapped if the largest component is negative.
        let [od, oo] = [is_x.select(dy, is_y.select(dz, dx)), is_x.select(oy, is_y.select(oz, ox))];
        let [td, to] = [is_x.select(dz, is_y.select(dx, dy)), is_x.select(oz, is_y.select(ox, oy))];
        let [first_dir, second_dir] = [largest.select(td, od), largest.select(od, td)];
        let [first_origin, second_origin] = [largest.select(to, oo), largest.select(oo, to)];
        let bits = simd.bits(largest).shifted_down::<31>();
        let code = |axis: u32| simd.with_bits(bits.constant(2 * axis));
        let axis = is_x.select(code(0), is_y.select(code(1), code(2)));
        Self {
            origin: *origin,
            dir: *dir,
            inverse: [ix.lanes(), iy.lanes(), iz.lanes()],
            permuted_origin: [
                first_origin.lanes(),
                second_origin.lanes(),
                is_x.select(ox, is_y.select(oy, oz)).lanes(),
            ],
            permuted_dir: [first_dir.lanes(), second_dir.lanes(), largest.lanes()],
            shear: [(first_dir * scale).lanes(), (second_dir * scale).lanes()],
            permutation: simd.with_bits(simd.bits(axis).plus(bits)).lanes(),
        }
    }

    /// Returns the ray of a lane.
    #[inline(always)]
    pub fn ray(&self, lane: usize) -> LaneRay<'_> {
        LaneRay { rays: self, lane: lane % WIDTH }
    }
}

/// One of several rays.
#[derive(Clone, Copy)]
pub(crate) struct LaneRay<'a> {
    rays: &'a LocalRays,
    lane: usize,
}

impl RayData for LaneRay<'_> {
    #[inline(always)]
    fn origin(self, axis: usize) -> f32 {
        self.rays.origin[axis].0[self.lane % WIDTH]
    }
    #[inline(always)]
    fn dir(self, axis: usize) -> f32 {
        self.rays.dir[axis].0[self.lane % WIDTH]
    }
    #[inline(always)]
    fn inverse(self, axis: usize) -> f32 {
        self.rays.inverse[axis].0[self.lane % WIDTH]
    }
    #[inline(always)]
    fn axes(self) -> [usize; 3] {
        PERMUTATIONS[self.rays.permutation.0[self.lane % WIDTH].to_bits() as usize & 7]
    }
    #[inline(always)]
    fn permuted_origin(self, axis: usize) -> f32 {
        self.rays.permuted_origin[axis].0[self.lane % WIDTH]
    }
    #[inline(always)]
    fn permuted_dir(self, axis: usize) -> f32 {
        self.rays.permuted_dir[axis].0[self.lane % WIDTH]
    }
    #[inline(always)]
    fn shear(self, axis: usize) -> f32 {
        self.rays.shear[axis].0[self.lane % WIDTH]
    }
    #[inline(always)]
    fn mirrored(self) -> bool {
        false
    }
}
