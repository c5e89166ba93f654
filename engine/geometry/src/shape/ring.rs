use super::{CrossingFilter, NearestPoint, Span, angle_fraction_about};
use femc_math::glam::DVec3;

/// Returns the crossing of the annulus about 0 between the two radii.
#[inline]
pub(super) fn intersect(
    origin: DVec3,
    dir: DVec3,
    normal: DVec3,
    [inner, outer]: [f64; 2],
    span: Span,
    crossings: CrossingFilter,
) -> Option<f64> {
    let slope = normal.dot(dir);
    let t = -normal.dot(origin) / slope;
    if !span.contains(t) || !crossings.admits(slope) {
        return None;
    }
    let squared = (origin + dir * t).length_squared();
    (squared >= inner * inner && squared <= outer * outer).then_some(t)
}

pub(super) fn nearest(p: DVec3, center: DVec3, normal: DVec3, [inner, outer]: [f64; 2]) -> NearestPoint {
    let n = normal.normalize();
    let q = p - center;
    let flat = q - n * q.dot(n);
    let v = ((flat.length() - inner) / (outer - inner)).clamp(0.0, 1.0);
    NearestPoint { position: center + flat, normal: n, uv: [angle_fraction_about(n, flat), v] }
}
