//! Scene text of rooms with uniform radiance.

use crate::text::{block, camera, material};
use std::f64::consts::PI;

/// Returns lines of a gray two-sided diffuse material of reflectance `rd`. In a room of luminance `l` it emits as much as it
/// absorbs.
pub fn uniform_material(l: f64, rd: f64) -> String {
    format!("sides 2\n rd {rd}\n ed {}", PI * l * (1.0 - rd))
}

/// Returns a camera inside [`walls`], which extend `half` m to each side.
pub fn camera_inside(half: f64) -> String {
    camera(&format!("{} {} {}", 0.3 * half, 0.2 * half, 0.1 * half), &format!("{} {} 0", half, 0.4 * half), 60.0)
}

/// Returns a closed cube around the origin, which extends `half` m to each side, of a material of these lines.
pub fn walls(half: f64, lines: &str) -> String {
    material("wall", &[lines]) + &block("wall", [-half; 3], [half; 3])
}

/// Returns a room of luminance `l` with walls of reflectance `rd`, and a camera in it.
pub fn furnace(half: f64, l: f64, rd: f64) -> String {
    camera_inside(half) + &walls(half, &uniform_material(l, rd))
}
