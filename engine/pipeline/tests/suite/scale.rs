//! Light is proportional to the lamps: everything that a field answers scales with them or stays equal. Powers of two only change
//! exponents, so they are exact.

use crate::layers::scene;
use femc_field::TargetGuide;
use femc_film::Rect;
use femc_geometry::{Hit, Ray};
use femc_math::Rgb;
use femc_math::glam::{Vec2, Vec3A};
use femc_montecarlo::Guidance;
use femc_pipeline::radiosity::{SolveOptions, solve};
use femc_pipeline::{
    Field, FrameLight, Method, Outputs, Prepared, RenderTask, SceneSource, Settings, Side, StopCondition,
    attach_first_pass, attach_learned_targets, first_pass_world, frame_key, plan_job, prepare_frame, prepare_world,
    render_frame,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Factors of a world: of the lamps' emission, of its channels, of the fog's glow, and of lengths.
#[derive(Clone, Copy)]
struct Factors {
    light: f64,
    glow: f64,
    color: [f64; 3],
    length: f64,
}

const ONE: Factors = Factors { light: 1.0, glow: 1.0, color: [1.0; 3], length: 1.0 };

/// A closed room in which a board hides a panel from most of the room, with a second lamp, a glossy block and thin fog that glows.
fn text(Factors { light, glow, color: [r, g, b], length }: Factors) -> String {
    let point = |[x, y, z]: [f64; 3]| format!("{} {} {}", x * length, y * length, z * length);
    let vertex = |(name, at): (&str, [f64; 3])| format!("v {name} =\n\tp {}\n", point(at));
    let faces = |corners: &[(&str, [f64; 3])], faces: &str| {
        let vertices: String = corners.iter().copied().map(vertex).collect();
        let faces: String = faces.split(',').map(|face| format!("f {face}\n")).collect();
        vertices + &faces
    };
    let room = [
        ("a", [0.0, 0.0, 0.0]),
        ("b", [2.0, 0.0, 0.0]),
        ("c", [2.0, 3.0, 0.0]),
        ("d", [0.0, 3.0, 0.0]),
        ("e", [0.0, 0.0, 2.0]),
        ("f", [2.0, 0.0, 2.0]),
        ("g", [2.0, 3.0, 2.0]),
        ("h", [0.0, 3.0, 2.0]),
    ];
    let board = [("i", [0.2, 2.0, 0.1]), ("j", [1.5, 2.0, 0.1]), ("k", [1.5, 2.0, 1.9]), ("l", [0.2, 2.0, 1.9])];
    let panel = [("m", [0.5, 2.4, 1.9]), ("n", [0.5, 2.8, 1.9]), ("o", [1.3, 2.8, 1.9]), ("p", [1.3, 2.4, 1.9])];
    format!(
        "camera main =\n\torigin {}\n\ttarget {}\n\tfov 70\n\tfilm 16 12\nmedium haze =\n\tsigma_s {}\n\tsigma_a {}\n\tphase hg .3\n\t\
         glow {}\nmglobal haze\nm white =\n\tsides 2\n\tc\n\trd .7\nm gloss =\n\tsides 2\n\tc\n\trd .2\n\trs .4 .3\nm lamp =\n\tsides 1\n\t\
         c\n\tcrgb {r} {g} {b}\n\ted {}\nm bulb =\n\tsides 1\n\tc\n\tcrgb {r} {g} {b}\n\ted {}\nm white\n{}m gloss\n{}m lamp\n{}m bulb\nv u =\n\tp {}\n\
         sph u {}\nm gloss\nv w =\n\tp {}\nsph w {}\n",
        point([1.0, 0.2, 1.0]),
        point([1.0, 2.0, 0.8]),
        0.05 / length,
        0.02 / length,
        0.5 * light * glow / length,
        400.0 * light,
        150.0 * light,
        faces(&room, "a b c d,e h g f,a e f b,d c g h,a d h e,b f g c"),
        faces(&board, "i j k l"),
        faces(&panel, "m n o p"),
        point([1.6, 0.6, 1.5]),
        0.05 * length,
        point([0.6, 1.0, 0.4]),
        0.3 * length,
    )
}

fn settings(method: Method) -> Settings {
    Settings { method, stop: StopCondition::Spp(16), ..Settings::default() }
}

fn source(factors: Factors) -> SceneSource {
    SceneSource::new(Arc::new(scene(&text(factors))))
}

/// Returns the sums of all pixels of an image, by channel.
fn colors(prepared: &Prepared, settings: &Settings) -> Vec<[f32; 3]> {
    let [width, height] = prepared.camera.film;
    let task = RenderTask::new(prepared, settings, Rect { x: 0, y: 0, width, height }, 0..16);
    let tile = task.render(Outputs::default()).expect("a tile").tile;
    let mut frame = femc_film::Frame::new(femc_film::Tiling::new(width, height, 64).expect("a tiling"));
    frame.insert(tile).expect("a whole frame");
    frame.resolve().color.pixels
}

/// Everything that a field answers at many places: values proportional to light, and values that the light's scale does not change.
#[derive(Debug, PartialEq)]
struct Answers {
    light: Vec<[f32; 3]>,
    shape: Vec<f32>,
}

impl Answers {
    fn new(prepared: &Prepared, field: &Field) -> Self {
        let (mut light, mut shape) = (Vec::new(), Vec::new());
        let mut add = |value: Rgb| light.push(value.to_array());
        let targets = TargetGuide::without_targets(field);
        for (number, surface) in field.surfaces.iter().enumerate() {
            for uv in [[0.2, 0.3], [0.6, 0.2], [0.3, 0.6]] {
                let spot = surface.point_at(Vec2::from(uv));
                let hit =
                    Hit { t: 1.0, instance: surface.instance, primitive: surface.primitives[0], u: uv[0], v: uv[1] };
                add(field.irradiance(&hit, surface.side, spot.position, spot.normal));
                add(Rgb::splat(field.irradiance_error(&hit, surface.side, spot.position)));
                let guided = targets.at(field, &hit, surface.side, spot.position);
                add(guided.map_or(Rgb::ZERO, |guided| guided.light));
                shape.push(guided.map_or(0.0, |guided| guided.region as f32));
                shape.push(number as f32 + f32::from(u8::from(surface.side == Side::Back)));
            }
        }
        for leaf in &field.leaves {
            add(leaf.mean_irradiance());
        }
        field.errors.iter().for_each(|error| add(Rgb::splat(*error)));
        for k in 0..40 {
            let at = |n: i32| (k * n % 37) as f32 / 37.0;
            let point = Vec3A::new(2.0 * at(7), 3.0 * at(11), 2.0 * at(13)) - prepared.origin.as_vec3a();
            add(field.fog.mean_radiance(point));
            add(field.fog.scattered_radiance(point, Vec3A::new(0.6, 0.0, 0.8)));
        }
        add(Rgb::splat(Guidance::new(prepared, field).with_targets(prepared, &targets).frame_light));
        Self { light, shape }
    }

    /// Checks that all light is another's, times a factor by channel.
    fn assert_exact(&self, name: &str, one: &Self, factor: [f32; 3]) {
        assert_eq!(self.shape, one.shape, "{name}: regions");
        assert_light(name, &self.light, &one.light, factor);
        assert!(one.light.iter().filter(|light| light[1] > 0.0).count() > 200, "{name}: too dark");
        let regions = one.shape.iter().filter(|it| **it > 0.0).count();
        assert!(regions > 60, "{name}: {regions} regions");
    }
}

fn assert_light(name: &str, got: &[[f32; 3]], one: &[[f32; 3]], factor: [f32; 3]) {
    assert_eq!(got.len(), one.len(), "{name}: number of values");
    for (at, (got, one)) in got.iter().zip(one).enumerate() {
        for (channel, factor) in factor.into_iter().enumerate() {
            let expected = one[channel] * factor;
            // Sums of values as small as this round against the least positive number.
            let is_none = one[channel].abs() < 1e-10 && expected.abs().max(got[channel].abs()) < 1e-10 * factor;
            assert!(got[channel] == expected || is_none, "{name}: value {at} is {} for {expected}", got[channel]);
        }
    }
}

fn assert_mean(name: &str, got: &[[f32; 3]], one: &[[f32; 3]], factor: [f32; 3], tolerance: f64) {
    for channel in 0..3 {
        let sum = |values: &[[f32; 3]]| values.iter().map(|value| f64::from(value[channel])).sum::<f64>();
        let ratio = sum(got) / sum(one) / f64::from(factor[channel]);
        assert!((ratio - 1.0).abs() < tolerance, "{name}, channel {channel}: {ratio}");
    }
}

fn options() -> SolveOptions {
    SolveOptions { error: 1.0, ..SolveOptions::default() }
}

fn solved(prepared: &Prepared) -> (Field, Vec<[f32; 3]>) {
    let solution = solve(prepared, &options(), &AtomicBool::new(false)).expect("a solution");
    let direct = solution.field.direct.iter().map(|leaf| leaf.mean_irradiance().to_array()).collect();
    (solution.field, direct)
}

/// The solver itself, with lamps of any brightness, and [`Field::scaled`] against it.
#[test]
fn a_solution_is_proportional_to_the_lamps() {
    const FACTOR: f32 = 1.0 / 1_048_576.0;
    let world =
        |light| prepare_world(&source(Factors { light, ..ONE }), &settings(Method::Femc), 1, None).expect("a frame");
    let (one, dim) = (world(1.0), world(FACTOR.into()));
    let ((field, direct), (dim_field, dim_direct)) = (solved(&one), solved(&dim));
    assert_light("direct light", &dim_direct, &direct, [FACTOR; 3]);
    let answers = Answers::new(&one, &field);
    let solved_again = Answers::new(&dim, &dim_field);
    solved_again.assert_exact("solved again", &answers, [FACTOR; 3]);
    let scaled = Answers::new(&dim, &field.scaled(FACTOR));
    scaled.assert_exact("scaled", &answers, [FACTOR; 3]);
}

/// A solution that frames of other brightness share: the light that they get, and the pixels that it guides and lights.
#[test]
fn frames_that_share_a_solution_are_proportional_to_their_lamps() {
    let femc = settings(Method::Femc);
    let world = first_pass_world(&source(ONE), &femc, 1, None).expect("a world");
    let unit = Arc::new(solved(&world).0);
    let key = |light| frame_key(&source(Factors { light, ..ONE }), &femc, 1).expect("a key").light;
    for method in [Method::Femc, Method::Fem, Method::Pt] {
        let rendered = |light| {
            let mut prepared =
                prepare_world(&source(Factors { light, ..ONE }), &settings(method), 1, None).expect("a frame");
            let light = FrameLight::new(unit.clone(), prepared.brightness);
            attach_first_pass(&mut prepared, light).expect("a field of the frame");
            attach_learned_targets(&mut prepared, method).expect("targets");
            let answers = Answers::new(&prepared, prepared.field().expect("a field"));
            (answers, colors(&prepared, &settings(method)))
        };
        let (one, image) = rendered(1.0);
        for (light, is_exact) in [(0.125, true), (1_048_576.0, true), (1e-6, false), (1.0 / 3.0, false), (1e6, false)] {
            let (name, factor) = (format!("{method:?}, {light}"), [light as f32; 3]);
            assert!(key(light) == key(1.0), "{name}: another solution");
            let (got, got_image) = rendered(light);
            assert_mean(&name, &got_image, &image, factor, 0.01);
            assert_mean(&name, &got.light, &one.light, factor, 1e-5);
            if is_exact {
                assert_light(&name, &got_image, &image, factor);
                got.assert_exact(&name, &one, factor);
            }
        }
    }
}

/// Light of one channel alone. Paths depend on the lamps' ratios only, and these are equal.
#[test]
fn each_channel_is_proportional_to_its_own_light() {
    let rendered = |color| {
        let prepared = prepare_frame(&source(Factors { color, glow: 0.0, ..ONE }), &settings(Method::Pt), 1, None)
            .expect("a frame");
        colors(&prepared, &settings(Method::Pt))
    };
    let one = rendered([1.0; 3]);
    for channel in 0..3 {
        let mut color = [1.0; 3];
        color[channel] = 4.0;
        let got = rendered(color);
        assert_mean(&format!("channel {channel}"), &got, &one, color.map(|it| it as f32), 0.03);
    }
}

/// Kilometers for meters: radiance does not depend on the unit of length if the fog's coefficients do.
#[test]
fn light_does_not_depend_on_the_unit_of_length() {
    let image = |length, method| {
        let prepared = prepare_frame(&source(Factors { length, ..ONE }), &settings(method), 1, None).expect("a frame");
        colors(&prepared, &settings(method))
    };
    let one = image(1.0, Method::Pt);
    for length in [1024.0, 1.0 / 64.0] {
        assert_mean(&format!("{length}"), &image(length, Method::Pt), &one, [1.0; 3], 0.01);
    }
}

/// The number of samples of each tile, which an error decides.
#[test]
fn samples_do_not_depend_on_the_brightness() {
    let samples = |light| {
        let settings = Settings { stop: StopCondition::Error(0.05), ..settings(Method::Pt) };
        let source = source(Factors { light, ..ONE });
        let plan = plan_job(source.scene(), &settings, None).expect("a plan");
        let prepared = prepare_frame(&source, &settings, 1, None).expect("a frame");
        let (cancel, progress) = (AtomicBool::new(false), AtomicU64::new(0));
        let frame = render_frame(&prepared, &settings, plan.tiling, &plan.rounds, |_| 0.0, &cancel, &progress);
        let frame = frame.expect("an image");
        (frame.samples, frame.rays)
    };
    let one = samples(1.0);
    assert!(one.0 > 16 * 12 * 16, "{one:?}");
    for light in [1.0 / 1048576.0, 1048576.0] {
        assert_eq!(samples(light), one, "{light}");
    }
}

/// A ray of the camera, so that the scene is what the tests take it for.
#[test]
fn the_room_is_closed_and_has_light() {
    let prepared = prepare_world(&source(ONE), &settings(Method::Pt), 1, None).expect("a frame");
    let origin = Vec3A::new(1.0, 0.2, 1.0) - prepared.origin.as_vec3a();
    for dir in [Vec3A::X, Vec3A::Y, Vec3A::Z, Vec3A::NEG_X, Vec3A::NEG_Y, Vec3A::NEG_Z] {
        assert!(prepared.world.intersect(&Ray { origin, dir, t_max: f32::INFINITY, time: 0.0 }).is_some(), "{dir}");
    }
    assert!(colors(&prepared, &settings(Method::Pt)).iter().all(|color| color[0] > 0.0));
}
