//! Leaves of a field that the camera sees. The method of 1998 guides paths only there.

use crate::first_hit::first_surfaces_on_grid;
use femc_field::{Field, Side};
use femc_math::glam::Vec3A;
use femc_prepared::Prepared;

/// Maximum number of camera rays by axis of the film.
const MAX_RAYS: u32 = 256;
/// Number of points in fog on each ray.
const FOG_POINTS: u32 = 64;

/// Keeps the tables of the leaves that rays through the pixels' centers see, and of the fog that they go through. Removes all
/// others.
pub fn keep_seen_tables(scene: &Prepared, field: &mut Field) {
    let mut leaves = vec![false; field.leaves.len()];
    let mut fog = vec![false; field.fog.leaves().count()];
    let count = scene.camera.film.map(|edge| edge.min(MAX_RAYS));
    for (ray, surface) in first_surfaces_on_grid(scene, count) {
        let mut end = f32::INFINITY;
        if let Some(surface) = &surface {
            let side = if surface.back { Side::Back } else { Side::Front };
            end = surface.point.position.distance(ray.origin);
            if let Some((leaf, _)) = field.leaf_at(&surface.hit, side, surface.point.position) {
                leaves[leaf as usize] = true;
            }
        }
        if fog.is_empty() {
            continue;
        }
        let [start, end] = inside(field.fog.bounds(), ray.origin, ray.dir, end);
        for k in 0..FOG_POINTS {
            let t = start + (end - start) * (k as f32 + 0.5) / FOG_POINTS as f32;
            if let Some(leaf) = field.fog.leaf_at(ray.origin + ray.dir * t) {
                fog[leaf as usize] = true;
            }
        }
    }
    field.tables.retain(|leaf| leaves[leaf], |leaf| fog[leaf]);
}

/// Returns the distances at which a line enters and leaves a box, between 0 and `end`. If it misses the box, they are equal.
fn inside([min, max]: [Vec3A; 2], origin: Vec3A, dir: Vec3A, end: f32) -> [f32; 2] {
    let [a, b] = [min, max].map(|corner| (corner - origin) / dir);
    // A line parallel to a side gives infinite distances, or NaN on the side itself, which `max` and `min` of a float ignore.
    let enter = [0, 1, 2].iter().fold(0.0f32, |enter, &axis| enter.max(a[axis].min(b[axis])));
    let leave = [0, 1, 2].iter().fold(end, |leave, &axis| leave.min(a[axis].max(b[axis])));
    [enter, if leave.is_finite() { leave.max(enter) } else { enter }]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_inside_a_box_where_they_cross_it() {
        let bounds = [Vec3A::ZERO, Vec3A::new(2.0, 4.0, 1.0)];
        assert_eq!(inside(bounds, Vec3A::new(-1.0, 1.0, 0.5), Vec3A::X, f32::INFINITY), [1.0, 3.0]);
        assert_eq!(inside(bounds, Vec3A::new(1.0, 1.0, 0.5), Vec3A::NEG_Y, f32::INFINITY), [0.0, 1.0]);
        assert_eq!(inside(bounds, Vec3A::new(-1.0, 1.0, 0.5), Vec3A::X, 1.5), [1.0, 1.5]);
        let [start, end] = inside(bounds, Vec3A::new(-1.0, 5.0, 0.5), Vec3A::X, f32::INFINITY);
        assert_eq!(start, end, "beside the box");
    }
}
