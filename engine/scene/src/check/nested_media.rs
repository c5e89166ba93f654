//! Checks for media nested deeper than a path can track.
//!
//! A path keeps a list of the media of the solids that it is inside. The list is short because it is copied with every ray. Media
//! beyond its length are ignored, so a scene that nests more of them is rendered with less fog, ink or glass color than it
//! describes.

use super::{Faults, Scope, materials::title};
use crate::{
    FaultKind::NestedMedia,
    Severity::Warning,
    description::{MaterialId, Medium, Shape},
    world::Ray,
};
use femc_math::glam::DVec3;

/// Maximum number of surfaces that rays are sent through.
const SURFACES: usize = 512;
/// Maximum number of hits of one ray.
const HITS: usize = 4096;
/// Direction of the rays. It is along no axis, so in most scenes no ray lies in a wall.
const DIRECTION: DVec3 = DVec3::new(0.36, 0.48, 0.8);

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let holds = |material: MaterialId| scope.scene.materials.get(material.index()).is_some_and(|m| m.inside.is_some());
    let triangles = scope.triangles.iter().filter(|triangle| holds(triangle.material));
    let curved = scope.quadrics.iter().filter(|quadric| holds(quadric.material));
    let mut points: Vec<DVec3> = triangles.map(|triangle| triangle.corners.iter().sum::<DVec3>() / 3.0).collect();
    points.extend(curved.map(|quadric| target_point(&quadric.shape)));
    if points.len() <= Medium::MAX_NESTED {
        return;
    }
    let step = points.len().div_ceil(SURFACES);
    for point in points.into_iter().step_by(step) {
        if report_too_deep(scope, point, faults) {
            return;
        }
    }
}

/// Returns a point such that a ray through it hits the shape.
fn target_point(shape: &Shape) -> DVec3 {
    match *shape {
        Shape::Sphere { center, .. } | Shape::Ring { center, .. } => center,
        Shape::Cone { start, end, .. } => 0.5 * (start + end),
        Shape::Torus { center, axis, major, .. } => center + major * axis.any_orthonormal_vector(),
    }
}

/// Traces a ray from outside the scene through `point`, and reports the surface behind which too many media are nested.
fn report_too_deep(scope: &Scope<'_>, point: DVec3, faults: &mut Faults) -> bool {
    let dir = DIRECTION.normalize();
    let mut ray = Ray { origin: point - 2.0 * scope.bounds.diagonal() * dir, dir, far: f64::INFINITY };
    let mut inside: Vec<u32> = Vec::new();
    for _ in 0..HITS {
        let Some(hit) = scope.first_hit(&ray) else { return false };
        ray.origin += (hit.distance + scope.offset()) * dir;
        let Some(material) = hit.material(scope) else { continue };
        let Some(medium) = material.inside else { continue };
        if !hit.is_front(&ray) {
            if let Some(at) = inside.iter().rposition(|&other| other == medium.0) {
                inside.remove(at);
            }
            continue;
        }
        inside.push(medium.0);
        if inside.len() > Medium::MAX_NESTED {
            let message = format!(
                "the medium inside {} is nested in {} others: only {} nested media are tracked",
                title(material),
                Medium::MAX_NESTED,
                Medium::MAX_NESTED
            );
            let advice = "nest fewer solids that have a medium `inside`, or leave the outer ones empty";
            faults.add(Warning, NestedMedia, hit.location, message, advice);
            return true;
        }
    }
    false
}
