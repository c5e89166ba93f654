//! Points that the rays of the lanes hit.

use super::paths::PathLanes;
use super::vectors::{FloatLanes, Functions, V3, VectorLanes};
use femc_geometry::Hit;
use femc_math::gamma;
use femc_math::glam::{Vec2, Vec3A};
use femc_prepared::compile::NONE;
use femc_prepared::{FlatTriangle, ShadingPoint};
use femc_simd::{Kernel, Simd, Vector, WIDTH};

/// Points that the rays of the lanes hit, before their paths are scattered there.
pub struct PointLanes {
    /// Lanes with a point.
    pub used: u32,
    /// Lanes with a point of a flat triangle.
    flat: u32,
    /// Lanes whose rays hit the back side.
    pub back: u32,
    /// Lanes in which the viewer is on the side of the shading frame's normal.
    pub agree: u32,
    pub position: VectorLanes,
    pub error: VectorLanes,
    /// Geometric normals on the front side.
    pub normal: VectorLanes,
    /// Shading normals on the front side.
    shading: VectorLanes,
    /// Normals of the shading frames, on the side of the path.
    pub facing: VectorLanes,
    vertices: [VectorLanes; 3],
    weights: [FloatLanes; 2],
    /// Hits of the rays.
    pub hits: [Hit; WIDTH],
    uv: [Vec2; WIDTH],
    materials: [u32; WIDTH],
    lights: [u32; WIDTH],
}

impl Default for PointLanes {
    fn default() -> Self {
        let none = VectorLanes::default();
        Self {
            used: 0,
            flat: 0,
            back: 0,
            agree: 0,
            position: none,
            error: none,
            normal: none,
            shading: none,
            facing: none,
            vertices: [none; 3],
            weights: [FloatLanes::default(); 2],
            hits: [Hit { t: 0.0, instance: 0, primitive: 0, u: 0.0, v: 0.0 }; WIDTH],
            uv: [Vec2::ZERO; WIDTH],
            materials: [0; WIDTH],
            lights: [NONE; WIDTH],
        }
    }
}

impl PointLanes {
    /// Removes all points.
    #[inline(always)]
    pub fn clear(&mut self) {
        (self.used, self.flat) = (0, 0);
    }

    /// Adds the hit of a lane, on a flat triangle.
    #[inline(always)]
    pub fn add_flat(&mut self, lane: usize, triangle: FlatTriangle<'_>) {
        let hit = self.hits[lane % WIDTH];
        self.used |= 1 << lane;
        self.flat |= 1 << lane;
        for (vertices, vertex) in self.vertices.iter_mut().zip(triangle.vertices) {
            vertices.set(lane, Vec3A::from_array(*vertex));
        }
        self.weights[0].set(lane, hit.u);
        self.weights[1].set(lane, hit.v);
        self.materials[lane % WIDTH] = triangle.material;
        self.lights[lane % WIDTH] = triangle.light;
    }

    /// Adds the hit of a lane, at another point.
    #[inline(always)]
    pub fn add(&mut self, lane: usize, point: &ShadingPoint) {
        self.used |= 1 << lane;
        self.position.set(lane, point.position);
        self.error.set(lane, point.error);
        self.normal.set(lane, point.normal);
        self.shading.set(lane, point.shading_normal);
        self.uv[lane % WIDTH] = point.uv;
        self.materials[lane % WIDTH] = point.material;
        self.lights[lane % WIDTH] = point.light;
    }

    /// Returns the index of a point's material.
    #[inline(always)]
    pub fn material(&self, lane: usize) -> u32 {
        self.materials[lane % WIDTH]
    }

    /// Returns the index of a point's light, or `NONE`.
    #[inline(always)]
    pub fn light(&self, lane: usize) -> u32 {
        self.lights[lane % WIDTH]
    }

    /// Returns the texture coordinates of a point.
    #[inline(always)]
    pub fn uv(&self, lane: usize) -> Vec2 {
        if self.flat >> lane & 1 == 1 { Vec2::ZERO } else { self.uv[lane % WIDTH] }
    }

    /// Returns the hit of a lane, and its point.
    pub fn point(&self, lane: usize) -> (Hit, ShadingPoint) {
        let hit = self.hits[lane % WIDTH];
        let point = ShadingPoint {
            position: self.position.get(lane),
            error: self.error.get(lane),
            normal: self.normal.get(lane),
            shading_normal: self.shading.get(lane),
            uv: self.uv(lane),
            parametric: [hit.u, hit.v],
            material: self.material(lane),
            light: self.light(lane),
        };
        (hit, point)
    }
}

/// Computes the points of flat triangles, and the normals on the sides of the paths.
pub struct FindPoints<'a> {
    pub points: &'a mut PointLanes,
    pub paths: &'a PathLanes,
}

impl Kernel for FindPoints<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { points, paths } = self;
        let is_flat = simd.mask(points.flat);
        let [a, b, c] = &points.vertices;
        let triangle = [a.load(simd), b.load(simd), c.load(simd)];
        let weights = [simd.load(&points.weights[0].0), simd.load(&points.weights[1].0)];
        let flat = triangle_interaction(simd, triangle, weights);
        let normal = flat.normal.or_else(is_flat, points.normal.load(simd));
        let shading = flat.normal.or_else(is_flat, points.shading.load(simd));
        points.position.replace(simd, is_flat, flat.position);
        points.error.replace(simd, is_flat, flat.error);
        let dir = paths.dir.load(simd);
        let is_back = simd.is_positive(normal.dot(dir));
        let facing = shading.negated(simd).or_else(is_back, shading);
        points.back = is_back.signs();
        points.agree = !dir.negated(simd).dot(facing).le(simd.splat(0.0)).signs();
        points.normal = normal.store();
        points.shading = shading.store();
        points.facing = facing.store();
    }
}

/// Points of flat triangles in the registers.
struct FlatPoints<V> {
    position: V3<V>,
    error: V3<V>,
    normal: V3<V>,
}

/// `femc_geometry::triangle_interaction` in lanes.
#[inline(always)]
fn triangle_interaction<S: Simd>(simd: S, [a, b, c]: [V3<S::V>; 3], [u, v]: [S::V; 2]) -> FlatPoints<S::V> {
    let zero = simd.splat(0.0);
    let w = simd.splat(1.0) - u - v;
    let (aw, bu, cv) = (a.scale(w), b.scale(u), c.scale(v));
    let position = aw + bu + cv;
    let magnitude = aw.abs(simd) + bu.abs(simd) + cv.abs(simd);
    let extent = (a - position).abs(simd).max((b - position).abs(simd)).max((c - position).abs(simd));
    let error = magnitude.scale(simd.splat(gamma(7))) + extent.scale(simd.splat(gamma(6)));
    let cross = (b - a).cross(c - a);
    let scale = simd.splat(1.0) / cross.dot(cross).sqrt();
    let is_finite = zero.lt(scale) & scale.lt(simd.splat(f32::INFINITY));
    FlatPoints { position, error, normal: cross.scale(scale).masked(is_finite) }
}
