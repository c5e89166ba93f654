//! Tests of frame digests: the inputs that count in each layer, and those that do not.

use crate::common::*;
use femc_math::glam::DVec3;
use femc_scene::animation::PathMotion;
use femc_scene::frame_key::Viewpoint;
use femc_scene::*;

/// Returns a scene with a floor and an object on it that moves for one second, stands still for two, and moves again; ten frames
/// per second.
fn scene(interpolation: Interpolation) -> Scene {
    let mut scene = lit_floor();
    scene.clip = Some(Clip { start: 0.0, end: 6.0, fps: 10.0 });
    let keys = [0.0, 1.0, 1.0, 1.0, 2.0, 4.0, 4.5];
    let keys: Vec<_> = (0..).zip(keys).map(|(time, x)| (f64::from(time), pose(0.0, x, 0.0, 0.0))).collect();
    scene.paths = vec![path("p", 6, interpolation, &keys)];
    scene.groups.push(scene.groups[0].clone());
    let motion = Motion { steps: vec![MotionStep::Along(PathId(0))] };
    scene.groups[0].instances = vec![Instance { group: GroupId(1), motion }];
    scene
}

struct TestView {
    frame: u32,
    /// Time for which the shutter is open, s.
    open: f64,
    origin: f64,
    fov: f64,
    filter_radius: f32,
}

const TEST_VIEW: TestView = TestView { frame: 15, open: 0.05, origin: 0.0, fov: 40.0, filter_radius: 0.5 };

fn frame_key(scene: &Scene, view: &TestView) -> FrameKey {
    let camera = Camera { fov: view.fov, ..camera("main", 3) };
    let time = scene.frame_time(view.frame);
    let viewpoint = Viewpoint {
        camera: &camera,
        film: camera.film,
        frame: view.frame,
        shutter: [time, time + view.open],
        origin: DVec3::X * view.origin,
        filter_radius: view.filter_radius,
    };
    scene.frame_key(scene.static_digest(), &scene.scalars_at(time).unwrap(), &viewpoint)
}

#[test]
fn neither_the_camera_nor_the_origin_counts_in_the_content() {
    let (scene, far) = (scene(Interpolation::Linear), 300.0);
    let one = frame_key(&scene, &TEST_VIEW);
    let turned = frame_key(&scene, &TestView { fov: 20.0, ..TEST_VIEW });
    assert_eq!((one.content, one.world), (turned.content, turned.world));
    assert_ne!(one.view, turned.view);
    let filtered = frame_key(&scene, &TestView { filter_radius: 1.5, ..TEST_VIEW });
    assert_eq!((one.content, one.world), (filtered.content, filtered.world));
    assert_ne!(one.view, filtered.view, "a lamp is in other pixels");
    let moved = frame_key(&scene, &TestView { origin: far, ..TEST_VIEW });
    assert_eq!(one.content, moved.content);
    assert_ne!(one.world, moved.world, "what is prepared is prepared around the origin");
}

#[test]
fn overall_lamp_brightness_does_not_change_the_light_key() {
    let brighter = |which: &[usize], factor: f64| {
        let mut scene = lit_floor();
        scene.materials.push(Material { ed: TintedScalar { amount: 70.0, color: [1.0; 3] }, ..Material::default() });
        scene.materials.push(Material { ed: TintedScalar { amount: 900.0, color: [1.0; 3] }, ..Material::default() });
        let first = scene.materials.len() - 2;
        which.iter().for_each(|&lamp| scene.materials[first + lamp].ed.amount *= factor);
        scene.materials[..first].iter_mut().for_each(|material| material.ed.amount = 0.0);
        let now = scene.scalars_at(0.0).unwrap();
        (frame_key(&scene, &TEST_VIEW), now.brightness(), now.with_unit_brightness())
    };
    let (one, brightness, unit) = brighter(&[], 1.0);
    assert_eq!((brightness, unit.brightness()), (900.0, 1.0));
    assert_eq!(unit.with_unit_brightness().materials, unit.materials);
    for factor in [0.31, 1.7, 1e3] {
        let (all, brightness, same) = brighter(&[0, 1], factor);
        assert_eq!((all.light, brightness, &same.materials), (one.light, 900.0 * factor, &unit.materials));
        assert!(all.world != one.world && all.content != one.content);
        assert_ne!(brighter(&[0], factor).0.light, one.light, "one lamp against the other does");
    }
}

