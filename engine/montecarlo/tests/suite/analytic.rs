//! Scenes with known radiance. Each technique of finding light must give it alone, and all combined.

use femc_import::{Bundle, load_scene};
use femc_math::color::luminance;
use femc_math::elementary::double;
use femc_montecarlo::{MisTechnique, PathSettings, PixelFilter, Tracer};
use femc_prepared::{FrameSpec, Prepared, SceneSource, prepare_frame};
use femc_stats::testing::{Moments, sidak};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Probability of a false alarm over all tests here.
const LEVEL: f64 = 1e-4;
/// Number of z tests here.
const TESTS: usize = 22;
/// Relative error of a mean without variance.
const ROUNDING: f64 = 1e-5;
const ALL: [Option<MisTechnique>; 3] = [None, Some(MisTechnique::Light), Some(MisTechnique::Scatter)];

/// Square pixel, or only its center.
#[derive(Clone, Copy)]
pub(crate) struct Square(f32);

impl PixelFilter for Square {
    fn sample(self, u: [f32; 2]) -> [f32; 2] {
        u.map(|x| self.0 * (x - 0.5))
    }

    fn density(self, offset: [f32; 2]) -> f32 {
        let is_inside = offset.iter().all(|x| 2.0 * x.abs() <= self.0);
        if is_inside { 1.0 / (self.0 * self.0) } else { 0.0 }
    }
}

pub(crate) const CENTER: Square = Square(1e-4);
const PIXEL: Square = Square(1.0);

/// Returns the length of a vector of two independent errors.
pub(crate) fn root_of_squares([a, b]: [f64; 2]) -> f64 {
    (a * a + b * b).sqrt()
}

pub(crate) fn prepare(text: &str, camera: &str) -> Prepared {
    let files = [("test.mgf".to_owned(), text.as_bytes().to_vec())];
    let scene = load_scene(&Bundle(files.into()), "test.mgf").unwrap_or_else(|error| panic!("{error}")).scene;
    let spec = FrameSpec { camera: Some(camera.to_owned()), size: None, frame: 1, filter_radius: 0.5 };
    prepare_frame(&SceneSource::new(Arc::new(scene)), &spec, None).unwrap_or_else(|error| panic!("{error}"))
}

/// - `branches`: number of branches at the first vertex.
fn sample(scene: &Prepared, settings: PathSettings, filter: Square, branches: u32) -> f64 {
    luminance(Tracer::new(scene, settings).with_first_branches(branches).sample(0, 0, filter).color).into()
}

/// Returns the luminance of the emitter that the camera sees, cd/m2.
fn emitted(scene: &Prepared) -> f64 {
    let settings = PathSettings { seed: 1, max_depth: 1, single_technique: Some(MisTechnique::Scatter) };
    sample(scene, settings, CENTER, 1)
}

/// Tests the mean luminance of the only pixel with each of some techniques, with one branch at the first vertex and with several.
/// Each sample has its own seed, so all are independent.
fn assert_mean(
    name: &str,
    scene: &Prepared,
    (filter, max_depth): (Square, u32),
    techniques: &[Option<MisTechnique>],
    expected: f64,
) {
    for (&single_technique, branches) in techniques.iter().flat_map(|technique| [(technique, 1), (technique, 4)]) {
        let mut moments = Moments::default();
        for seed in 0..30_000 {
            moments.add(sample(scene, PathSettings { seed, max_depth, single_technique }, filter, branches));
        }
        let p = moments.p_value(expected);
        let error = moments.standard_error() / expected;
        let is_exact = (moments.mean / expected - 1.0).abs() < ROUNDING;
        let name = format!("{name}, {single_technique:?}, {branches} branches");
        assert!(is_exact || p >= sidak(LEVEL, TESTS), "{name}: {moments:?} for {expected}: {p}");
        assert!(error < 0.03, "{name}: too noisy: {error}");
    }
}

/// A matte floor under a parallel lamp, both square.
const PLATES: &str = "\
camera floor =
 origin 0 -3 .4
 target 0 0 0
 fov 10
 film 1 1
camera lamp =
 origin 0 -3 .4
 target 0 0 1
 fov 10
 film 1 1
