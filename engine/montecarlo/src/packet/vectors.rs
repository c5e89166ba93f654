//! Vectors in space, one in each lane, and the functions of paths on them.
//!
//! Each function does the operations of its scalar namesake in the same order, so lanes have the same bits.

use femc_math::elementary::ATAN;
use femc_math::glam::Vec3A;
use femc_simd::{Integers, Lanes, Simd, Vector, WIDTH};
use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};
use std::ops::{Add, Mul, Sub};

/// Vectors in memory, by axis.
#[derive(Clone, Copy, Debug)]
pub struct VectorLanes(pub [Lanes; 3]);

impl Default for VectorLanes {
    fn default() -> Self {
        Self([Lanes::ZERO; 3])
    }
}

impl VectorLanes {
    #[inline(always)]
    pub fn set(&mut self, lane: usize, v: Vec3A) {
        let [x, y, z] = &mut self.0;
        (x.0[lane % WIDTH], y.0[lane % WIDTH], z.0[lane % WIDTH]) = (v.x, v.y, v.z);
    }

    #[inline(always)]
    pub fn get(&self, lane: usize) -> Vec3A {
        let [x, y, z] = &self.0;
        Vec3A::new(x.0[lane % WIDTH], y.0[lane % WIDTH], z.0[lane % WIDTH])
    }

    #[inline(always)]
    pub fn load<S: Simd>(&self, simd: S) -> V3<S::V> {
        let [x, y, z] = &self.0;
        V3 { x: simd.load(x), y: simd.load(y), z: simd.load(z) }
    }

    /// Replaces the lanes of a mask.
    #[inline(always)]
    pub fn replace<S: Simd>(&mut self, simd: S, mask: S::V, new: V3<S::V>) {
        *self = new.or_else(mask, self.load(simd)).store();
    }
}

/// Floats in memory.
#[derive(Clone, Copy, Debug)]
pub struct FloatLanes(pub Lanes);

impl Default for FloatLanes {
    fn default() -> Self {
        Self(Lanes::ZERO)
    }
}

impl FloatLanes {
    #[inline(always)]
    pub fn set(&mut self, lane: usize, x: f32) {
        self.0.0[lane % WIDTH] = x;
    }

    #[inline(always)]
    pub fn get(&self, lane: usize) -> f32 {
        self.0.0[lane % WIDTH]
    }

    /// Replaces the lanes of a mask.
    #[inline(always)]
    pub fn replace<S: Simd>(&mut self, simd: S, mask: S::V, new: S::V) {
        self.0 = mask.select(new, simd.load(&self.0)).lanes();
    }
}

/// A vector in each lane.
#[derive(Clone, Copy)]
pub struct V3<V> {
    pub x: V,
    pub y: V,
    pub z: V,
}

impl<V: Vector> V3<V> {
    #[inline(always)]
    pub fn splat<S: Simd<V = V>>(simd: S, v: Vec3A) -> Self {
        Self { x: simd.splat(v.x), y: simd.splat(v.y), z: simd.splat(v.z) }
    }

