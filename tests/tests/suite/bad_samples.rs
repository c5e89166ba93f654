//! Samples that are not numbers are counted and reported, and their pixel stays right.

use femc_film::{BadKind, Frame};
use femc_math::Rgb;
use femc_math::color::LUMINANCE_WEIGHTS;
use femc_pipeline::{Outputs, RenderTask, SceneSource, Settings, StopCondition, plan_job, prepare_frame};
use femc_prepared::Prepared;
use femc_scattering::Bsdf;
use femc_tests::parse_scene;
use std::sync::Arc;

/// A furnace with a ball in it. Samples that hit the ball are made bad.
const FURNACE: &str = "camera main =\n origin 0 0 0\n target 1 0 0\n fov 60\n film 8 8\n\
    m wall =\n sides 2\n c\n rd .5\n ed 3.14159265358979\nm flaw =\n sides 2\n c\n rd .5\n ed 3.14159265358979\n\
    v a =\n p -1 -1 -1\nv b =\n p 1 -1 -1\nv c =\n p 1 1 -1\nv d =\n p -1 1 -1\nm wall\nprism a b c d -2\n\
    v s =\n p .6 .1 .1\nm flaw\nsph s .1\n";

/// Renders with `plant` applied to the prepared frame.
fn render(plant: impl FnOnce(&mut Prepared)) -> Frame {
    let scene = parse_scene(FURNACE);
    let settings = Settings { stop: StopCondition::Spp(64), seed: 3, ..Settings::default() };
    let plan = plan_job(&scene, &settings, Some(&[1])).unwrap_or_else(|error| panic!("{error}"));
    let mut prepared =
        prepare_frame(&SceneSource::new(scene.clone()), &settings, 1, None).unwrap_or_else(|error| panic!("{error}"));
    plant(&mut prepared);
    let mut film = Frame::new(plan.tiling);
    for rect in plan.tiling.rects() {
        let done = RenderTask::new(&prepared, &settings, rect, 0..64).render(Outputs::default());
        film.insert(done.unwrap_or_else(|error| panic!("{error}")).tile).unwrap_or_else(|error| panic!("{error}"));
    }
    film
}

/// Sets the reflectance of the material `flaw` to `rd`.
fn flaw(prepared: &mut Prepared, rd: Rgb) {
    let flaw = prepared.scene.materials.iter().position(|m| m.name == "flaw").expect("the material is there");
    let Bsdf::Diffuse(bsdf) = &mut Arc::make_mut(&mut prepared.materials)[flaw].bsdf else {
        panic!("the flaw is not diffuse")
    };
    bsdf.rd = rd;
}

#[test]
fn non_finite_reflectance_is_counted_and_spoils_no_other_sample() {
    let clean = render(|_| {});
    assert_eq!(clean.bad_samples().total(), 0);
    for (what, rd) in [("one channel", Rgb::new(0.5, f32::NAN, 0.5)), ("all", Rgb::NAN), ("infinite", Rgb::INFINITY)] {
        let film = render(|prepared| flaw(prepared, rd));
        let bad = film.bad_samples();
        let of_kind = bad.count(BadKind::NotANumber) + bad.count(BadKind::Infinite);
        println!("{what}: {} of {} samples are bad, {of_kind} of them not finite", bad.total(), 64 * 64);
        assert!(of_kind > 100 && of_kind == bad.total(), "{what}: {bad:?}");
        // Every good sample of the furnace has the 1 cd/m2 that its first wall emits, and at most 2 on average.
        let image = film.resolve();
        let luminance = |p: &[f32; 3]| Rgb::from_array(*p).dot(LUMINANCE_WEIGHTS);
        let left: Vec<f32> = image.color.pixels.iter().map(luminance).filter(|&l| l > 0.0).collect();
        assert!(left.len() >= 32 && left.iter().all(|l| (1.0..3.0).contains(l)), "{what}: {left:?}");
    }
}
