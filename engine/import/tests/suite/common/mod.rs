//! Helpers: scenes in memory.
#![allow(dead_code, reason = "each test file uses its part")]

use femc_import::{Bundle, ImportError, LoadedScene, load_scene};
use femc_math::{Transform, glam::DVec3};
use femc_scene::{GroupId, Motion, Scene, Shape};
use std::collections::BTreeMap;

/// Returns a bundle of files by name; the first one is the scene.
pub fn bundle(files: &[(&str, &str)]) -> Bundle {
    Bundle(files.iter().map(|(name, text)| ((*name).to_owned(), text.as_bytes().to_vec())).collect::<BTreeMap<_, _>>())
}

pub fn try_files(files: &[(&str, &str)]) -> Result<LoadedScene, ImportError> {
    load_scene(&bundle(files), files[0].0)
}

pub fn try_scene(text: &str) -> Result<LoadedScene, ImportError> {
    try_files(&[("t.mgf", text)])
}

/// Imports a scene that must have no warnings.
pub fn scene(text: &str) -> Scene {
    let loaded = try_scene(text).unwrap_or_else(|error| panic!("{error}"));
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    loaded.scene
}

/// Four corners a, b, c, d of the unit square in the plane z = 0, counter-clockwise from above.
pub const SQUARE: &str = "v a =\np 0 0 0\nv b =\np 1 0 0\nv c =\np 1 1 0\nv d =\np 0 1 0\n";

/// Returns all triangles in world coordinates (no paths), through all instances.
pub fn world_triangles(scene: &Scene) -> Vec<[DVec3; 3]> {
    let mut found = Vec::new();
    walk(scene, GroupId(0), Transform::IDENTITY, &mut |group, t| {
        let group = &scene.groups[group.index()];
        let corner = |i: u32| t.transform_point3(group.vertices[i as usize].position);
        found.extend(group.triangles.iter().map(|tri| tri.map(corner)));
    });
    found
}

/// Returns the centers of all spheres in world coordinates (no paths), through all instances.
pub fn world_spheres(scene: &Scene) -> Vec<DVec3> {
    let mut found = Vec::new();
    walk(scene, GroupId(0), Transform::IDENTITY, &mut |group, t| {
        for quadric in &scene.groups[group.index()].quadrics {
            if let Shape::Sphere { center, .. } = quadric.shape {
                found.push(t.transform_point3(center));
            }
        }
    });
    found
}

fn walk(scene: &Scene, group: GroupId, to_world: Transform, visit: &mut dyn FnMut(GroupId, Transform)) {
    visit(group, to_world);
    for instance in &scene.groups[group.index()].instances {
        let Motion { .. } = instance.motion;
        let placed = instance.motion.as_static().expect("no path");
        walk(scene, instance.group, to_world * placed, visit);
    }
}

pub fn close(a: DVec3, b: [f64; 3]) -> bool {
    a.abs_diff_eq(DVec3::from_array(b), 1e-9)
}
