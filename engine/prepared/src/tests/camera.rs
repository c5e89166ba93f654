//! Rays of the camera.

use super::midpoints;
use crate::camera::{CameraPose, KernelCamera};
use femc_math::glam::{DVec3, Vec3A};

const FILM: [u32; 2] = [40, 20];

/// A camera at (1, 2, 3) that looks along y, with z up and a vertical field of view of 60 degrees.
fn pose() -> CameraPose {
    CameraPose::new(DVec3::new(1.0, 2.0, 3.0), DVec3::new(1.0, 7.0, 3.0), DVec3::Z, 60.0, FILM).expect("a pose")
}

fn pinhole() -> KernelCamera {
    KernelCamera::new(vec![pose()], FILM, 0.0, 1.0)
}

#[test]
fn edges_of_the_film_are_half_the_field_of_view_away() {
    let view = pinhole().view([0.5; 2], 0.0);
    let slope = (std::f64::consts::PI / 6.0).tan() as f32;
    let middle = view.ray([20.0, 10.0]);
    assert!(middle.dir.distance(Vec3A::Y) < 1e-6 && middle.origin == Vec3A::new(1.0, 2.0, 3.0));
    // Top, bottom, left, right: y of the film points down, x to the right.
    for (place, x, z) in [
        ([20.0, 0.0], 0.0, slope),
        ([20.0, 20.0], 0.0, -slope),
        ([0.0, 10.0], -2.0 * slope, 0.0),
        ([40.0, 10.0], 2.0 * slope, 0.0),
    ] {
        let dir = view.ray(place).dir;
        assert!((dir.x / dir.y - x).abs() < 1e-5 && (dir.z / dir.y - z).abs() < 1e-5, "{place:?}: {dir}");
        assert!((dir.length() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn points_are_projected_to_the_pixels_that_see_them() {
    let camera = pinhole();
    let view = camera.view([0.5; 2], 0.0);
    let slope = (std::f64::consts::PI / 6.0).tan();
    for (x, depth, z) in [(0.0, 5.0, 0.0), (1.3, 4.0, -0.7), (-2.0, 10.0, 3.0)] {
        let (place, relative) =
            view.project(Vec3A::new(1.0 + x as f32, 2.0 + depth as f32, 3.0 + z as f32)).expect("ahead");
        let want = [20.0 + x / depth / slope * 10.0, 10.0 - z / depth / slope * 10.0];
        assert!(
            (f64::from(place[0]) - want[0]).abs() < 1e-4 && (f64::from(place[1]) - want[1]).abs() < 1e-4,
            "{place:?}"
        );
        assert!((f64::from(relative) - depth).abs() < 1e-4, "a pinhole's image is at 1 m: {relative}");
        assert!((f64::from(camera.depth(Vec3A::new(1.0, 2.0 + depth as f32, 9.0), 0.5)) - depth).abs() < 1e-5);
    }
    assert_eq!(view.project(Vec3A::new(1.0, 1.9, 3.0)), None);
    assert_eq!(camera.center(41), [1.5, 1.5]);
}

/// The pixels fill the solid angle of the film, 4 atan(a b / (d sqrt(d2 + a2 + b2))) for half edges a and b at distance d.
#[test]
fn solid_angles_of_pixels_add_up_to_that_of_the_film() {
    let view = pinhole().view([0.5; 2], 0.0);
    let sum: f64 = (0..800).map(|pixel| f64::from(view.solid_angle(pinhole().center(pixel)))).sum();
    let b = (std::f64::consts::PI / 6.0).tan();
    let a = 2.0 * b;
    let want = 4.0 * (a * b / (1.0 + a * a + b * b).sqrt()).atan();
    assert!((sum / want - 1.0).abs() < 1e-3, "{sum}, not {want}");
}

#[test]
fn rays_of_a_lens_meet_at_the_plane_of_focus_and_blur_elsewhere() {
    let camera = KernelCamera::new(vec![pose()], FILM, 0.1, 4.0);
    let sharp = pinhole().view([0.5; 2], 0.0).ray([31.0, 4.5]).dir;
    let focus = Vec3A::new(1.0, 2.0, 3.0) + sharp * (4.0 / sharp.y);
    let (mut radius, mut count) = (0.0f32, 0);
    for u in midpoints(8) {
        for v in midpoints(8) {
            let view = camera.view([u as f32, v as f32], 0.0);
            let ray = view.ray([31.0, 4.5]);
            let lens = ray.origin - Vec3A::new(1.0, 2.0, 3.0);
            assert!(lens.length() <= 0.1 && lens.y.abs() < 1e-6, "{lens}");
            let at = ray.origin + ray.dir * ((6.0 - ray.origin.y) / ray.dir.y);
            assert!(at.distance(focus) < 1e-5, "{at}, not {focus}");
            // A point at twice the distance, seen through this point of the lens.
            let (place, _) = view.project(Vec3A::new(1.0, 10.0, 3.0)).expect("ahead");
            let off = [place[0] - 20.0, place[1] - 10.0];
            radius = radius.max((off[0] * off[0] + off[1] * off[1]).sqrt());
            count += 1;
        }
    }
    // At the plane of focus the cone has a radius of half the lens: 0.05 m, of pixels of 4 tan(30) / 10 m.
    let want = 0.05 / (4.0 * (std::f32::consts::PI / 6.0).tan() / 10.0);
    assert_eq!(count, 64);
    assert!((camera.blur(8.0) / want - 1.0).abs() < 1e-5, "{}, not {want}", camera.blur(8.0));
    assert!(radius <= want * 1.0001 && radius > 0.85 * want, "{radius}");
    assert_eq!(pinhole().blur(8.0), 0.0);
}

#[test]
fn a_moving_camera_is_between_its_poses() {
    let at = |x: f64| CameraPose::new(DVec3::new(x, 0.0, 0.0), DVec3::new(x, 5.0, 0.0), DVec3::Z, 60.0, FILM).unwrap();
    let camera = KernelCamera::new(vec![at(0.0), at(2.0), at(3.0)], FILM, 0.0, 1.0);
    for (time, x) in [(0.0, 0.0), (0.25, 1.0), (0.5, 2.0), (0.75, 2.5), (1.0, 3.0)] {
        let view = camera.view([0.5; 2], time);
        assert!((view.origin.x - x).abs() < 1e-6, "{time}: {}", view.origin);
        assert_eq!(view.ray([20.0, 10.0]).time, time);
    }
    assert_eq!(camera.eye(), Vec3A::ZERO);
    assert!(camera.pinhole().is_none() && pinhole().pinhole().is_some());
    assert!(CameraPose::new(DVec3::ZERO, DVec3::Z, DVec3::Z, 60.0, FILM).is_none(), "it looks along its up direction");
}
