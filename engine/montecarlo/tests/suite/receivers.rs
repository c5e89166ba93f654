//! Receivers in light with closed forms. Each technique of finding light must give it alone, and both combined.

use crate::analytic::{prepare, root_of_squares};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::elementary::double;
use femc_math::glam::Vec3A;
use femc_montecarlo::{MisTechnique, PathSettings, Receiver, Sensitivity, Tracer};
use femc_prepared::Prepared;
use femc_stats::testing::{Moments, sidak, z_test};
use std::f64::consts::PI;

/// Probability of a false alarm over all tests here, and the number of comparisons.
const LEVEL: f64 = 1e-4;
const TESTS: usize = 60;
const SAMPLES: u32 = 20_000;
/// Relative error of a mean without variance.
const ROUNDING: f64 = 2e-5;

/// Camera far away, which looks at the lamp. Receivers need none, but scenes do.
const CAMERA: &str = "camera main =\n origin 0 -9 1\n target 0 0 1\n fov 1\n film 1 1\n";
const LAMP: &str = "m lamp =\n sides 2\n c\n ed 100\nm lamp\n";
const UP: Sensitivity = Sensitivity::Plane { normal: Vec3A::Z };
const UPRIGHT: Sensitivity = Sensitivity::Cylinder { axis: Vec3A::Z };
const ALL: [Option<MisTechnique>; 3] = [None, Some(MisTechnique::Light), Some(MisTechnique::Scatter)];

fn receiver(scene: &Prepared, position: [f64; 3], sensitivity: Sensitivity) -> Receiver {
    let position = scene.from_world(position);
    let medium_stack = scene.media_at(position);
    Receiver { position, error: Vec3A::ZERO, normal: Vec3A::ZERO, sensitivity, medium_stack }
}

/// Returns the luminance of a lamp of the material `lamp`, cd/m2.
fn lamp_luminance() -> f64 {
    let scene = prepare(&format!("{CAMERA}{LAMP}v c =\n p 0 0 1\n n 0 -1 0\nring c 0 1\n"), "main");
    let toward = Sensitivity::Ray { toward: Vec3A::Y };
    let settings = PathSettings { seed: 1, max_depth: 1, single_technique: None };
    let color = Tracer::new(&scene, settings).receive(0, 0, |_, _| receiver(&scene, [0.2, -3.0, 1.1], toward));
    luminance(color).into()
}

/// Tests the mean of a receiver with each of some techniques. Each sample has its own seed, so all are independent.
fn assert_mean(name: &str, scene: &Prepared, receiver: &Receiver, techniques: &[Option<MisTechnique>], expected: f64) {
    for &single_technique in techniques {
        let mut moments = Moments::default();
        for seed in 0..SAMPLES {
            let settings = PathSettings { seed: seed.into(), max_depth: 0, single_technique };
            let color = Tracer::new(scene, settings).receive(seed % 5, seed % 3, |_, _| *receiver);
            moments.add(luminance(color).into());
        }
        let (p, error) =
            (z_test(moments.mean, moments.standard_error(), expected), moments.standard_error() / expected);
        let is_exact = (moments.mean / expected - 1.0).abs() < ROUNDING;
        let what = format!("{name}, {:?}, {single_technique:?}: {moments:?} for {expected}: {p}", receiver.sensitivity);
        assert!(is_exact || p >= sidak(LEVEL, TESTS), "{what}");
        let is_noisy = single_technique == Some(MisTechnique::Scatter);
        assert!(error < if is_noisy { 0.05 } else { 0.02 }, "too noisy: {what}");
    }
}

/// Integrates a function of the angle from 0 to `end` by the midpoint rule.
fn integral(end: f64, at: impl Fn(f64) -> f64) -> f64 {
    const STEPS: u32 = 20_000;
    let step = end / f64::from(STEPS);
    (0..STEPS).map(|number| at((f64::from(number) + 0.5) * step) * step).sum()
}

fn sin_cos(angle: f64) -> (f64, f64) {
    double::sin_cos(angle)
}

/// Disc of radius 0.75 that looks down from 1 m above the receiver, and the half angle that it has there.
fn below_disc(media: &str) -> (Prepared, f64) {
    let scene = prepare(&format!("{CAMERA}{media}{LAMP}v c =\n p .3 -.2 1\n n 0 0 -1\nring c 0 .75\n"), "main");
    (scene, double::atan(0.75))
}

