//! Relations of triangles in parallel planes: whether they are parallel, their distance and their overlap.

use crate::world::PlacedTriangle;
use femc_math::glam::{DVec2, DVec3};

/// Cosine beyond which normals count as parallel: 1.4 milliradians.
const PARALLEL: f64 = 1.0 - 1e-6;

/// A triangle with its plane. Triangles without area have no plane.
pub(super) struct Plane {
    pub normal: DVec3,
    pub area: f64,
    corners: [DVec3; 3],
}

impl Plane {
    pub fn from_triangle(triangle: &PlacedTriangle) -> Option<Self> {
        let cross = triangle.cross();
        let length = cross.length();
        let normal = cross / length;
        normal.is_finite().then_some(Self { normal, area: length / 2.0, corners: triangle.corners })
    }

    /// Returns whether the normals are parallel or antiparallel.
    pub fn is_parallel(&self, other: &Self) -> bool {
        self.normal.dot(other.normal).abs() > PARALLEL
    }

    /// Returns the least and greatest signed distance of the other triangle's corners from this plane, along this normal.
    pub fn distances(&self, other: &Self) -> (f64, f64) {
        let d = other.corners.map(|corner| self.normal.dot(corner - self.corners[0]));
        (d[0].min(d[1]).min(d[2]), d[0].max(d[1]).max(d[2]))
    }

    /// Returns the area that both triangles cover, seen along this normal.
    pub fn overlap(&self, other: &Self) -> f64 {
        let x = self.normal.any_orthonormal_vector();
        let y = self.normal.cross(x);
        let flat = |corner: DVec3| {
            let from = corner - self.corners[0];
            DVec2::new(x.dot(from), y.dot(from))
        };
        let clip = self.corners.map(flat);
        let mut polygon = other.corners.map(flat).to_vec();
        for i in 0..3 {
            polygon = clip_half_plane(&polygon, clip[i], clip[(i + 1) % 3]);
        }
        area(&polygon)
    }
}

/// Returns the part of a convex polygon on the left of the line from `a` to `b` (\[sutherland1974\]).
fn clip_half_plane(polygon: &[DVec2], a: DVec2, b: DVec2) -> Vec<DVec2> {
    let side = |p: DVec2| (b - a).perp_dot(p - a);
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (index, &p) in polygon.iter().enumerate() {
        let q = polygon[(index + 1) % polygon.len()];
        let (sp, sq) = (side(p), side(q));
        if sp >= 0.0 {
            kept.push(p);
        }
        if (sp > 0.0 && sq < 0.0) || (sp < 0.0 && sq > 0.0) {
            kept.push(p + (q - p) * (sp / (sp - sq)));
        }
    }
    kept
}

fn area(polygon: &[DVec2]) -> f64 {
    let twice = (0..polygon.len()).map(|i| polygon[i].perp_dot(polygon[(i + 1) % polygon.len()]));
    twice.sum::<f64>().abs() / 2.0
}
