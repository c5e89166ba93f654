//! Checks for surfaces that coincide: rounding decides which of them a renderer sees.
//!
//! Placed triangles are paired through a tree of their bounds, so the cost is O(n log n) for meshes. If too many bounds overlap,
//! the search stops and a note says so. Faces back to back (a table leg on the floor) only get a note. Curved surfaces are reported
//! only if they are identical and in the same group.

use super::{Faults, Scope, WHOLE_SCENE, coplanar::Plane, format_location};
use crate::{
    FaultKind::{Incomplete, OverlappingFaces},
    Severity::{Note, Warning},
    description::{Location, MaterialId, Shape},
};
use femc_math::glam::DVec3;
use std::{collections::BTreeMap, ops::ControlFlow};

/// Distance below which two planes count as one, relative to the largest coordinate: single precision cannot tell them apart.
const ONE_PLANE: f64 = 1e-6;
/// Share of the smaller triangle that must be covered.
const MIN_COVERED_SHARE: f64 = 1e-3;
/// Maximum number of pairs of triangles that are compared.
const PAIR_LIMIT: u64 = 50_000_000;
/// Maximum number of pairs of faces that are reported.
const REPORT_LIMIT: usize = 10_000;

/// Relative orientation of the two faces of a pair.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Sense {
    Same,
    Opposite,
}

/// Returns the distance below which two planes count as one, m.
pub(super) fn tolerance(scope: &Scope<'_>) -> f64 {
    ONE_PLANE * scope.bounds.magnitude()
}

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let tolerance = tolerance(scope);
    let mut overlaps: BTreeMap<(Location, Location, Sense), (f64, [MaterialId; 2])> = BTreeMap::new();
    let mut compared = 0;
    let mut outcome = ControlFlow::Continue(());
    for (index, triangle) in scope.triangles.iter().enumerate() {
        let Some(plane) = Plane::from_triangle(triangle) else { continue };
        outcome = scope.tree.visit_overlapping(&triangle.bounds().grown(tolerance), |other| {
            if other <= index || scope.triangles[other].face == triangle.face {
                return ControlFlow::Continue(());
            }
            compared += 1;
            let other = &scope.triangles[other];
            if let Some(found) =
                Plane::from_triangle(other).and_then(|other| coplanar_overlap(&plane, &other, tolerance))
            {
                let (a, b) = (triangle.location, other.location);
                let (first, second, materials) = if a <= b {
                    (a, b, [triangle.material, other.material])
                } else {
                    (b, a, [other.material, triangle.material])
                };
                overlaps.entry((first, second, found.1)).or_insert((0.0, materials)).0 += found.0;
            }
            if compared > PAIR_LIMIT || overlaps.len() > REPORT_LIMIT {
                return ControlFlow::Break(());
            }
            ControlFlow::Continue(())
        });
        if outcome.is_break() {
            break;
        }
    }
    if outcome.is_break() || scope.is_truncated {
        let message = "too many triangles to find all overlapping faces: only the first are listed";
        faults.add(Note, Incomplete, WHOLE_SCENE, message, "check the parts of the scene one by one");
    }
    report_identical_quadrics(scope, faults);
    for ((first, second, sense), (area, materials)) in overlaps {
        report(scope, faults, (first, second), sense, area, materials);
    }
}

/// Reports curved surfaces that occur twice.
fn report_identical_quadrics(scope: &Scope<'_>, faults: &mut Faults) {
    for (group, _) in scope.scene.groups.iter().zip(&scope.placed).filter(|(_, placed)| **placed) {
        let mut first: BTreeMap<[u64; 9], Location> = BTreeMap::new();
        for quadric in group.quadrics.iter().filter(|quadric| scope.is_shown(quadric.object)) {
            if let Some(earlier) = first.get(&bits(&quadric.shape)) {
                let message = format!(
                    "the surface is in the same place as the one at {}",
                    format_location(scope.scene, *earlier)
                );
                faults.add(Warning, OverlappingFaces, quadric.location, message, "remove one of them");
            } else {
                first.insert(bits(&quadric.shape), quadric.location);
            }
        }
    }
}

/// Returns the bits of a shape without its facing; they are equal for equal surfaces.
fn bits(shape: &Shape) -> [u64; 9] {
    let (tag, a, b, c, d) = match *shape {
        Shape::Sphere { center, radius, .. } => (0.0, center, DVec3::ZERO, radius, 0.0),
        Shape::Cone { start, end, start_radius, end_radius, .. } => (1.0, start, end, start_radius, end_radius),
        Shape::Ring { center, normal, inner, outer } => (2.0, center, normal, inner, outer),
        Shape::Torus { center, axis, major, minor, .. } => (3.0, center, axis, major, minor),
    };
    // Adding 0 turns -0 into 0.
    [tag, a.x, a.y, a.z, b.x, b.y, b.z, c, d].map(|value: f64| (value + 0.0).to_bits())
}

/// Returns the area that two triangles in one plane share, if it is more than a seam.
fn coplanar_overlap(a: &Plane, b: &Plane, tolerance: f64) -> Option<(f64, Sense)> {
    let (large, small) = if a.area >= b.area { (a, b) } else { (b, a) };
    let (low, high) = large.distances(small);
    if !large.is_parallel(small) || low < -tolerance || high > tolerance {
        return None;
    }
    let shared = large.overlap(small);
    let sense = if large.normal.dot(small.normal) > 0.0 { Sense::Same } else { Sense::Opposite };
    (shared > MIN_COVERED_SHARE * small.area).then_some((shared, sense))
}

fn report(
    scope: &Scope<'_>,
    faults: &mut Faults,
    (first, second): (Location, Location),
    sense: Sense,
    area: f64,
    materials: [MaterialId; 2],
) {
    let other = if first == second {
        "another copy of itself".into()
    } else {
        format!("the one at {}", format_location(scope.scene, first))
    };
    let bounds_solid = materials.iter().any(|id| {
        scope
            .scene
            .materials
            .get(id.index())
            .is_some_and(|m| m.inside.is_some() || (m.ior.is_some() && m.ts.amount > 0.0))
    });
    let area = format_area(area);
    let (severity, message) = match sense {
        Sense::Same => (Warning, format!("the face overlaps {other} on {area}, both facing the same way")),
        Sense::Opposite if bounds_solid => {
            (Warning, format!("the face overlaps {other} on {area}, and one of them bounds a solid"))
        }
        Sense::Opposite => (Note, format!("the face touches {other} back to back on {area}")),
    };
    let advice = match severity {
        Note => "ignore this unless both faces are visible from the same side",
        _ => "move one of them, or remove the part that is covered",
    };
    faults.add(severity, OverlappingFaces, second, message, advice);
}

fn format_area(area: f64) -> String {
    match area {
        m2 if m2 >= 0.01 => format!("{m2:.2} m2"),
        m2 if m2 >= 1e-5 => format!("{:.1} cm2", m2 * 1e4),
        m2 => format!("{:.2} mm2", m2 * 1e6),
    }
}