const BELOW: [f64; 3] = [0.3, -0.2, 0.0];

#[test]
fn receivers_below_a_disc_have_its_closed_forms() {
    let (scene, angle) = below_disc("");
    let (l, (sin, cos)) = (lamp_luminance(), sin_cos(angle));
    assert_mean("disc", &scene, &receiver(&scene, BELOW, UP), &ALL, PI * l * sin * sin);
    assert_mean("disc", &scene, &receiver(&scene, BELOW, UPRIGHT), &ALL, l * (angle - sin * cos));
    assert_mean("disc", &scene, &receiver(&scene, BELOW, Sensitivity::Sphere), &ALL, 0.5 * PI * l * (1.0 - cos));
    let dark = receiver(&scene, BELOW, Sensitivity::Plane { normal: Vec3A::NEG_Z });
    let settings = PathSettings { seed: 1, max_depth: 0, single_technique: None };
    assert_eq!(Tracer::new(&scene, settings).receive(0, 0, |_, _| dark), Rgb::ZERO);
}

/// Air that only absorbs between a disc and the receiver: the radiance falls with the slant distance.
#[test]
fn receivers_below_a_disc_in_absorbing_air() {
    let (scene, angle) = below_disc("medium ink =\n sigma_a .7\nmglobal ink\n");
    let l = lamp_luminance();
    let arriving = |angle: f64| 2.0 * PI * l * sin_cos(angle).0 * double::exp(-0.7 / sin_cos(angle).1);
    let plane = integral(angle, |at| arriving(at) * sin_cos(at).1);
    let cylinder = integral(angle, |at| arriving(at) * sin_cos(at).0 / PI);
    let sphere = integral(angle, |at| 0.25 * arriving(at));
    for (sensitivity, expected) in [(UP, plane), (UPRIGHT, cylinder), (Sensitivity::Sphere, sphere)] {
        assert_mean("ink", &scene, &receiver(&scene, BELOW, sensitivity), &ALL, expected);
    }
}

/// Sphere of radius 0.3 at a distance of 1 m, 60 degrees from the vertical.
#[test]
fn receivers_beside_a_ball_have_its_closed_forms() {
    let (sin, cos) = sin_cos(PI / 3.0);
    let scene = prepare(&format!("{CAMERA}{LAMP}v c =\n p {sin} 0 {cos}\nsph c .3\n"), "main");
    let l = lamp_luminance();
    let plane = PI * l * 0.09 * cos;
    let sphere = 0.5 * PI * l * (1.0 - (1.0f64 - 0.09).sqrt());
    let half_angle = double::asin(0.3);
    // The weight of a direction is the sine with the vertical, over pi.
    let cylinder = integral(half_angle, |from_axis| {
        let (s, c) = sin_cos(from_axis);
        let ring = integral(2.0 * PI, |azimuth| {
            let z = c * cos - s * sin * sin_cos(azimuth).1;
            (1.0 - z * z).max(0.0).sqrt()
        });
        l * s * ring / PI
    });
    for (sensitivity, expected) in [(UP, plane), (UPRIGHT, cylinder), (Sensitivity::Sphere, sphere)] {
        assert_mean("ball", &scene, &receiver(&scene, [0.0; 3], sensitivity), &ALL, expected);
    }
}

/// In a closed room of equal radiance L, each receiver has pi L, and each ray L. Paths are long, so roulette ends them.
#[test]
fn all_receivers_in_a_furnace_are_equal() {
    let text = format!("{CAMERA}m wall =\n sides 2\n c\n ed 100\n rd .8\nm wall\nv o =\n p 0 0 0\nsph o -1\n");
    let (scene, l) = (prepare(&text, "main"), lamp_luminance() / (1.0 - 0.8));
    for sensitivity in [UP, UPRIGHT, Sensitivity::Sphere] {
        assert_mean("furnace", &scene, &receiver(&scene, [0.3, 0.1, -0.4], sensitivity), &ALL, PI * l);
    }
    let ray = Sensitivity::Ray { toward: Vec3A::new(0.36, 0.48, 0.8) };
    assert_mean("furnace", &scene, &receiver(&scene, [0.3, 0.1, -0.4], ray), &ALL, l);
}

