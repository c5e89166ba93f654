//! Conversion of a hit to a surface point for shading.

use crate::compile::{NONE, Primitive};
use crate::frame::Prepared;
use crate::material::mapped_normal;
use femc_geometry::{Hit, Ray};
use femc_math::glam::{Vec2, Vec3, Vec3A};

/// A point on a surface, prepared frame.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint {
    /// Position, m.
    pub position: Vec3A,
    /// Absolute error bound of the position per axis, m.
    pub error: Vec3A,
    /// Geometric normal, unit, on the front side.
    pub normal: Vec3A,
    /// Shading normal, unit, on the front side.
    pub shading_normal: Vec3A,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Parametric coordinates of the hit, as light sources use them.
    pub parametric: [f32; 2],
    /// Index of the material.
    pub material: u32,
    /// Index of the light, or `NONE`.
    pub light: u32,
}

/// A flat triangle in the prepared frame. The hit alone determines its points ([`triangle_interaction`]).
///
/// [`triangle_interaction`]: femc_geometry::triangle_interaction
#[derive(Clone, Copy, Debug)]
pub struct FlatTriangle<'a> {
    /// Vertices, m.
    pub vertices: &'a [[f32; 3]; 3],
    /// Index of the material.
    pub material: u32,
    /// Index of the light, or `NONE`.
    pub light: u32,
}

impl Prepared {
    /// Returns the triangle of a hit, if it is flat and does not need the pose of its instance.
    #[inline(always)]
    pub fn flat_triangle(&self, hit: &Hit) -> Option<FlatTriangle<'_>> {
        let (primitive, light) = self.primitive(hit);
        if primitive.corners != NONE {
            return None;
        }
        let vertices = self.world.world_triangle(hit)?;
        Some(FlatTriangle { vertices, material: primitive.material, light })
    }

    /// Returns the data of the primitive of a hit, and the index of its light or `NONE`.
    #[inline(always)]
    fn primitive(&self, hit: &Hit) -> (Primitive, u32) {
        let instance = &self.instances[hit.instance as usize];
        let primitive = instance.compiled.primitives[hit.primitive as usize];
        (primitive, if primitive.emitter == NONE { NONE } else { instance.first_light + primitive.emitter })
    }

    /// Returns the surface point of a hit.
    #[inline]
    pub fn shading_point(&self, ray: &Ray, hit: &Hit) -> ShadingPoint {
        let geometry = self.world.interaction(ray, hit);
        let (primitive, light) = self.primitive(hit);
        let mut point = ShadingPoint {
            position: geometry.position,
            error: geometry.error,
            normal: geometry.normal,
            shading_normal: geometry.normal,
            uv: Vec2::ZERO,
            parametric: geometry.uv,
            material: primitive.material,
            light,
        };
        if primitive.corners != NONE {
            self.interpolate(ray, hit, &mut point, primitive.corners);
        }
        point
    }

    /// Interpolates normal and texture coordinates over a triangle, and applies a normal map.
    fn interpolate(&self, ray: &Ray, hit: &Hit, point: &mut ShadingPoint, corners: u32) {
        let instance = &self.instances[hit.instance as usize];
        let corners = &instance.compiled.corners[corners as usize];
        let b = [1.0 - hit.u - hit.v, hit.u, hit.v];
        point.uv = corners.uv[0] * b[0] + corners.uv[1] * b[1] + corners.uv[2] * b[2];
        let local = corners.normals[0] * b[0] + corners.normals[1] * b[1] + corners.normals[2] * b[2];
        // Poses are similarities that do not mirror, so the matrix itself maps directions.
        let pose = self.world.pose_at(hit.instance, ray.time);
        if local != Vec3::ZERO {
            let mapped = pose.transform_vector3a(local.into()).normalize_or_zero();
            if mapped.dot(point.normal) > 1e-3 {
                point.shading_normal = mapped;
            }
        }
        if let Some(map) = self.materials[point.material as usize].map_n
            && let Some(tangent) = self.tangent(hit, corners.uv)
        {
            let tangent = pose.transform_vector3a(tangent);
            let mapped = mapped_normal(point.shading_normal, tangent, &self.textures[map as usize], point.uv);
            if mapped.dot(point.normal) > 1e-3 {
                point.shading_normal = mapped;
            }
        }
    }

    /// Returns the direction of increasing u on the hit triangle, group's frame.
    fn tangent(&self, hit: &Hit, uv: [Vec2; 3]) -> Option<Vec3A> {
        let [a, b, c] = self.instances[hit.instance as usize].compiled.blas.triangle(hit.primitive)?;
        let (e1, e2) = (b - a, c - a);
        let (d1, d2) = (uv[1] - uv[0], uv[2] - uv[0]);
        let determinant = d1.x * d2.y - d2.x * d1.y;
        (determinant != 0.0).then(|| (e1 * d2.y - e2 * d1.y) / determinant)
    }
}
