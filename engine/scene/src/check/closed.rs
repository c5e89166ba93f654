//! Checks that the boundaries of solids and media are closed, and that no camera is inside one.
//!
//! A surface is a boundary when it is one-sided and either refracts or has a medium inside. Faces are checked edge by edge against
//! all faces of their group. They are not checked where the boundary of an object joins faces and cones. Cones and cylinders are
//! checked rim by rim against the other rims of the group and the faces across them.

use super::{Faults, Scope, materials::title};
use crate::{
    FaultKind::{Camera as CameraFault, OpenBoundary},
    Severity::{Note, Warning},
    description::{Facing, Group, Location, Material, MaterialId, ObjectId, Shape, Sides},
    world::Bounds,
};
use femc_math::{elementary::double::atan2, glam::DVec3};
use std::{collections::BTreeMap, f64::consts::TAU};

/// Distance below which two corners are welded into one, relative to the size of the group.
const WELD: f64 = 1e-6;
/// Number of turns of a boundary around a camera above which the camera is inside; a closed boundary makes 1.
const INSIDE: f64 = 0.75;

/// A point of the welding lattice.
type Lattice = (i64, i64, i64);

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let bounds: Vec<bool> = scope.scene.materials.iter().map(is_boundary).collect();
    if !bounds.contains(&true) {
        return;
    }
    for (group, _) in scope.scene.groups.iter().zip(&scope.placed).filter(|(_, placed)| **placed) {
        let corners = Bounds::from_points(group.vertices.iter().map(|vertex| vertex.position));
        let round = group.quadrics.iter().fold(corners, |bounds, quadric| match quadric.shape {
            Shape::Cone { start, end, .. } => bounds.union(Bounds::from_points([start, end])),
            Shape::Sphere { center, .. } | Shape::Ring { center, .. } | Shape::Torus { center, .. } => {
                bounds.union(Bounds::from_points([center]))
            }
        });
        let step = (WELD * round.magnitude()).max(f64::MIN_POSITIVE);
        open_edges(scope, group, &bounds, step, faults);
        open_rims(scope, group, &bounds, step, faults);
    }
    cameras_inside(scope, &bounds, faults);
}

fn is_boundary(material: &Material) -> bool {
    material.sides == Sides::One && (material.inside.is_some() || (material.ior.is_some() && material.ts.amount > 0.0))
}

fn snap(p: DVec3, step: f64) -> Lattice {
    let at = (p / step).round();
    (at.x as i64, at.y as i64, at.z as i64)
}

/// Reports edges of boundary faces that no other face shares.
fn open_edges(scope: &Scope<'_>, group: &Group, bounds: &[bool], step: f64, faults: &mut Faults) {
    let is_boundary = |material: MaterialId| bounds.get(material.index()) == Some(&true);
    if !group.faces.iter().any(|face| is_boundary(face.material)) {
        return;
    }
    let mut welded: BTreeMap<Lattice, u32> = BTreeMap::new();
    let ids: Vec<u32> = group
        .vertices
        .iter()
        .map(|vertex| {
            let next = welded.len() as u32;
            *welded.entry(snap(vertex.position, step)).or_insert(next)
        })
        .collect();
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(group.triangles.len() * 3);
    for (face, number) in group.faces.iter().zip(0..).filter(|(face, _)| scope.is_shown(face.object)) {
        let first = face.first_triangle as usize;
        for triangle in group.triangles.get(first..first + face.triangle_count as usize).unwrap_or_default() {
            let [a, b, c] = triangle.map(|vertex| ids[vertex as usize]);
            let pairs = [(a, b), (b, c), (c, a)].into_iter().filter(|(a, b)| a != b);
            edges.extend(pairs.map(|(a, b)| (a.min(b), a.max(b), number)));
        }
    }
    edges.sort_unstable();
    let mut open: BTreeMap<(MaterialId, Option<ObjectId>), (usize, Location)> = BTreeMap::new();
    for run in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).filter(|run| run.len() == 1) {
        let face = &group.faces[run[0].2 as usize];
        if is_boundary(face.material) {
            open.entry((face.material, face.object)).or_insert((0, face.location)).0 += 1;
        }
    }
    for ((material, object), (count, location)) in open {
        let is_mixed = group.quadrics.iter().any(|quadric| {
            is_boundary(quadric.material)
                && quadric.object == object
                && matches!(quadric.shape, Shape::Cone { .. } | Shape::Ring { .. })
        });
        if let (false, Some(material)) = (is_mixed, scope.scene.materials.get(material.index())) {
            let edges = if count == 1 { "edge has" } else { "edges have" };
            let message = format!("{} bounds a solid, but {count} {edges} a face on only one side", title(material));
            faults.add(Warning, OpenBoundary, location, message, "close the surface, and make its faces share corners");
        }
    }
}

