//! Tests of positions and values over time.

use crate::common;
use crate::common::*;
use femc_math::{
    Transform,
    glam::{DMat3, DQuat, DVec3},
};
use femc_scene::*;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

fn close(a: Transform, b: Transform) -> bool {
    a.abs_diff_eq(b, 1e-12)
}

#[test]
fn frames_go_on_while_before_the_end_and_half_a_frame() {
    let clip = |start, end, fps| Clip { start, end, fps };
    assert_eq!(clip(0.0, 1.0, 24.0).frame_count(), 25, "both ends have a frame");
    assert_eq!(clip(0.0, 23.0 / 24.0, 24.0).frame_count(), 24);
    assert_eq!(clip(2.0, 2.0, 24.0).frame_count(), 1);
    assert_eq!(clip(0.0, 0.9, 2.0).frame_count(), 3, "1.0 is before 0.9 plus half a frame");
    let clip = clip(2.0, 7.0, 10.0);
    assert_eq!((clip.frame_time(1), clip.frame_time(11)), (2.0, 3.0));
    for k in 1..=clip.frame_count() + 1 {
        assert_eq!(clip.frame_time(k) < clip.end + 0.05, k <= clip.frame_count());
    }
}

#[test]
fn a_still_has_one_frame_and_no_frame_interval() {
    let scene = lit_floor();
    let camera = Camera { shutter_close: 0.5, ..scene.cameras[0].clone() };
    assert_eq!((scene.frame_count(), scene.frame_time(1), scene.shutter(&camera, 1)), (1, 0.0, [0.0, 0.0]));
    let clip = Scene { clip: Some(Clip { start: 1.0, end: 2.0, fps: 4.0 }), ..scene };
    assert_eq!(clip.shutter(&camera, 2), [1.25, 1.375]);
}

#[test]
fn a_vary_is_linear_between_keys_and_constant_outside() {
    let vary = Vary { selector: String::new(), location: line(1), keys: vec![(1.0, 10.0), (2.0, 20.0), (4.0, 0.0)] };
    for (time, value) in [(-1.0, 10.0), (1.0, 10.0), (1.25, 12.5), (2.0, 20.0), (3.0, 10.0), (4.0, 0.0), (9.0, 0.0)] {
        assert_eq!(vary.at(time), value, "at {time}");
    }
}

#[test]
fn a_path_hits_its_keys_to_the_bit_and_stays_outside_them() {
    for interpolation in [Interpolation::Linear, Interpolation::Spline] {
        let keys = [(0.0, pose(0.3, 1.0, 2.0, 3.0)), (1.0, pose(1.7, 4.0, 0.0, 1.0)), (3.0, pose(-2.0, 0.1, 0.2, 0.3))];
        let path = path("p", 1, interpolation, &keys);
        for (time, pose) in keys {
            assert_eq!(path.at(time), pose);
        }
        assert_eq!((path.at(-5.0), path.at(99.0)), (keys[0].1, keys[2].1));
    }
}

#[test]
fn linear_keys_move_evenly_and_turn_evenly_on_the_shorter_arc() {
    let path =
        path("p", 1, Interpolation::Linear, &[(0.0, pose(0.0, 0.0, 0.0, 0.0)), (2.0, pose(FRAC_PI_2, 4.0, 0.0, 2.0))]);
    assert!(close(path.at(1.0), pose(FRAC_PI_4, 2.0, 0.0, 1.0)));
    assert!(close(path.at(0.5), pose(FRAC_PI_4 / 2.0, 1.0, 0.0, 0.5)));
    let over = common::path(
        "p",
        1,
        Interpolation::Linear,
        &[(0.0, pose(0.9 * PI, 0.0, 0.0, 0.0)), (1.0, pose(-0.9 * PI, 0.0, 0.0, 0.0))],
    );
    assert!(close(over.at(0.5), pose(PI, 0.0, 0.0, 0.0)), "through half a turn, not back through 0");
    let tiny = common::path(
        "p",
        1,
        Interpolation::Linear,
        &[(0.0, pose(1.0, 0.0, 0.0, 0.0)), (1.0, pose(1.0 + 1e-9, 0.0, 0.0, 0.0))],
    );
    assert!(tiny.at(0.5).is_finite());
}

#[test]
fn scaled_and_mirrored_poses_stay_similarities_of_the_same_hand() {
    let mirrored = |angle: f64, scale: f64| {
        let mirror = DMat3::from_diagonal(DVec3::new(-scale, scale, scale));
        Transform::from_mat3_translation(DMat3::from_quat(DQuat::from_rotation_y(angle)) * mirror, DVec3::X * angle)
    };
    let path = path("p", 1, Interpolation::Linear, &[(0.0, mirrored(0.0, 1.0)), (1.0, mirrored(1.0, 3.0))]);
    assert!(close(path.at(0.5), mirrored(0.5, 2.0)), "a mirrored pose turns about its axis like a plain one");
}

#[test]
fn spline_of_collinear_even_keys_is_straight_and_even() {
    let keys: Vec<_> = (0..5).map(|i| (f64::from(i), pose(0.0, 2.0 * f64::from(i), 0.0, 0.0))).collect();
    let path = path("p", 1, Interpolation::Spline, &keys);
    for i in 0..=40 {
        let time = f64::from(i) * 0.1;
        assert!(path.at(time).translation.abs_diff_eq(DVec3::X * 2.0 * time, 1e-12), "at {time}");
    }
}