    #[inline(always)]
    pub fn dot(self, other: Self) -> V {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    #[inline(always)]
    pub fn scale(self, factor: V) -> Self {
        Self { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }

    #[inline(always)]
    pub fn over(self, divisor: V) -> Self {
        Self { x: self.x / divisor, y: self.y / divisor, z: self.z / divisor }
    }

    /// Adds `x` to each coordinate.
    #[inline(always)]
    pub fn plus(self, x: V) -> Self {
        Self { x: self.x + x, y: self.y + x, z: self.z + x }
    }

    /// Keeps the lanes of a mask, and takes the others from `other`.
    #[inline(always)]
    pub fn or_else(self, mask: V, other: Self) -> Self {
        Self { x: mask.select(self.x, other.x), y: mask.select(self.y, other.y), z: mask.select(self.z, other.z) }
    }

    /// Keeps the lanes of a mask; others become 0.
    #[inline(always)]
    pub fn masked(self, mask: V) -> Self {
        Self { x: mask & self.x, y: mask & self.y, z: mask & self.z }
    }

    #[inline(always)]
    pub fn abs<S: Simd<V = V>>(self, simd: S) -> Self {
        Self { x: simd.abs(self.x), y: simd.abs(self.y), z: simd.abs(self.z) }
    }

    #[inline(always)]
    pub fn negated<S: Simd<V = V>>(self, simd: S) -> Self {
        Self { x: simd.negate(self.x), y: simd.negate(self.y), z: simd.negate(self.z) }
    }

    /// Returns the greater coordinates of both.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self { x: self.x.max(other.x), y: self.y.max(other.y), z: self.z.max(other.z) }
    }

    /// Returns the greatest coordinate.
    #[inline(always)]
    pub fn max_element(self) -> V {
        self.x.max(self.y).max(self.z)
    }

    /// `femc_math::cross`.
    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - other.y * self.z,
            y: self.z * other.x - other.z * self.x,
            z: self.x * other.y - other.x * self.y,
        }
    }

    #[inline(always)]
    pub fn store(self) -> VectorLanes {
        VectorLanes([self.x.lanes(), self.y.lanes(), self.z.lanes()])
    }
}

impl<V: Vector> Add for V3<V> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl<V: Vector> Sub for V3<V> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

impl<V: Vector> Mul for V3<V> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self { x: self.x * other.x, y: self.y * other.y, z: self.z * other.z }
    }
}

/// Functions of floats that need constants.
pub trait Functions: Simd {
    #[inline(always)]
    fn abs(self, x: Self::V) -> Self::V {
        x & self.splat(f32::from_bits(0x7fff_ffff))
    }

    #[inline(always)]
    fn negate(self, x: Self::V) -> Self::V {
        x ^ self.splat(-0.0)
    }

    #[inline(always)]
    fn copysign(self, x: Self::V, sign: Self::V) -> Self::V {
        self.abs(x) | (sign & self.splat(-0.0))
    }

    /// Returns the mask of positive lanes.
    #[inline(always)]
    fn is_positive(self, x: Self::V) -> Self::V {
        self.splat(0.0).lt(x)
    }

    /// Returns the bits of finite lanes.
    #[inline(always)]
    fn finite(self, x: Self::V) -> u32 {
        self.abs(x).lt(self.splat(f32::INFINITY)).signs()
    }

    #[inline(always)]
    fn sin_cos_of_octant(self, x: Self::V) -> [Self::V; 2] {
        let x2 = x * x;
        let sin = self.splat(1.0 / 120.0) + x2 * (self.splat(-1.0 / 5040.0) + x2 * self.splat(1.0 / 362_880.0));
        let sin = x + x * x2 * (self.splat(-1.0 / 6.0) + x2 * sin);
        let cos = self.splat(1.0 / 24.0) + x2 * (self.splat(-1.0 / 720.0) + x2 * self.splat(1.0 / 40_320.0));
        let cos = self.splat(1.0) - self.splat(0.5) * x2 + x2 * x2 * cos;
        [sin, cos]
    }

    #[inline(always)]
    fn sin_cos_of_turns(self, turns: Self::V) -> [Self::V; 2] {
        let round = self.splat(1.5 * 8_388_608.0);
        let shifted = self.splat(4.0) * turns + round;
        let quarter = self.bits(shifted);
        let [sin, cos] = self.sin_cos_of_octant((turns - self.splat(0.25) * (shifted - round)) * self.splat(TAU));
        let odd = self.with_bits(quarter.shifted_up::<31>());
        let (a, b) = (odd.select(cos, sin), odd.select(sin, cos));
        [self.flip(a, quarter), self.flip(b, quarter.plus(quarter.constant(1)))]
    }

    /// Changes the sign where bit 1 of `negative` is set.
    #[inline(always)]
    fn flip(self, x: Self::V, negative: Self::I) -> Self::V {
        x ^ self.with_bits(negative.and(negative.constant(2)).shifted_up::<30>())
    }