#[test]
fn objects_still_during_the_shutter_count_only_by_pose() {
    for interpolation in [Interpolation::Linear, Interpolation::Spline] {
        let scene = scene(interpolation);
        let at = |frame: u32, open: f64| frame_key(&scene, &TestView { frame, open, ..TEST_VIEW });
        let (one, two) = (at(15, 0.05), at(20, 0.05));
        assert_eq!((one.content, one.world), (two.content, two.world), "it stands from 1 s to 3 s");
        assert_ne!(one.view, two.view, "each frame has its own samples");
        assert_eq!(one.content, at(15, 0.0).content, "closed or open");
        assert_ne!(one.world, at(15, 0.0).world, "it is prepared as what moves, or as what does not");
        assert_ne!(one.content, at(4, 0.0).content, "at another place");
        assert_ne!(at(4, 0.0).content, at(5, 0.0).content);
        assert_ne!(at(4, 0.05).content, at(5, 0.05).content, "it moves from 0 s to 1 s");
        assert_ne!(at(15, 0.05).content, at(31, 0.05).content, "it begins to move while the shutter is open");
        assert_ne!(at(4, 0.05).content, at(4, 0.08).content);
    }
}

#[test]
fn keys_far_in_time_do_not_count_and_near_keys_do() {
    // At 0.3 s, the keys at 0 s and 1 s count; for a spline, also the key at 2 s.
    for (interpolation, near) in [(Interpolation::Linear, 2), (Interpolation::Spline, 3)] {
        let view = TestView { frame: 4, ..TEST_VIEW };
        let one = frame_key(&scene(interpolation), &view);
        for key in 0..7 {
            let mut other = scene(interpolation);
            other.paths[0].keys[key].pose.translation.y += 1e-9;
            assert_eq!(frame_key(&other, &view).content == one.content, key >= near, "{interpolation:?}, key {key}");
        }
    }
}

#[test]
fn every_pose_between_two_times_follows_from_the_passage() {
    // Pseudo-random numbers.
    let mut state = 1u64;
    let mut number = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    let mut still = 0;
    for round in 0..500 {
        let interpolation = if round % 2 == 0 { Interpolation::Linear } else { Interpolation::Spline };
        let mut place = pose(0.0, 0.0, 0.0, 0.0);
        let mut keys = Vec::new();
        for time in 0..1 + round % 9 {
            if number() < 0.5 {
                place = pose(6.0 * number(), number(), number(), number());
            }
            keys.push((f64::from(time), place));
        }
        let whole = path("p", 1, interpolation, &keys);
        let from = (10.0 * number() - 1.0).floor() + if number() < 0.3 { 0.0 } else { number() };
        let to = from + 2.0 * number();
        let motion = whole.motion_during([from, to]);
        still += usize::from(matches!(motion, PathMotion::Still(_)));
        for step in 0..=20 {
            let time = from + (to - from) * f64::from(step) / 20.0;
            let pose = match motion {
                PathMotion::Still(pose) => pose,
                PathMotion::Moving(interpolation, keys) => {
                    let keys: Vec<_> = keys.iter().map(|key| (key.time, key.pose)).collect();
                    path("p", 1, interpolation, &keys).at(time)
                }
            };
            assert_eq!(pose, whole.at(time), "round {round}, {time} s of {from} to {to}");
        }
    }
    assert!((50..450).contains(&still), "{still}: both happen");
}