/// Reports ends of boundary cones and cylinders that nothing closes.
fn open_rims(scope: &Scope<'_>, group: &Group, bounds: &[bool], step: f64, faults: &mut Faults) {
    let mut rims: BTreeMap<(Lattice, i64), u32> = BTreeMap::new();
    let rim = |center: DVec3, radius: f64| (snap(center, step), (radius / step).round() as i64);
    for quadric in &group.quadrics {
        for (center, radius) in rims_of(&quadric.shape).into_iter().flatten() {
            *rims.entry(rim(center, radius)).or_default() += 1;
        }
    }
    for quadric in &group.quadrics {
        let Some(material) = scope.scene.materials.get(quadric.material.index()) else { continue };
        let Shape::Cone { start, end, .. } = quadric.shape else { continue };
        if bounds.get(quadric.material.index()) != Some(&true) {
            continue;
        }
        let axis = (end - start).normalize_or_zero();
        let open = |&(center, radius): &(DVec3, f64)| {
            radius > 0.0 && rims.get(&rim(center, radius)) == Some(&1) && !face_across(group, center, axis, step)
        };
        if rims_of(&quadric.shape).iter().flatten().any(open) {
            let message = format!("{} bounds a solid, but this cone or cylinder has an open end", title(material));
            faults.add(Warning, OpenBoundary, quadric.location, message, "close it with a `ring` of the same radius");
        }
    }
}

/// Returns whether a triangle of the group lies across `axis` at `center`, with `center` inside the triangle's bounds.
fn face_across(group: &Group, center: DVec3, axis: DVec3, step: f64) -> bool {
    group.triangles.iter().any(|triangle| {
        let corners = triangle.map(|vertex| group.vertices[vertex as usize].position);
        let is_level = corners.iter().all(|corner| (*corner - center).dot(axis).abs() <= step);
        is_level && Bounds::from_points(corners).grown(step).overlaps(&Bounds::from_points([center]))
    })
}

/// Returns center and radius of the circles at which a shape ends.
fn rims_of(shape: &Shape) -> [Option<(DVec3, f64)>; 2] {
    match *shape {
        Shape::Cone { start, end, start_radius, end_radius, .. } => {
            [Some((start, start_radius)), Some((end, end_radius))]
        }
        Shape::Ring { center, inner, outer, .. } => [Some((center, outer)), (inner > 0.0).then_some((center, inner))],
        Shape::Sphere { .. } | Shape::Torus { .. } => [None, None],
    }
}

/// Reports cameras that start inside a solid or a bounded medium.
fn cameras_inside(scope: &Scope<'_>, bounds: &[bool], faults: &mut Faults) {
    for camera in &scope.scene.cameras {
        let eye = camera.at(&scope.scene.paths, scope.time).origin;
        let mut turns = vec![0.0; bounds.len()];
        for triangle in scope.triangles.iter().filter(|t| bounds.get(t.material.index()) == Some(&true)) {
            turns[triangle.material.index()] += solid_angle(triangle.corners.map(|corner| corner - eye)) / (2.0 * TAU);
        }
        for sphere in scope.spheres.iter().filter(|s| bounds.get(s.material.index()) == Some(&true)) {
            if eye.distance(sphere.center) < sphere.radius {
                turns[sphere.material.index()] += if sphere.facing == Facing::Outward { 1.0 } else { -1.0 };
            }
        }
        for (material, _) in scope.scene.materials.iter().zip(turns).filter(|(_, turns)| *turns > INSIDE) {
            let message = format!("camera `{}` starts inside a solid of {}", camera.name, title(material));
            faults.add(
                Note,
                CameraFault,
                camera.location,
                message,
                "ignore this if the camera should look out of the solid",
            );
        }
    }
}

/// Returns the signed solid angle of a triangle seen from the origin, sr; positive from behind (\[vanoosterom1983\]).
fn solid_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    2.0 * atan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
}
