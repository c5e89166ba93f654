//! Tests of the whole crate. Seeds are fixed; random scenes come from [`Random`].

mod instances;
mod portable;
mod shapes;
mod triangles;

use crate::{Aabb, Blas, Cull, InstanceInput, Pose, Ray, ShapeInput, TriangleInput, World};
use femc_math::{
    elementary::sin_cos,
    glam::{Affine3A, Vec3A},
};
use std::sync::Arc;

/// Random number generator (splitmix).
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number in [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / 16_777_216.0
    }

    pub fn between(&mut self, lo: f32, hi: f32) -> f32 {
        lo + (hi - lo) * self.unit()
    }

    pub fn point(&mut self, half: f32) -> Vec3A {
        Vec3A::new(self.between(-half, half), self.between(-half, half), self.between(-half, half))
    }

    pub fn direction(&mut self) -> Vec3A {
        let z = self.between(-1.0, 1.0);
        let (s, c) = sin_cos(std::f32::consts::TAU * self.unit());
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3A::new(r * c, r * s, z).normalize()
    }
}

pub fn triangle(a: Vec3A, b: Vec3A, c: Vec3A) -> TriangleInput {
    TriangleInput { vertices: [a, b, c], cull: Cull::None }
}

/// Returns a world of one group with the identity as its pose.
pub fn world(triangles: Vec<TriangleInput>, shapes: Vec<ShapeInput>) -> World {
    placed_world(triangles, shapes, Affine3A::IDENTITY)
}

pub fn placed_world(triangles: Vec<TriangleInput>, shapes: Vec<ShapeInput>, pose: Affine3A) -> World {
    let blas = Arc::new(Blas::build(triangles, shapes));
    World::build(vec![InstanceInput { blas, pose: Pose::Fixed(pose) }])
}

/// Returns a closed mesh: a bumpy sphere about 0, counter-clockwise seen from outside.
pub fn bumpy_sphere(rows: usize, columns: usize, radius: f32) -> Vec<TriangleInput> {
    let at = |i: usize, j: usize| {
        // The poles are exact, so that all triangles there share one vertex.
        let (sin_t, cos_t) = match i {
            0 => (0.0, 1.0),
            _ if i == rows => (0.0, -1.0),
            _ => sin_cos(std::f32::consts::PI * i as f32 / rows as f32),
        };
        let (sin_p, cos_p) = sin_cos(std::f32::consts::TAU * (j % columns) as f32 / columns as f32);
        let bump = 1.0 + 0.1 * sin_cos(7.0 * sin_t * cos_p).0 * sin_cos(5.0 * cos_t + 3.0 * sin_t * sin_p).0;
        Vec3A::new(sin_t * cos_p, sin_t * sin_p, cos_t) * (radius * bump)
    };
    let mut triangles = Vec::new();
    for i in 0..rows {
        for j in 0..columns {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            if i + 1 < rows {
                triangles.push(triangle(a, b, c));
            }
            if i > 0 {
                triangles.push(triangle(a, c, d));
            }
        }
    }
    triangles
}

/// Returns triangles of mixed sizes.
pub fn soup(random: &mut Random, count: usize) -> Vec<TriangleInput> {
    (0..count)
        .map(|i| {
            let center = random.point(3.0);
            let size = if i % 17 == 0 { 2.0 } else { 0.2 };
            let mut vertex = || center + random.point(size);
            let (a, b, c) = (vertex(), vertex(), vertex());
            TriangleInput { vertices: [a, b, c], cull: if i % 3 == 0 { Cull::Back } else { Cull::None } }
        })
        .collect()
}

/// Returns a ray from around `bounds` to a point in it.
pub fn ray_at(random: &mut Random, bounds: &Aabb) -> Ray {
    let scale = bounds.size().max_element();
    let origin = bounds.center() + random.point(scale);
    let target = bounds.center() + random.point(0.5) * bounds.size();
    Ray::new(origin, (target - origin).normalize())
}
