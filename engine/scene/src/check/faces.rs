//! Checks for surfaces without area and for non-planar faces.

use super::{Faults, Scope};
use crate::{
    FaultKind::{DegenerateSurface, NonPlanarFace},
    Severity::{Note, Warning},
    description::{Face, Group, Quadric, Shape},
    world::Bounds,
};
use femc_math::glam::DVec3;

/// Area, relative to the squared size, below which a face has no area.
const NO_AREA: f64 = 1e-12;
/// Deviation from the plane, relative to the size, above which a face gets a note.
const OUT_OF_PLANE: f64 = 1e-3;
/// Deviation from the plane, relative to the size, above which a face gets a warning: measured rooms are not bent that much.
const BENT: f64 = 1e-2;

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    for group in &scope.scene.groups {
        group.faces.iter().for_each(|face| check_face(group, face, faults));
        group.quadrics.iter().for_each(|quadric| check_quadric(quadric, faults));
    }
}

fn check_face(group: &Group, face: &Face, faults: &mut Faults) {
    let first = face.first_triangle as usize;
    let triangles = group.triangles.get(first..first + face.triangle_count as usize).unwrap_or_default();
    let corners = || triangles.iter().flatten().map(|&vertex| group.vertices[vertex as usize].position);
    let crosses = triangles.iter().map(|triangle| {
        let [a, b, c] = triangle.map(|vertex| group.vertices[vertex as usize].position);
        (b - a).cross(c - a)
    });
    let (twice_area, cross) =
        crosses.fold((0.0, DVec3::ZERO), |(area, sum), cross| (area + cross.length(), sum + cross));
    let size = Bounds::from_points(corners()).diagonal();
    if twice_area <= NO_AREA * size * size {
        let message = "the face has no area: it is skipped";
        faults.add(Warning, DegenerateSurface, face.location, message, "remove it or move its corners apart");
        return;
    }
    let Some(normal) = cross.try_normalize() else { return };
    let (low, high) = corners()
        .map(|p| normal.dot(p))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), d| (low.min(d), high.max(d)));
    if high - low > OUT_OF_PLANE * size {
        let message = format!(
            "the face is not planar: its corners deviate from a plane by {:.1} % of its size",
            100.0 * (high - low) / size
        );
        let severity = if high - low > BENT * size { Warning } else { Note };
        faults.add(severity, NonPlanarFace, face.location, message, "split it into triangles");
    }
}

fn check_quadric(quadric: &Quadric, faults: &mut Faults) {
    let (what, has_area) = match quadric.shape {
        Shape::Sphere { radius, .. } => ("sphere", radius > 0.0),
        Shape::Cone { start, end, start_radius, end_radius, .. } => {
            ("cone or cylinder", start != end && start_radius.max(end_radius) > 0.0)
        }
        Shape::Ring { inner, outer, .. } => ("ring", outer > inner),
        Shape::Torus { major, minor, .. } => ("torus", major > 0.0 && minor > 0.0),
    };
    if !has_area {
        let message = format!("the {what} has no area: it is skipped");
        faults.add(Warning, DegenerateSurface, quadric.location, message, "remove it or give it a size");
    }
}
