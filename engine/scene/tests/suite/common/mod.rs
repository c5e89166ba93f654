//! Small scenes for the tests.
#![allow(dead_code)] // each test file uses some of these

use femc_math::{
    Transform,
    glam::{DQuat, DVec3},
};
use femc_scene::*;

/// Returns a location on a line of the only source file.
pub fn line(line: u32) -> Location {
    Location { file: 0, line, column: 0 }
}

pub fn tinted(amount: f64) -> TintedScalar {
    TintedScalar { amount, ..TintedScalar::default() }
}

pub fn material(name: &str, at: u32) -> Material {
    Material { name: name.into(), location: line(at), rd: tinted(0.5), ..Material::default() }
}

pub fn medium(name: &str, at: u32) -> Medium {
    Medium {
        name: name.into(),
        location: line(at),
        sigma_s: 0.02,
        color: [1.0; 3],
        sigma_a: 0.0,
        absorption_color: [1.0; 3],
        phase: Phase::HenyeyGreenstein { g: 0.5 },
        glow: 0.0,
        glow_color: [1.0; 3],
        density: Density::Uniform,
    }
}

pub fn camera(name: &str, at: u32) -> Camera {
    Camera {
        name: name.into(),
        location: line(at),
        origin: DVec3::new(0.0, -5.0, 1.0),
        target: DVec3::ZERO,
        up: DVec3::Z,
        fov: 40.0,
        film: [64, 36],
        lens_radius: 0.0,
        focus: 5.0,
        shutter_open: 0.0,
        shutter_close: 0.0,
        along: None,
    }
}

pub fn object(name: &str, parent: Option<u32>) -> Object {
    Object { name: name.into(), parent: parent.map(ObjectId), hidden: false }
}

pub fn pose(angle: f64, x: f64, y: f64, z: f64) -> Transform {
    Transform::from_rotation_translation(DQuat::from_rotation_z(angle), DVec3::new(x, y, z))
}

pub fn path(name: &str, at: u32, interpolation: Interpolation, keys: &[(f64, Transform)]) -> MotionPath {
    let keys = keys.iter().map(|&(time, pose)| Key { time, pose }).collect();
    MotionPath { name: name.into(), location: line(at), interpolation, keys }
}

/// Adds a face (a fan of its corners) to a group.
pub fn add_face(group: &mut Group, corners: &[[f64; 3]], material: u32, at: u32) {
    let first = group.vertices.len() as u32;
    let vertices = corners.iter().map(|&p| Vertex { position: p.into(), ..Vertex::default() });
    group.vertices.extend(vertices);
    let first_triangle = group.triangles.len() as u32;
    group.triangles.extend((1..corners.len() as u32 - 1).map(|i| [first, first + i, first + i + 1]));
    group.faces.push(Face {
        first_triangle,
        triangle_count: group.triangles.len() as u32 - first_triangle,
        material: MaterialId(material),
        object: None,
        location: line(at),
    });
}

/// Adds the six outward faces of an axis-aligned box on lines `at` to `at + 5`.
pub fn add_box(group: &mut Group, [x0, y0, z0]: [f64; 3], [x1, y1, z1]: [f64; 3], material: u32, at: u32) {
    let faces = [
        [[x0, y0, z0], [x0, y1, z0], [x1, y1, z0], [x1, y0, z0]],
        [[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]],
        [[x0, y0, z0], [x1, y0, z0], [x1, y0, z1], [x0, y0, z1]],
        [[x0, y1, z0], [x0, y1, z1], [x1, y1, z1], [x1, y1, z0]],
        [[x0, y0, z0], [x0, y0, z1], [x0, y1, z1], [x0, y1, z0]],
        [[x1, y0, z0], [x1, y1, z0], [x1, y1, z1], [x1, y0, z1]],
    ];
    for (face, at) in faces.iter().zip(at..) {
        add_face(group, face, material, at);
    }
}

/// Returns a scene without faults: a gray floor, a lamp above it, a camera.
pub fn lit_floor() -> Scene {
    let mut world = Group::default();
    add_face(&mut world, &[[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]], 0, 10);
    add_face(&mut world, &[[-0.5, -0.5, 2.0], [-0.5, 0.5, 2.0], [0.5, 0.5, 2.0], [0.5, -0.5, 2.0]], 1, 11);
    let lamp = Material { sides: Sides::One, ed: tinted(1000.0), rd: tinted(0.0), ..material("lamp", 2) };
    Scene {
        name: "test".into(),
        files: vec!["test.mgf".into()],
        materials: vec![material("floor", 1), lamp],
        groups: vec![world],
        cameras: vec![camera("main", 3)],
        ..Scene::default()
    }
}
