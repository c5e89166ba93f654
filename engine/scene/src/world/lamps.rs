//! Points on the light sources of a scene.

use super::Scope;
use crate::description::{Facing, Material, Shape, Sides};
use femc_math::glam::DVec3;

/// Maximum number of points. If there are more, every n-th is taken.
const POINTS: usize = 256;

/// A point that emits light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LampPoint {
    pub position: DVec3,
    /// Unit normal of the emitting side; `None` if it emits in all directions.
    pub normal: Option<DVec3>,
}

/// Returns whether a material emits light at some time.
pub(crate) fn emits(scope: &Scope<'_>, material: &Material) -> bool {
    let name = format!("material.{}", material.name);
    scope.scene.max_over_time(&name, "ed", material.ed.amount) > 0.0 && material.ed.color.iter().any(|c| *c > 0.0)
}

/// Returns points on all light sources, a bounded number, in the order of the scene.
pub(crate) fn lamp_points(scope: &Scope<'_>) -> Vec<LampPoint> {
    let emits: Vec<bool> = scope.scene.materials.iter().map(|material| emits(scope, material)).collect();
    let side = |position, normal, sides| {
        let front = LampPoint { position, normal: Some(normal) };
        let back = (sides == Sides::Two).then_some(LampPoint { position, normal: Some(-normal) });
        [Some(front), back]
    };
    let mut points = Vec::new();
    for triangle in scope.triangles.iter().filter(|t| emits.get(t.material.index()) == Some(&true)) {
        let [a, b, c] = triangle.corners;
        let sides = scope.scene.materials[triangle.material.index()].sides;
        points.extend(side((a + b + c) / 3.0, triangle.cross().normalize_or_zero(), sides).into_iter().flatten());
    }
    for quadric in scope.quadrics.iter().filter(|q| emits.get(q.material.index()) == Some(&true)) {
        let sides = scope.scene.materials[quadric.material.index()].sides;
        for (position, normal) in shape_points(&quadric.shape) {
            points.extend(side(position, normal, sides).into_iter().flatten());
        }
    }
    points.extend(scope.luminaires.iter().map(|lamp| LampPoint { position: lamp.position, normal: None }));
    let step = points.len().div_ceil(POINTS).max(1);
    points.into_iter().step_by(step).collect()
}

/// Returns some points of a shape with the normals of its front.
fn shape_points(shape: &Shape) -> Vec<(DVec3, DVec3)> {
    let (axis, facing) = match *shape {
        Shape::Sphere { facing, .. } => (DVec3::Z, facing),
        Shape::Cone { start, end, facing, .. } => ((end - start).normalize_or_zero(), facing),
        Shape::Ring { normal, .. } => (normal, Facing::Outward),
        Shape::Torus { axis, facing, .. } => (axis, facing),
    };
    let u = axis.any_orthonormal_vector();
    let v = axis.cross(u);
    let sign = if facing == Facing::Inward { -1.0 } else { 1.0 };
    let around = [u, v, -u, -v];
    match *shape {
        Shape::Sphere { center, radius, .. } => {
            around.into_iter().chain([axis, -axis]).map(|n| (center + radius * n, sign * n)).collect()
        }
        Shape::Cone { start, end, start_radius, end_radius, .. } => {
            let slope = (end_radius - start_radius) / start.distance(end);
            let (middle, radius) = (0.5 * (start + end), 0.5 * (start_radius + end_radius));
            let normal = |n: DVec3| sign * (n - slope * axis).normalize_or_zero();
            around.map(|n| (middle + radius * n, normal(n))).into()
        }
        Shape::Ring { center, normal, inner, outer } => {
            around.map(|n| (center + 0.5 * (inner + outer) * n, normal)).into()
        }
        Shape::Torus { center, major, minor, .. } => around.map(|n| (center + (major + minor) * n, sign * n)).into(),
    }
}
