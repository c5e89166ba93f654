//! Lights of a scene: flux, radiance, samples.

use super::midpoints;
use crate::compile::NONE;
use crate::lights::EmitterPoint;
use crate::{FrameSpec, Prepared, SceneSource, prepare_frame};
use femc_emission::LightWeights;
use femc_import::{Bundle, load_scene};
use femc_math::color::luminance;
use femc_math::glam::{DVec3, Vec3A};
use std::collections::BTreeMap;
use std::f64::consts::PI;

const SHUTTER: f32 = 0.5;

fn prepare(text: &str) -> Prepared {
    let text = format!("camera main =\n  origin .31 .42 .23\n  target .8 .6 .7\n  film 8 8\n{text}");
    let bundle = Bundle(BTreeMap::from([("a.mgf".to_owned(), text.into_bytes())]));
    let scene = load_scene(&bundle, "a.mgf").unwrap_or_else(|error| panic!("{error}")).scene;
    let spec = FrameSpec { camera: None, size: None, frame: 1, filter_radius: 0.5 };
    prepare_frame(&SceneSource::new(scene.into()), &spec, None).unwrap()
}

/// A square of 4 m2 at height 3 that faces down, a triangle of 0.5 m2 that emits from both sides, a sphere and a cylinder.
const LAMPS: &str = "m gray =\n  c\n  rd 0.5\nm gray\nv g =\n  p -9 -9 -9\nsph g 1\n\
    m one =\n  sides 1\n  c\n  ed 100\nm one\n\
    v a =\n  p -1 -1 3\nv b =\n  p -1 1 3\nv c =\n  p 1 1 3\nv d =\n  p 1 -1 3\nf a b c d\n\
    m two =\n  sides 2\n  c\n  ed 60\nm two\nv e =\n  p 5 0 0\nv f =\n  p 6 0 0\nv h =\n  p 5 0 1\nf e f h\n\
    m one\nv s =\n  p 0 8 2\nsph s 0.25\nv i =\n  p 0 -8 0\nv j =\n  p 0 -8 2\ncyl i 0.1 j\n";

/// Returns the lights in the order of LAMPS: by flux, lm, and center in the scene's frame.
fn lights(prepared: &Prepared) -> Vec<(f64, DVec3)> {
    let lights = &prepared.lights;
    let of = |light: u32| {
        let center = lights.bounds(light).center().as_dvec3() + prepared.origin;
        (f64::from(lights.power(light)), center)
    };
    (0..lights.len() as u32).map(of).collect()
}

#[test]
fn lights_have_the_flux_of_emittance_times_area() {
    let prepared = prepare(LAMPS);
    let want = [
        (400.0, DVec3::new(0.0, 0.0, 3.0)),
        (60.0, DVec3::new(5.5, 0.0, 0.5)),
        (100.0 * 4.0 * PI * 0.0625, DVec3::new(0.0, 8.0, 2.0)),
        (100.0 * 2.0 * PI * 0.1 * 2.0, DVec3::new(0.0, -8.0, 1.0)),
    ];
    let found = lights(&prepared);
    assert_eq!(found.len(), 4);
    for (flux, center) in want {
        let light =
            found.iter().find(|light| light.1.distance(center) < 1e-3).unwrap_or_else(|| panic!("{center} {found:?}"));
        assert!((light.0 / flux - 1.0).abs() < 1e-4, "{center}: {} lm, not {flux}", light.0);
    }
    assert!((0..4).all(|light| prepared.lights.can_be_hit(light)));
}

fn light_at(prepared: &Prepared, center: DVec3) -> u32 {
    lights(prepared).iter().position(|light| light.1.distance(center) < 1e-3).expect("a light") as u32
}

#[test]
fn radiance_is_emittance_over_pi_on_the_sides_that_emit() {
    let prepared = prepare(LAMPS);
    let radiance = |center: [f64; 3], normal: Vec3A, dir: Vec3A| {
        let light = light_at(&prepared, DVec3::from_array(center));
        let (lights, point) = (&prepared.lights, EmitterPoint { light, normal, parametric: [0.2; 2] });
        let value = lights.radiance(&prepared.world, &prepared.textures, &point, dir, SHUTTER);
        f64::from(luminance(value))
    };
    let down = Vec3A::new(0.6, 0.0, -0.8);
    assert!((radiance([0.0, 0.0, 3.0], Vec3A::NEG_Z, down) - 100.0 / PI).abs() < 1e-3);
    assert_eq!(radiance([0.0, 0.0, 3.0], Vec3A::NEG_Z, -down), 0.0, "the back is dark");
    for side in [Vec3A::Y, Vec3A::NEG_Y] {
        assert!((radiance([5.5, 0.0, 0.5], Vec3A::NEG_Y, side) - 60.0 / PI).abs() < 1e-3, "{side}");
    }
}

