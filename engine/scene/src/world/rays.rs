//! Rays against the placed surfaces of a [`Scope`].

use super::Scope;
use crate::description::{Facing, Location, Material, MaterialId, Shape, Sides};
use femc_math::glam::DVec3;

/// A ray. The direction has unit length.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub origin: DVec3,
    pub dir: DVec3,
    /// Greatest distance of a hit, m.
    pub far: f64,
}

/// Hit of a ray on a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// Distance, m.
    pub distance: f64,
    /// Unit normal on the front side.
    pub normal: DVec3,
    pub material: MaterialId,
    pub location: Location,
}

impl Hit {
    /// Returns whether the ray hits the front side.
    pub fn is_front(&self, ray: &Ray) -> bool {
        self.normal.dot(ray.dir) < 0.0
    }

    pub fn material<'a>(&self, scope: &Scope<'a>) -> Option<&'a Material> {
        scope.scene.materials.get(self.material.index())
    }

    /// Returns whether the surface is invisible to the ray: one-sided, hit from behind, and not the boundary of a solid.
    pub fn is_invisible(&self, scope: &Scope<'_>, ray: &Ray) -> bool {
        let invisible = |material: &Material| material.sides == Sides::One && material.ior.is_none();
        !self.is_front(ray) && self.material(scope).is_some_and(invisible)
    }

    /// Returns whether some light passes through the surface.
    pub fn lets_through(&self, scope: &Scope<'_>) -> bool {
        scope.lets_through.get(self.material.index()) == Some(&true)
    }
}

impl Scope<'_> {
    /// Returns the distance within which a ray does not hit the surface that it starts on, m.
    pub fn offset(&self) -> f64 {
        1e-9 * self.bounds.magnitude().max(self.bounds.diagonal())
    }

    /// Returns the nearest surface along a ray, regardless of its material.
    pub fn first_hit(&self, ray: &Ray) -> Option<Hit> {
        let near = self.offset();
        let mut nearest: Option<Hit> = None;
        self.tree.visit_along_ray(ray.origin, ray.dir, ray.far, |index, far| {
            let triangle = &self.triangles[index];
            let Some(distance) = triangle_distance(ray, triangle.corners).filter(|t| *t > near && *t < far) else {
                return far;
            };
            let normal = triangle.cross().normalize_or_zero();
            nearest = Some(Hit { distance, normal, material: triangle.material, location: triangle.location });
            distance
        });
        let far = nearest.map_or(ray.far, |hit| hit.distance);
        self.quadric_tree.visit_along_ray(ray.origin, ray.dir, far, |index, far| {
            let quadric = &self.quadrics[index];
            let met = intersections(ray, &quadric.shape).into_iter().flatten().filter(|(t, _)| *t > near && *t < far);
            let Some((distance, normal)) = met.min_by(|a, b| a.0.total_cmp(&b.0)) else { return far };
            nearest = Some(Hit { distance, normal, material: quadric.material, location: quadric.location });
            distance
        });
        nearest
    }
}