/// A receiver in a closed ball that contains absorbing air: light passes 0.5 m of it.
#[test]
fn a_receiver_is_in_the_medium_of_its_object() {
    let clear = "medium ink =\n sigma_a .9\nm shell =\n sides 1\n ts 1 0\n inside ink\nm shell\n";
    let shell = "v o =\n p 0 0 0\nsph o .5\n";
    let around = "m wall =\n sides 2\n c\n ed 100\nm wall\nsph o -2\n";
    let scene = prepare(&format!("{CAMERA}{clear}{shell}{around}"), "main");
    let expected = PI * lamp_luminance() * double::exp(-0.9 * 0.5);
    for sensitivity in [UP, UPRIGHT, Sensitivity::Sphere] {
        let inside = receiver(&scene, [0.0; 3], sensitivity);
        assert_eq!(inside.medium_stack.iter().count(), 1);
        assert_mean("inside", &scene, &inside, &ALL, expected);
    }
    let outside = receiver(&scene, [0.0, 0.0, 1.0], Sensitivity::Ray { toward: Vec3A::Z });
    assert_mean("outside", &scene, &outside, &ALL, lamp_luminance());
}

/// The illuminance of a point on the floor is pi times its luminance over its reflectance, with all reflections and in fog.
#[test]
fn a_receiver_on_a_floor_agrees_with_the_pixel_there() {
    let camera = "camera main =\n origin 0 -1 1.2\n target 0 0 0\n fov .01\n film 1 1\n";
    let room = "m matte =\n sides 2\n c\n rd .6\nv a =\n p -2 -2 0\nv b =\n p 2 -2 0\nv c =\n p 2 2 0\nv d =\n p -2 2 0\n\
                m matte\nf a b c d\nv e =\n p 2 2 2\nv f =\n p -2 2 2\nf d c e f\n";
    let lamp = format!("{LAMP}v g =\n p .5 .3 .9\nsph g .2\n");
    // Air between the camera and the floor would dim the pixel, so the fog is above the camera's rays.
    let fog = "medium haze =\n sigma_s .4\n phase hg .5\nmbox haze -2 .2 .2 2 2 2\n";
    for media in ["", fog] {
        let scene = prepare(&format!("{camera}{media}{lamp}{room}"), "main");
        let mut on_floor = receiver(&scene, [0.0; 3], UP);
        (on_floor.normal, on_floor.error) = (Vec3A::Z, Vec3A::splat(1e-6));
        let (mut received, mut seen) = (Moments::default(), Moments::default());
        for seed in 0..4 * u64::from(SAMPLES) {
            let settings = PathSettings { seed, max_depth: 0, single_technique: None };
            received.add(luminance(Tracer::new(&scene, settings).receive(7, 0, |_, _| on_floor)).into());
            let settings = PathSettings { seed: seed | 1 << 40, ..settings };
            seen.add(luminance(Tracer::new(&scene, settings).sample(0, 0, crate::analytic::CENTER).color).into());
        }
        let expected = seen.mean * PI / 0.6;
        let error = root_of_squares([received.standard_error(), seen.standard_error() * PI / 0.6]);
        let p = z_test(received.mean, error, expected);
        assert!(p >= sidak(LEVEL, TESTS), "{media}: {received:?} for {expected} +- {error}: {p}");
        assert!(error < 0.01 * expected, "too noisy: {error} of {expected}");
    }
}

/// With a limit of one segment only direct light arrives; a furnace shows each further reflection.
#[test]
fn path_lengths_count_from_the_receiver() {
    let text = format!("{CAMERA}m wall =\n sides 2\n c\n ed 100\n rd .5\nm wall\nv o =\n p 0 0 0\nsph o -1\n");
    let (scene, l) = (prepare(&text, "main"), lamp_luminance());
    for (max_depth, expected) in [(1, 1.0), (2, 1.5), (3, 1.75)] {
        let mut moments = Moments::default();
        for seed in 0..u64::from(SAMPLES) {
            let settings = PathSettings { seed, max_depth, single_technique: None };
            moments.add(
                luminance(Tracer::new(&scene, settings).receive(0, 0, |_, _| receiver(&scene, [0.0; 3], UP))).into(),
            );
        }
        let p = z_test(moments.mean, moments.standard_error() + ROUNDING * l, PI * l * expected);
        assert!(p >= sidak(LEVEL, TESTS), "{max_depth}: {moments:?}: {p}");
    }
}
