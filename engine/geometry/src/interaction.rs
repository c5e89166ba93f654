use femc_math::{
    cross, gamma,
    glam::{Affine3A, Vec3A},
};

/// A point on a surface, with the data needed to leave it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interaction {
    /// Position, world frame, m.
    pub position: Vec3A,
    /// Absolute bound per axis, m, of the position's error plus the error of a test of a ray from there.
    pub error: Vec3A,
    /// Geometric unit normal on the front side, world frame.
    pub normal: Vec3A,
    /// Barycentric weights of a triangle's second and third vertex, or a shape's parameters.
    pub uv: [f32; 2],
}

/// Returns the point of the triangle `vertices` at barycentric weights `u`, `v` of the second and third vertex, in the triangle's
/// frame.
///
/// The error bound is gamma(7) sum |b_i p_i| for the interpolation, plus gamma(6) times the triangle's extent seen from the point.
/// With this bound, the kernel's sign of `normal . (vertex - origin)` is correct for every origin that
/// [`offset_origin`](crate::offset_origin) returns.
#[inline]
pub fn triangle_interaction(vertices: &[Vec3A; 3], u: f32, v: f32) -> Interaction {
    let [a, b, c] = *vertices;
    let w = 1.0 - u - v;
    let position = a * w + b * u + c * v;
    let magnitude = (a * w).abs() + (b * u).abs() + (c * v).abs();
    let extent = (a - position).abs().max((b - position).abs()).max((c - position).abs());
    let normal = cross(b - a, c - a).normalize_or_zero();
    Interaction { position, error: magnitude * gamma(7) + extent * gamma(6), normal, uv: [u, v] }
}

impl Interaction {
    /// Transforms this point to the parent frame. The error bound grows by the rounding of the map, and by that of the inverse map,
    /// which the next ray from here uses.
    #[inline]
    pub(crate) fn transformed(&self, to_parent: &Affine3A, to_local: &Affine3A) -> Self {
        let position = to_parent.transform_point3a(self.position);
        let absolute = |a: &Affine3A, v: Vec3A| {
            let m = &a.matrix3;
            m.x_axis.abs() * v.x + m.y_axis.abs() * v.y + m.z_axis.abs() * v.z
        };
        let back = (absolute(to_local, position.abs()) + to_local.translation.abs()) * gamma(6);
        let there = (absolute(to_parent, self.position.abs()) + to_parent.translation.abs()) * gamma(4);
        let m = to_parent.matrix3;
        let cofactor = |n: Vec3A| {
            cross(m.y_axis, m.z_axis) * n.x + cross(m.z_axis, m.x_axis) * n.y + cross(m.x_axis, m.y_axis) * n.z
        };
        Self {
            position,
            error: absolute(to_parent, self.error + back) * (1.0 + gamma(4)) + there,
            normal: cofactor(self.normal).normalize_or_zero(),
            uv: self.uv,
        }
    }
}