#[test]
fn a_spline_is_the_centripetal_pyramid() {
    // Barry and Goldman's pyramid, written out. The distance between knots is the square root of the distance between points.
    let points = [DVec3::ZERO, DVec3::new(1.0, 0.0, 0.0), DVec3::new(1.0, 4.0, 0.0), DVec3::new(-5.0, 4.0, 8.0)];
    let keys: Vec<_> = points.iter().zip(0..).map(|(p, i)| (f64::from(i), pose(0.0, p.x, p.y, p.z))).collect();
    let path = path("p", 1, Interpolation::Spline, &keys);
    let mut k = [0.0; 4];
    for i in 1..4 {
        k[i] = k[i - 1] + points[i].distance(points[i - 1]).sqrt();
    }
    for u in [0.1, 0.5, 0.8] {
        let t = k[1] + u * (k[2] - k[1]);
        let mix =
            |a: DVec3, b: DVec3, from: f64, to: f64| a * ((to - t) / (to - from)) + b * ((t - from) / (to - from));
        let a = [0, 1, 2].map(|i| mix(points[i], points[i + 1], k[i], k[i + 1]));
        let b = [0, 1].map(|i| mix(a[i], a[i + 1], k[i], k[i + 2]));
        let expected = mix(b[0], b[1], k[1], k[2]);
        assert!(path.at(1.0 + u).translation.abs_diff_eq(expected, 1e-12), "at {u}");
    }
}

#[test]
fn a_spline_waits_between_equal_keys_and_stays_finite() {
    let keys = [(0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (3.0, 5.0)].map(|(t, x)| (t, pose(0.0, x, 0.0, 0.0)));
    let path = path("p", 1, Interpolation::Spline, &keys);
    for i in 0..=30 {
        assert!(path.at(f64::from(i) * 0.1).is_finite());
    }
    assert_eq!(path.at(1.5), keys[1].1);
}

#[test]
fn the_steps_of_a_motion_apply_to_a_point_first_to_last() {
    let paths = [path(
        "p",
        1,
        Interpolation::Linear,
        &[(0.0, pose(0.0, 0.0, 0.0, 0.0)), (1.0, pose(FRAC_PI_2, 0.0, 0.0, 0.0))],
    )];
    let out = MotionStep::Static(pose(0.0, 1.0, 0.0, 0.0));
    let motion = Motion { steps: vec![out, MotionStep::Along(PathId(0))] };
    let p = motion.at(&paths, 1.0).transform_point3(DVec3::ZERO);
    assert!(p.abs_diff_eq(DVec3::Y, 1e-12), "moved out along x, then turned: {p}");
    assert!(motion.is_animated(&paths) && !Motion { steps: vec![out] }.is_animated(&paths));
    let stands =
        [path("p", 1, Interpolation::Linear, &[(0.0, pose(1.0, 0.0, 0.0, 0.0)), (1.0, pose(1.0, 0.0, 0.0, 0.0))])];
    assert!(!motion.is_animated(&stands), "a path between equal poses moves nothing");
}

#[test]
fn a_camera_rides_its_path_with_its_own_offset() {
    let paths = [path(
        "p",
        1,
        Interpolation::Linear,
        &[(0.0, pose(0.0, 0.0, 0.0, 0.0)), (1.0, pose(FRAC_PI_2, 10.0, 0.0, 0.0))],
    )];
    let camera =
        Camera { origin: DVec3::X, target: DVec3::X * 2.0, up: DVec3::Z, along: Some(PathId(0)), ..camera("c", 1) };
    let there = camera.at(&paths, 1.0);
    assert!(there.origin.abs_diff_eq(DVec3::new(10.0, 1.0, 0.0), 1e-12), "{}", there.origin);
    assert!(there.target.abs_diff_eq(DVec3::new(10.0, 2.0, 0.0), 1e-12), "{}", there.target);
    assert!(there.up.abs_diff_eq(DVec3::Z, 1e-12) && there.along.is_none());
    assert_eq!(camera.at(&paths, -1.0).origin, DVec3::X);
    assert!(camera.is_animated(&paths) && !there.is_animated(&paths));
}

#[test]
fn only_groups_that_hold_something_moving_change() {
    let mut scene = lit_floor();
    scene.paths =
        vec![path("p", 1, Interpolation::Linear, &[(0.0, pose(0.0, 0.0, 0.0, 0.0)), (1.0, pose(1.0, 0.0, 0.0, 0.0))])];
    let place = |group: u32, steps: Vec<MotionStep>| Instance { group: GroupId(group), motion: Motion { steps } };
    // world > car (moves) > wheel (turns); world > house (still); world > crowd > house
    scene.groups.resize(5, Group::default());
    scene.groups[0].instances = vec![place(1, vec![MotionStep::Along(PathId(0))]), place(3, vec![]), place(4, vec![])];
    scene.groups[1].instances = vec![place(2, vec![MotionStep::Along(PathId(0))])];
    scene.groups[4].instances = vec![place(3, vec![])];
    assert_eq!(scene.changing_groups(), [true, true, false, false, false], "the wheel turns as a whole");
    // A blinking sign in the house makes the house change, and every group that contains it.
    scene.objects = vec![object("sign", None), object("sign.bulb", Some(0))];
    add_face(&mut scene.groups[3], &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 0, 9);
    scene.groups[3].faces[0].object = Some(ObjectId(1));
    assert!(!scene.changing_groups()[3]);
    scene.varies =
        vec![Vary { selector: "object.sign.hidden".into(), location: line(1), keys: vec![(0.0, 0.0), (1.0, 1.0)] }];
    assert_eq!(scene.blinking_objects(), [true, true]);
    assert_eq!(scene.changing_groups(), [true, true, false, true, true]);
}

#[test]
fn what_encloses_hides_what_is_in_it() {
    let mut objects = vec![object("a", None), object("a.b", Some(0)), object("a.b.c", Some(1)), object("d", None)];
    objects[1].hidden = true;
    assert_eq!(objects::hidden_objects(&objects), [false, true, true, false]);
}