/// Irradiance of a point with normal z below the square, from samples of the light and by quadrature over its area.
#[test]
fn samples_of_a_light_estimate_its_irradiance() {
    let prepared = prepare(LAMPS);
    let square = light_at(&prepared, DVec3::new(0.0, 0.0, 3.0));
    let point = DVec3::new(0.7, -1.4, 0.5);
    let reference = (point - prepared.origin).as_vec3a();
    let (mut sum, mut quadrature) = (0.0, 0.0);
    const COUNT: u32 = 60;
    for u in midpoints(COUNT) {
        for v in midpoints(COUNT) {
            let sample = prepared
                .lights
                .sample_light(&prepared.world, &prepared.textures, square, reference, SHUTTER, [u as f32, v as f32])
                .expect("a sample");
            let way = sample.position.as_dvec3() + prepared.origin - point;
            assert!((way.z - 2.5).abs() < 1e-4 && way.normalize().distance(sample.dir.as_dvec3()) < 1e-4);
            let pdf = prepared.lights.pdf(
                &prepared.world,
                square,
                reference,
                SHUTTER,
                (sample.position, sample.normal),
                sample.dir,
            );
            assert!((pdf / sample.pdf - 1.0).abs() < 1e-3, "{pdf} {}", sample.pdf);
            sum += f64::from(luminance(sample.radiance)) * f64::from(sample.dir.z) / f64::from(sample.pdf);
            let way = DVec3::new(2.0 * u - 1.0, 2.0 * v - 1.0, 3.0) - point;
            quadrature += 4.0 * 100.0 / PI * way.z * way.z / way.length_squared().powi(2);
        }
    }
    assert!((sum / quadrature - 1.0).abs() < 2e-3, "{sum} {quadrature}");
    let (corners, luminance, both) = prepared.lights.uniform_polygon(square).expect("a uniform polygon");
    assert!(corners.len() == 4 && !both && (luminance.x - 100.0 / PI as f32).abs() < 1e-3, "{corners:?} {luminance}");
    let turn: Vec3A = (2..4).map(|k| femc_math::cross(corners[k - 1] - corners[0], corners[k] - corners[0])).sum();
    assert!((turn * 0.5).distance(Vec3A::new(0.0, 0.0, -4.0)) < 1e-4, "counterclockwise about the front: {turn}");
    let sphere = light_at(&prepared, DVec3::new(0.0, 8.0, 2.0));
    assert!(prepared.lights.uniform_polygon(sphere).is_none());
}

#[test]
fn probabilities_of_the_lights_add_up_to_one() {
    let prepared = prepare(LAMPS);
    let lights = &prepared.lights;
    let context = lights.point_context((DVec3::new(0.7, 1.4, 0.5) - prepared.origin).as_vec3a(), Vec3A::ZERO, None);
    let mut weights = LightWeights::default();
    lights.weigh(&context, &mut weights);
    let probabilities = [0, 1, 2, 3].map(|light| f64::from(lights.probability(&weights, &context, light)));
    assert!((probabilities.iter().sum::<f64>() - 1.0).abs() < 1e-5, "{probabilities:?}");
    let mut counts = [0u32; 4];
    for u in midpoints(4000) {
        let (light, probability) = lights.choose(&weights, &context, || u).expect("a light");
        assert!((f64::from(probability) - probabilities[light as usize]).abs() < 1e-5);
        counts[light as usize] += 1;
    }
    for (count, probability) in counts.into_iter().zip(probabilities) {
        assert!((f64::from(count) / 4000.0 - probability).abs() < 1e-3, "{counts:?} {probabilities:?}");
    }
}

/// The light of a surface, and that of the ray that hits it, are equal.
#[test]
fn hit_surfaces_know_their_light_and_their_side() {
    let prepared = prepare(LAMPS);
    let origin = (DVec3::new(0.5, 0.5, 0.0) - prepared.origin).as_vec3a();
    let ray = femc_geometry::Ray { origin, dir: Vec3A::Z, t_max: f32::INFINITY, time: SHUTTER };
    let hit = prepared.world.intersect(&ray).expect("the square");
    let point = prepared.shading_point(&ray, &hit);
    assert_eq!(point.light, light_at(&prepared, DVec3::new(0.0, 0.0, 3.0)));
    assert!(point.normal.distance(Vec3A::NEG_Z) < 1e-6 && (hit.t - 3.0).abs() < 1e-5);
    let toward = (DVec3::new(-9.0, -9.0, -9.0) - prepared.origin).as_vec3a() - origin;
    let ray = femc_geometry::Ray { dir: toward.normalize(), ..ray };
    let hit = prepared.world.intersect(&ray).expect("the gray sphere");
    let point = prepared.shading_point(&ray, &hit);
    assert!(point.light == NONE && (point.normal + ray.dir).length() < 1e-3, "{point:?}");
}