m lamp =
 sides 2
 c
 ed 100
m matte =
 sides 2
 c
 rd .6
v a =
 p -.5 -.5 1
v b =
 p .5 -.5 1
v c =
 p .5 .5 1
v d =
 p -.5 .5 1
m lamp
f a b c d
v e =
 p -2 -2 0
v f =
 p 2 -2 0
v g =
 p 2 2 0
v h =
 p -2 2 0
m matte
f e f g h
";

/// Returns the form factor from a point to a parallel rectangle with a corner above it; sides relative to the distance.
fn corner_form_factor(a: f64, b: f64) -> f64 {
    let part = |a: f64, b: f64| a / (1.0 + a * a).sqrt() * double::atan(b / (1.0 + a * a).sqrt());
    (part(a, b) + part(b, a)) / TAU
}

#[test]
fn each_technique_finds_the_light_between_two_plates() {
    let lamp = emitted(&prepare(PLATES, "lamp"));
    let expected = 0.6 * lamp * 4.0 * corner_form_factor(0.5, 0.5);
    assert_mean("plates", &prepare(PLATES, "floor"), (CENTER, 2), &ALL, expected);
}

/// A lamp of 0.2 m in a pixel that is 0.8 m wide there. The camera samples it, and its rays hit it.
#[test]
fn each_technique_finds_a_lamp_that_fills_a_part_of_its_pixel() {
    let fov = 2.0 * double::atan(0.4 / 2.0) * 180.0 / PI;
    let text = format!(
        "camera pixel =\n origin 0 0 2\n target 0 0 0\n up 0 1 0\n fov {fov}\n film 1 1\n\
         m lamp =\n sides 2\n c\n ed 100\nv a =\n p -.13 -.1 0\nv b =\n p .07 -.1 0\nv c =\n p .07 .1 0\n\
         v d =\n p -.13 .1 0\nm lamp\nf a b c d\n"
    );
    let scene = prepare(&text, "pixel");
    assert!(scene.camera_emitters.get(0).is_some(), "the camera samples the lamp");
    assert_mean("small lamp", &scene, (PIXEL, 0), &ALL, emitted(&scene) * (0.2f64 / 0.8).powi(2));
}

/// A ball that emits and reflects inside: the radiance is the same everywhere, `emitted / (1 - reflectance)`. Paths are long, so
/// roulette ends them.
fn furnace(fog: &str) -> String {
    format!(
        "camera main =\n origin 0 -.7 0\n target 0 0 .1\n fov 10\n film 1 1\n{fog}\
         m wall =\n sides 2\n c\n ed 100\n rd .8\nv o =\n p 0 0 0\nm wall\nsph o -1\n"
    )
}

#[test]
fn each_technique_finds_the_radiance_of_a_furnace() {
    let scene = prepare(&furnace(""), "main");
    assert_mean("furnace", &scene, (CENTER, 0), &ALL, emitted(&scene) / (1.0 - 0.8));
}

/// Fog that absorbs nothing does not change the radiance of a furnace.
#[test]
fn fog_that_absorbs_nothing_is_invisible_in_a_furnace() {
    let light = emitted(&prepare(&furnace(""), "main"));
    let fog = "medium fog =\n sigma_s 1.5\n phase hg .4\nmbox fog -.3 -.3 -.3 .3 .3 .3\n";
    assert_mean("foggy furnace", &prepare(&furnace(fog), "main"), (CENTER, 0), &ALL[..2], light / (1.0 - 0.8));
}

/// The lamp of the plates behind fog that only absorbs.
#[test]
fn absorbing_fog_dims_a_lamp_exponentially() {
    let light = emitted(&prepare(PLATES, "lamp"));
    let fog = "medium ink =\n sigma_a .3\nmbox ink -1 -2.5 -1 1 -1.5 2\n";
    let scene = prepare(&format!("{fog}{PLATES}"), "lamp");
    let length = 1.0 / (3.0 / (9.0f64 + 0.36).sqrt());
    let seen = emitted(&scene);
    assert!((seen / light / double::exp(-0.3 * length) - 1.0).abs() < 1e-4, "{seen} of {light}");
}
