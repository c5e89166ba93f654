use super::{CrossingFilter, Span};
use femc_math::glam::DVec3;

/// Returns the first crossing of the sphere of `radius` about 0. The discriminant is computed at the point of closest approach
/// (\[haines2019\]), which keeps its accuracy for distant and for huge spheres.
#[inline]
pub(super) fn intersect(origin: DVec3, dir: DVec3, radius: f64, span: Span, crossings: CrossingFilter) -> Option<f64> {
    let a = dir.length_squared();
    let b = -origin.dot(dir);
    let closest = origin + dir * (b / a);
    let discriminant = radius * radius - closest.length_squared();
    if discriminant < 0.0 {
        return None;
    }
    let c = origin.length_squared() - radius * radius;
    let q = b + (a * discriminant).sqrt().copysign(b);
    let (near, far) = if b > 0.0 { (c / q, q / a) } else { (q / a, c / q) };
    [(near, -1.0), (far, 1.0)]
        .into_iter()
        .find(|&(t, slope)| span.contains(t) && crossings.admits(slope))
        .map(|(t, _)| t)
}
