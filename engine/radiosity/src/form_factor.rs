//! Form factors from a point: the share of a source's light that a point receives without occlusion.

use crate::tuning::{FAR_RADII, IN_PLANE};
use femc_math::cross;
use femc_math::elementary::atan2;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Computes Lambert's formula: the form factor from a point with unit normal to a polygon, which sends from the side that sees its
/// corners counterclockwise. The part below the point's horizon is clipped. At most 1.
pub fn polygon_form_factor(point: Vec3A, normal: Vec3A, corners: &[Vec3A]) -> f32 {
    let reach = corners.iter().map(|&corner| (corner - point).length()).fold(0.0, f32::max);
    if corners.iter().all(|&corner| normal.dot(corner - point) <= IN_PLANE * reach) {
        return 0.0;
    }
    // By rounding, a polygon in the horizon may cross it at every edge.
    let mut above = [Vec3A::ZERO; 8];
    let mut count = 0;
    for (k, &corner) in corners.iter().enumerate() {
        let (a, b) = (corner - point, corners[(k + 1) % corners.len()] - point);
        let (ha, hb) = (normal.dot(a), normal.dot(b));
        if ha >= 0.0 {
            above[count] = a;
            count += 1;
        }
        if (ha > 0.0 && hb < 0.0) || (ha < 0.0 && hb > 0.0) {
            above[count] = a + (b - a) * (ha / (ha - hb));
            count += 1;
        }
    }
    if count < 3 {
        return 0.0;
    }
    let sum: f32 = (0..count)
        .map(|k| {
            let (a, b) = (above[k], above[(k + 1) % count]);
            let across = cross(a, b);
            let sine = across.length();
            // An edge that goes through the point, or is a point, contributes nothing.
            if sine > 0.0 { atan2(sine, a.dot(b)) * normal.dot(across) / sine } else { 0.0 }
        })
        .sum();
    // Corners that are counterclockwise as seen from the point turn the other way around its normal.
    (-sum / (2.0 * PI)).clamp(0.0, 1.0)
}

/// Returns the solid angle of a polygon from a point on the side that sees its corners counterclockwise, sr; 0 from behind.
pub fn solid_angle(point: Vec3A, corners: &[Vec3A]) -> f32 {
    let mut sum = 0.0;
    for k in 1..corners.len() - 1 {
        let [a, b, c] = [corners[0], corners[k], corners[k + 1]].map(|corner| (corner - point).normalize_or_zero());
        let numerator = -a.dot(cross(b, c));
        sum += 2.0 * atan2(numerator, 1.0 + a.dot(b) + b.dot(c) + c.dot(a));
    }
    sum.max(0.0)
}

/// Returns the mean of the unit directions from a point to a polygon, by solid angle: Lambert's formula as a vector. Zero if there is
/// no polygon, or if it is seen from behind or from its plane.
pub fn mean_direction_to(point: Vec3A, corners: &[Vec3A]) -> Vec3A {
    if corners.len() < 3 {
        return Vec3A::ZERO;
    }
    let solid_angle = solid_angle(point, corners);
    let mut sum = Vec3A::ZERO;
    for (k, &corner) in corners.iter().enumerate() {
        let (a, b) = (corner - point, corners[(k + 1) % corners.len()] - point);
        let across = cross(a, b);
        let sine = across.length();
        if sine > 0.0 {
            sum -= across * (0.5 * atan2(sine, a.dot(b)) / sine);
        }
    }
    if solid_angle > IN_PLANE { (sum / solid_angle).clamp_length_max(1.0) } else { Vec3A::ZERO }
}

