//! Detection of duplicate emitting surfaces. Rays hit only one of them, so light must be sampled from only one.
//!
//! Twins have the same material and the same corners, or the same shape, after the tracer's rounding. Faces that overlap in one
//! plane but have different corners are not twins: light is sampled from both, though rays hit only one.

use femc_geometry::Quadric;
use femc_math::glam::Vec3A;
use femc_scene::Sides;
use std::collections::BTreeMap;

/// Emitters of a group, by material and surface.
#[derive(Debug, Default)]
pub struct Duplicates(BTreeMap<(u32, Vec<u32>), u32>);

impl Duplicates {
    /// Returns the emitter of this surface: that of an earlier twin, or else `fresh`, which is registered for it.
    pub fn get_or_insert(&mut self, material: u32, surface: Vec<u32>, fresh: u32) -> u32 {
        *self.0.entry((material, surface)).or_insert(fresh)
    }
}

fn bits(p: Vec3A) -> [u32; 3] {
    // Zero has two signs.
    p.to_array().map(|x| (x + 0.0).to_bits())
}

/// Returns the key of a flat surface: its corners in any order, and the front of a one-sided surface.
/// - `normal`: normal of the front, of any length.
pub fn flat_key(corners: &[Vec3A], normal: Vec3A, sides: Sides) -> Vec<u32> {
    let mut sorted: Vec<[u32; 3]> = corners.iter().map(|&p| bits(p)).collect();
    sorted.sort_unstable();
    let largest = normal.to_array().into_iter().fold(0.0f32, |a, b| if b.abs() > a.abs() { b } else { a });
    let front = match sides {
        Sides::One => 1 + u32::from(largest > 0.0),
        Sides::Two => 0,
    };
    sorted.into_iter().flatten().chain([front]).collect()
}

/// Returns the key of a curved surface: its parameters, and the front of a one-sided surface.
pub fn curved_key(shape: &Quadric, sides: Sides) -> Vec<u32> {
    let (kind, points, radii) = match *shape {
        Quadric::Sphere { center, radius, .. } => (0, [center, Vec3A::ZERO], [radius, 0.0]),
        Quadric::Cone { start, end, start_radius, end_radius, .. } => (1, [start, end], [start_radius, end_radius]),
        Quadric::Ring { center, normal, inner, outer } => (2, [center, normal], [inner, outer]),
        Quadric::Torus { center, axis, major, minor, .. } => (3, [center, axis], [major, minor]),
    };
    let front = match sides {
        Sides::One => 1 + shape.facing() as u32,
        Sides::Two => 0,
    };
    let parameters = points.into_iter().flat_map(bits).chain(radii.map(f32::to_bits));
    parameters.chain([kind, front]).collect()
}

#[cfg(test)]
mod tests {
    use super::{Duplicates, flat_key};
    use femc_math::glam::Vec3A;
    use femc_scene::Sides;

    #[test]
    fn faces_are_twins_from_any_corner_and_reversed_if_two_sided() {
        let [a, b, c] = [Vec3A::X, Vec3A::Y, Vec3A::Z];
        let mut twins = Duplicates::default();
        let normal = Vec3A::ONE;
        assert_eq!(twins.get_or_insert(1, flat_key(&[a, b, c], normal, Sides::Two), 7), 7);
        assert_eq!(twins.get_or_insert(1, flat_key(&[c, b, a], -normal, Sides::Two), 8), 7);
        assert_eq!(twins.get_or_insert(2, flat_key(&[a, b, c], normal, Sides::Two), 8), 8);
        assert_eq!(twins.get_or_insert(3, flat_key(&[a, b, c], normal, Sides::One), 9), 9);
        assert_eq!(twins.get_or_insert(3, flat_key(&[c, b, a], -normal, Sides::One), 10), 10);
        assert_eq!(twins.get_or_insert(3, flat_key(&[b, c, a], normal, Sides::One), 11), 9);
    }
}