    #[inline(always)]
    fn fast_atan2(self, y: Self::V, x: Self::V) -> Self::V {
        let (ax, ay) = (self.abs(x), self.abs(y));
        let ratio = ax.min(ay) / ax.max(ay);
        let r2 = ratio * ratio;
        let mut sum = self.splat(0.0);
        for factor in ATAN.iter().rev() {
            sum = sum * r2 + self.splat(*factor);
        }
        let angle = ratio * sum;
        let angle = ax.lt(ay).select(self.splat(FRAC_PI_2) - angle, angle);
        let angle = x.lt(self.splat(0.0)).select(self.splat(PI) - angle, angle);
        self.copysign(angle, y)
    }

    /// `warp::cosine_hemisphere`.
    #[inline(always)]
    fn cosine_hemisphere(self, u: [Self::V; 2]) -> V3<Self::V> {
        let zero = self.splat(0.0);
        let a = self.splat(2.0) * u[0] - self.splat(1.0);
        let b = self.splat(2.0) * u[1] - self.splat(1.0);
        let along_x = self.abs(b).lt(self.abs(a));
        let (most, least) = (along_x.select(a, b), along_x.select(b, a));
        let ratio = most.equal(zero).select(zero, least / most);
        let [sin, cos] = self.sin_cos_of_octant(self.splat(FRAC_PI_4) * ratio);
        let (along, across) = (most * cos, most * sin);
        let (x, y) = (along_x.select(along, across), along_x.select(across, along));
        V3 { x, y, z: (self.splat(1.0) - (x * x + y * y)).max(zero).sqrt() }
    }

    /// `offset_origin`.
    #[inline(always)]
    fn offset_origin(
        self,
        position: V3<Self::V>,
        error: V3<Self::V>,
        normal: V3<Self::V>,
        dir: V3<Self::V>,
    ) -> V3<Self::V> {
        let zero = self.splat(0.0);
        let distance = normal.abs(self).dot(error);
        let offset = normal.scale(dir.dot(normal).lt(zero).select(self.negate(distance), distance));
        let moved = position + offset;
        V3 { x: self.away(moved.x, offset.x), y: self.away(moved.y, offset.y), z: self.away(moved.z, offset.z) }
    }

    #[inline(always)]
    fn away(self, moved: Self::V, offset: Self::V) -> Self::V {
        let zero = self.splat(0.0);
        let step = self.abs(moved) * self.splat(f32::EPSILON) + self.splat(f32::MIN_POSITIVE);
        moved + offset.equal(zero).select(zero, self.copysign(step, offset))
    }
}

impl<S: Simd> Functions for S {}

/// Frames about normals: `femc_math::Frame`.
#[derive(Clone, Copy)]
pub struct Frames<V> {
    tangent: V3<V>,
    bitangent: V3<V>,
    normal: V3<V>,
}

impl<V: Vector> Frames<V> {
    #[inline(always)]
    pub fn from_normal<S: Simd<V = V>>(simd: S, normal: V3<V>) -> Self {
        let one = simd.splat(1.0);
        let sign = simd.copysign(one, normal.z);
        let a = simd.splat(-1.0) / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: V3 { x: one + sign * normal.x * normal.x * a, y: sign * b, z: simd.negate(sign) * normal.x },
            bitangent: V3 { x: b, y: sign + normal.y * normal.y * a, z: simd.negate(normal.y) },
            normal,
        }
    }

    #[inline(always)]
    pub fn to_local(self, v: V3<V>) -> V3<V> {
        V3 { x: v.dot(self.tangent), y: v.dot(self.bitangent), z: v.dot(self.normal) }
    }

    #[inline(always)]
    pub fn to_world(self, v: V3<V>) -> V3<V> {
        self.tangent.scale(v.x) + self.bitangent.scale(v.y) + self.normal.scale(v.z)
    }
}