/// Checks whether a surface is too near to be treated as a point.
pub fn is_near(distance2: f32, radius: f32) -> bool {
    distance2 < FAR_RADII * FAR_RADII * radius * radius
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coplanar_polygon_sends_nothing_to_a_point_facing_either_way() {
        let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| Vec3A::new(x, y, 1e-7));
        let mut back = square;
        back.reverse();
        for corners in [square, back] {
            for at in [Vec3A::ZERO, Vec3A::new(0.9, 0.3, 0.0), Vec3A::new(1.0, 1.0, 0.0), Vec3A::new(1.5, 0.0, 0.0)] {
                assert_eq!(
                    (polygon_form_factor(at, Vec3A::Z, &corners), polygon_form_factor(at, -Vec3A::Z, &corners)),
                    (0.0, 0.0),
                    "{at}"
                );
            }
        }
        let near = back.map(|corner| Vec3A::new(corner.x, corner.y, 1e-3));
        assert!(
            polygon_form_factor(Vec3A::ZERO, Vec3A::Z, &near) > 0.99,
            "a lamp a millimeter above a point fills its sky"
        );
    }

    /// Corner unit square at height 1 above a point: 0.1385316 (brief A4).
    #[test]
    fn square_has_lambert_form_factor_and_is_cut_at_the_horizon() {
        let square = [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]].map(|[x, y]| Vec3A::new(x, y, 1.0));
        assert!((polygon_form_factor(Vec3A::ZERO, Vec3A::Z, &square) - 0.138_531_6).abs() < 1e-6);
        let mut behind = square;
        behind.reverse();
        assert_eq!(polygon_form_factor(Vec3A::ZERO, Vec3A::Z, &behind), 0.0);
        // A wall of height 2 and infinite width, half below the horizon, has the factor of its upper half.
        let wall = |low: f32| [[-1e3, low], [-1e3, 1.0], [1e3, 1.0], [1e3, low]].map(|[y, z]| Vec3A::new(1.0, y, z));
        let (cut, above) = (
            polygon_form_factor(Vec3A::ZERO, Vec3A::Z, &wall(-1.0)),
            polygon_form_factor(Vec3A::ZERO, Vec3A::Z, &wall(0.0)),
        );
        assert!((cut - above).abs() < 1e-6 && cut > 0.0, "{cut} {above}");
        // The factor of an infinite strip from the horizon to 45 degrees: (1 - cos 45) / 2.
        assert!((above - 0.5 * (1.0 - 0.5f32.sqrt())).abs() < 1e-3, "{above}");
    }

    /// Corners that are alternately above and below the horizon by rounding (as in the kitchen soda.mgf).
    #[test]
    fn a_polygon_in_the_horizon_is_no_panic_and_gives_nothing() {
        let zigzag = [[1.0, 0.0, 1e-7], [2.0, 0.0, -1e-7], [2.0, 1.0, 1e-7], [1.0, 1.0, -1e-7]].map(Vec3A::from);
        for corners in [zigzag, [zigzag[3], zigzag[2], zigzag[1], zigzag[0]]] {
            assert!(polygon_form_factor(Vec3A::ZERO, Vec3A::Z, &corners) < 1e-6);
        }
    }

    /// The mean cosine of a cap of half angle a is (1 + cos a) / 2; a square of the same solid angle has nearly as much.
    #[test]
    fn mean_direction_points_at_the_polygon_and_is_shorter_for_a_larger_one() {
        for (height, want) in [(100.0, 1.0), (1.0, 0.8), (0.01, 0.5)] {
            let square = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]].map(|[x, y]| Vec3A::new(x, y, height));
            let mean = mean_direction_to(Vec3A::ZERO, &square);
            assert!((mean - Vec3A::Z * want).length() < 0.03, "{height}: {mean}");
            let mut behind = square;
            behind.reverse();
            assert_eq!(mean_direction_to(Vec3A::ZERO, &behind), Vec3A::ZERO);
        }
        assert_eq!(mean_direction_to(Vec3A::ZERO, &[]), Vec3A::ZERO);
    }

    #[test]
    fn a_cube_seen_from_its_middle_has_six_equal_sides() {
        let side = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]].map(|[x, y]| Vec3A::new(x, y, 1.0));
        assert!((solid_angle(Vec3A::ZERO, &side) - 4.0 * PI / 6.0).abs() < 1e-5);
    }
}
