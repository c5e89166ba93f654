//! Emitting surfaces that a scene has twice: rays meet one of them, so that light is drawn from one.
//!
//! Twins have the same material and the same corners, or the same shape, as the tracer rounds them. Faces that overlap in one plane
//! without having the same corners are no twins: light is drawn from both, though rays meet one.

use femc_geometry::Quadric;
use femc_math::glam::Vec3A;
use femc_scene::Sides;
use std::collections::BTreeMap;

/// The emitters of a group by what rays meet.
#[derive(Debug, Default)]
pub struct Twins(BTreeMap<(u32, Vec<u32>), u32>);

impl Twins {
    /// The emitter of this surface: the one that a twin had, or `fresh`, which it is known by from now on.
    pub fn emitter(&mut self, material: u32, surface: Vec<u32>, fresh: u32) -> u32 {
        *self.0.entry((material, surface)).or_insert(fresh)
    }
}

fn bits(p: Vec3A) -> [u32; 3] {
    // Zero has two signs.
    p.to_array().map(|x| (x + 0.0).to_bits())
}

/// A flat surface by its corners in any order; one-sided ones by their front, too.
/// - `normal`: of the front, of any length.
pub fn flat(corners: &[Vec3A], normal: Vec3A, sides: Sides) -> Vec<u32> {
    let mut sorted: Vec<[u32; 3]> = corners.iter().map(|&p| bits(p)).collect();
    sorted.sort_unstable();
    let largest = normal.to_array().into_iter().fold(0.0f32, |a, b| if b.abs() > a.abs() { b } else { a });
    let front = match sides {
        Sides::One => 1 + u32::from(largest > 0.0),
        Sides::Two => 0,
    };
    sorted.into_iter().flatten().chain([front]).collect()
}

/// A curved surface by its parameters; one-sided ones by their front, too.
pub fn curved(shape: &Quadric, sides: Sides) -> Vec<u32> {
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
    use super::{Twins, flat};
    use femc_math::glam::Vec3A;
    use femc_scene::Sides;

    #[test]
    fn a_face_from_another_corner_or_from_behind_is_a_twin_but_a_one_sided_one_from_behind_is_not() {
        let [a, b, c] = [Vec3A::X, Vec3A::Y, Vec3A::Z];
        let mut twins = Twins::default();
        let normal = Vec3A::ONE;
        assert_eq!(twins.emitter(1, flat(&[a, b, c], normal, Sides::Two), 7), 7);
        assert_eq!(twins.emitter(1, flat(&[c, b, a], -normal, Sides::Two), 8), 7);
        assert_eq!(twins.emitter(2, flat(&[a, b, c], normal, Sides::Two), 8), 8);
        assert_eq!(twins.emitter(3, flat(&[a, b, c], normal, Sides::One), 9), 9);
        assert_eq!(twins.emitter(3, flat(&[c, b, a], -normal, Sides::One), 10), 10);
        assert_eq!(twins.emitter(3, flat(&[b, c, a], normal, Sides::One), 11), 9);
    }
}