/// Returns the distance to a triangle, by Möller and Trumbore (\[moller1997\]).
fn triangle_distance(ray: &Ray, [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let (u, v, from) = (b - a, c - a, ray.origin - a);
    let across = ray.dir.cross(v);
    let determinant = u.dot(across);
    let (x, turned) = (from.dot(across) / determinant, from.cross(u));
    let y = ray.dir.dot(turned) / determinant;
    // For a ray in the plane these values are not finite.
    (x >= 0.0 && y >= 0.0 && x + y <= 1.0).then(|| v.dot(turned) / determinant)
}

/// Returns up to two distances at which a ray hits a shape, each with the normal on the front side.
fn intersections(ray: &Ray, shape: &Shape) -> [Option<(f64, DVec3)>; 2] {
    let facing = |facing: Facing, normal: DVec3| match facing {
        Facing::Outward => normal,
        Facing::Inward => -normal,
    };
    match *shape {
        Shape::Sphere { center, radius, facing: side } => {
            let from = ray.origin - center;
            let roots = roots(1.0, from.dot(ray.dir), from.length_squared() - radius * radius);
            roots.map(|t| t.map(|t| (t, facing(side, (from + t * ray.dir) / radius))))
        }
        Shape::Ring { center, normal, inner, outer } => {
            let t = (center - ray.origin).dot(normal) / ray.dir.dot(normal);
            let away = (ray.origin + t * ray.dir).distance(center);
            [(away >= inner && away <= outer).then_some((t, normal)), None]
        }
        Shape::Cone { start, end, start_radius, end_radius, facing: side } => {
            let length = start.distance(end);
            let axis = (end - start) / length;
            let slope = (end_radius - start_radius) / length;
            let from = ray.origin - start;
            // The radius at height z along the axis is start_radius + slope z; q is the component across the axis.
            let (z, dz) = (from.dot(axis), ray.dir.dot(axis));
            let (q, dq) = (from - z * axis, ray.dir - dz * axis);
            let (r, dr) = (start_radius + slope * z, slope * dz);
            let met = roots(dq.length_squared() - dr * dr, q.dot(dq) - r * dr, q.length_squared() - r * r);
            met.map(|t| {
                let t = t.filter(|t| (0.0..=length).contains(&(z + t * dz)))?;
                let across = (q + t * dq).normalize_or_zero();
                Some((t, facing(side, (across - slope * axis).normalize_or_zero())))
            })
        }
        Shape::Torus { center, axis, major, minor, facing: side } => {
            let surface = |p: DVec3| {
                let from = p - center;
                let z = from.dot(axis);
                let ring = (from - z * axis).normalize_or(axis.any_orthonormal_vector()) * major;
                ((from - ring).length() - minor, (from - ring).normalize_or_zero())
            };
            [
                sphere_trace(ray, center, major + minor, minor, surface).map(|(t, normal)| (t, facing(side, normal))),
                None,
            ]
        }
    }
}

/// Returns the roots of `a t^2 + 2 b t + c`.
fn roots(a: f64, b: f64, c: f64) -> [Option<f64>; 2] {
    let discriminant = b * b - a * c;
    if discriminant < 0.0 || a == 0.0 {
        return [None, None];
    }
    let root = discriminant.sqrt();
    [Some((-b - root) / a), Some((-b + root) / a)]
}

/// Returns the first hit by sphere tracing: the point where the signed distance changes its sign.
fn sphere_trace(
    ray: &Ray,
    center: DVec3,
    reach: f64,
    size: f64,
    surface: impl Fn(DVec3) -> (f64, DVec3),
) -> Option<(f64, DVec3)> {
    let middle = (center - ray.origin).dot(ray.dir);
    let (mut t, end) = ((middle - reach).max(0.0), middle + reach);
    let sign = surface(ray.origin + t * ray.dir).0.signum();
    for _ in 0..256 {
        let (distance, normal) = surface(ray.origin + t * ray.dir);
        if distance * sign <= 1e-9 * size && t > 1e-6 * size {
            return Some((t, normal));
        }
        t += (distance * sign).max(1e-6 * size);
        if t > end {
            return None;
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(origin: [f64; 3], toward: [f64; 3]) -> Ray {
        let (origin, toward) = (DVec3::from_array(origin), DVec3::from_array(toward));
        Ray { origin, dir: (toward - origin).normalize(), far: f64::INFINITY }
    }

    fn meets(shape: Shape, origin: [f64; 3], toward: [f64; 3]) -> Option<(f64, DVec3)> {
        let met = intersections(&ray(origin, toward), &shape);
        met.into_iter().flatten().filter(|(t, _)| *t > 1e-9).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    fn assert_intersection(met: Option<(f64, DVec3)>, distance: f64, normal: [f64; 3]) {
        let (t, n) = met.expect("a hit");
        assert!((t - distance).abs() < 1e-6 && n.abs_diff_eq(DVec3::from_array(normal), 1e-5), "{t} {n}");
    }

    #[test]
    fn rays_meet_every_shape_where_it_is() {
        let (center, facing) = (DVec3::ZERO, Facing::Outward);
        let sphere = Shape::Sphere { center, radius: 1.0, facing };
        assert_intersection(meets(sphere, [3.0, 0.0, 0.0], [0.0; 3]), 2.0, [1.0, 0.0, 0.0]);
        assert_intersection(meets(sphere, [0.0; 3], [0.0, 0.0, 1.0]), 1.0, [0.0, 0.0, 1.0]);
        let (start, end) = (DVec3::ZERO, DVec3::Z * 2.0);
        let cone = Shape::Cone { start, end, start_radius: 2.0, end_radius: 0.0, facing };
        assert_intersection(meets(cone, [5.0, 0.0, 1.0], [0.0, 0.0, 1.0]), 4.0, [0.5f64.sqrt(), 0.0, 0.5f64.sqrt()]);
        assert!(meets(cone, [5.0, 0.0, 2.5], [0.0, 0.0, 2.5]).is_none(), "beyond the tip");
        let ring = Shape::Ring { center, normal: DVec3::Z, inner: 1.0, outer: 2.0 };
        assert_intersection(meets(ring, [1.5, 0.0, 3.0], [1.5, 0.0, 0.0]), 3.0, [0.0, 0.0, 1.0]);
        assert!(meets(ring, [0.5, 0.0, 3.0], [0.5, 0.0, 0.0]).is_none(), "through the hole");
        let torus = Shape::Torus { center, axis: DVec3::Z, major: 2.0, minor: 0.5, facing };
        assert_intersection(meets(torus, [5.0, 0.0, 0.0], [0.0; 3]), 2.5, [1.0, 0.0, 0.0]);
        assert!(meets(torus, [0.0, 0.0, 3.0], [0.0; 3]).is_none(), "through the hole");
    }
}
