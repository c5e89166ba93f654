//! Affine transforms in double precision, as used in scene descriptions.

use glam::{DAffine3, DMat3, DVec3};

/// An affine map of points, meters to meters; kept in f64 until a frame is prepared.
pub type Transform = DAffine3;

/// Maps the normal `n` by `transform` (inverse transpose, with the determinant's sign, so that a mirror keeps normals consistent
/// with the surface's right-hand orientation). Returns a unit vector, or zero when the map is singular.
pub fn transform_normal(transform: &Transform, n: DVec3) -> DVec3 {
    let m = transform.matrix3;
    let cofactors = DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    (cofactors * n).normalize_or_zero()
}
