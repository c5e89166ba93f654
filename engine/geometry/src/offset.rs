//! Ray origins that leave a surface: the offset follows only from the error bound of the position (\[pharr2023\], 6.8.6).

use crate::Ray;
use femc_math::{gamma, glam::Vec3A};

/// Returns the origin of a ray that leaves the surface point `position` in direction `dir` and cannot hit that surface again.
/// - `error`: absolute bound per axis of the position's error, m (from [`Interaction`](crate::Interaction)).
/// - `normal`: unit; either side. With a zero normal (a point in space) the position is unchanged.
/// - `dir`: direction of the ray; its side of the surface determines the side to which the origin moves.
#[inline]
pub fn offset_origin(position: Vec3A, error: Vec3A, normal: Vec3A, dir: Vec3A) -> Vec3A {
    let distance = normal.abs().dot(error);
    let offset = normal * if dir.dot(normal) < 0.0 { -distance } else { distance };
    let moved = position + offset;
    // The sum may be rounded toward the surface, so it is moved on to the next float or the one after it.
    let step = moved.abs() * f32::EPSILON + Vec3A::splat(f32::MIN_POSITIVE);
    moved + Vec3A::select(offset.cmpeq(Vec3A::ZERO), Vec3A::ZERO, step.copysign(offset))
}

/// Returns the open segment between two surface points, each given by (position, error bound, normal), for shadow rays. It hits the
/// surface of neither end. A point in space has a zero error and a zero normal.
///
/// The far end is also moved by the ray's own error after that distance. So rounding of the direction or of the distance cannot
/// carry the segment through the far surface.
#[inline]
pub fn shadow_segment(from: (Vec3A, Vec3A, Vec3A), to: (Vec3A, Vec3A, Vec3A), time: f32) -> Ray {
    let between = to.0 - from.0;
    let start = offset_origin(from.0, from.1, from.2, between);
    let end = offset_origin(to.0, to.1 + between.abs() * gamma(16), to.2, -between);
    let way = end - start;
    let length = way.length();
    if length > 0.0 {
        Ray { origin: start, dir: way / length, t_max: length, time }
    } else {
        Ray { origin: start, dir: Vec3A::X, t_max: 0.0, time }
    }
}
