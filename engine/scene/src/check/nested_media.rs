//! Media nested deeper than a path carries them.
//!
//! A path keeps a list of the media of the solids that it is inside of. The list is short: it is copied with every ray. Media
//! beyond its length are not seen, so a scene that nests more of them has less fog, ink or glass color than it says.

use super::{Faults, Scope, materials::title};
use crate::{
    FaultKind::NestedMedia,
    Severity::Warning,
    description::{MaterialId, Medium, Shape},
    world::Ray,
};
use femc_math::glam::DVec3;

/// Surfaces that rays are sent through, at most.
const SURFACES: usize = 512;
/// Hits that a ray is followed for.
const HITS: usize = 4096;
/// Direction of the rays: along no axis, so that no ray lies in a wall of most scenes.
const DIRECTION: DVec3 = DVec3::new(0.36, 0.48, 0.8);

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let holds = |material: MaterialId| scope.scene.materials.get(material.index()).is_some_and(|m| m.inside.is_some());
    let triangles = scope.triangles.iter().filter(|triangle| holds(triangle.material));
    let curved = scope.quadrics.iter().filter(|quadric| holds(quadric.material));
    let mut points: Vec<DVec3> = triangles.map(|triangle| triangle.corners.iter().sum::<DVec3>() / 3.0).collect();
    points.extend(curved.map(|quadric| middle(&quadric.shape)));
    if points.len() <= Medium::MOST_NESTED {
        return;
    }
    let step = points.len().div_ceil(SURFACES);
    for point in points.into_iter().step_by(step) {
        if deepest(scope, point, faults) {
            return;
        }
    }
}

/// A point that a ray through the shape goes through.
fn middle(shape: &Shape) -> DVec3 {
    match *shape {
        Shape::Sphere { center, .. } | Shape::Ring { center, .. } => center,
        Shape::Cone { start, end, .. } => 0.5 * (start + end),
        Shape::Torus { center, axis, major, .. } => center + major * axis.any_orthonormal_vector(),
    }
}

/// Follows a ray from outside of the scene through `point`; reports the surface behind which there are too many media.
fn deepest(scope: &Scope<'_>, point: DVec3, faults: &mut Faults) -> bool {
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
        if inside.len() > Medium::MOST_NESTED {
            let message = format!(
                "the medium inside {} is nested in {} others: media beyond {} are not seen",
                title(material),
                Medium::MOST_NESTED,
                Medium::MOST_NESTED
            );
            let advice = "nest fewer solids that have a medium `inside`, or leave the outer ones empty";
            faults.add(Warning, NestedMedia, hit.location, message, advice);
            return true;
        }
    }
    false
}
