//! Frames of variants share what is equal between them, and have the same pixels as frames prepared alone.

use femc_film::{Frame, FrameImage, pixel_digest};
use femc_math::glam::DVec3;
use femc_pipeline::{Outputs, Prepared, RenderTask, SceneSource, Settings, StopCondition, plan_job, prepare_frame};
use femc_tests::parse_scene;
use std::sync::Arc;

const ROOM: &str = "camera main =\n origin 0.2 0 0\n target 1 0 0\n fov 60\n film 16 16\n\
    medium fog =\n sigma_s .2\nmedium_everywhere\n\
    m wall =\n sides 2\n rd .5\nm lamp =\n sides 2\n ed 30\n\
    v a =\n p -1 -1 -1\nv b =\n p 1 -1 -1\nv c =\n p 1 1 -1\nv d =\n p -1 1 -1\nm wall\nprism a b c d -2\n\
    v s =\n p .6 .1 .1\nm lamp\nsph s .1\n";

fn source() -> SceneSource {
    SceneSource::new(parse_scene(&ROOM.replace("medium_everywhere", "mbox fog -1 -1 -1 1 1 1")))
}

fn settings(overrides: &[(&str, f64)]) -> Settings {
    let overrides = overrides.iter().map(|(selector, value)| ((*selector).to_owned(), *value)).collect();
    Settings { stop: StopCondition::Spp(4), overrides, ..Settings::default() }
}

fn variant(base: &SceneSource, settings: &Settings, previous: Option<&Prepared>) -> Prepared {
    let source = base.variant(&settings.overrides).unwrap_or_else(|error| panic!("{error}"));
    prepare_frame(&source, settings, 1, previous).unwrap_or_else(|error| panic!("{error}"))
}

fn render(prepared: &Prepared, settings: &Settings) -> FrameImage {
    let plan = plan_job(&prepared.scene, settings, Some(&[1])).unwrap_or_else(|error| panic!("{error}"));
    let mut film = Frame::new(plan.tiling);
    for rect in plan.tiling.rects() {
        let done = RenderTask::new(prepared, settings, rect, 0..4).render(Outputs::default());
        film.insert(done.unwrap_or_else(|error| panic!("{error}")).tile).unwrap_or_else(|error| panic!("{error}"));
    }
    film.resolve()
}

#[test]
fn cameras_share_world_fogs_share_surfaces_and_pixels_stay_same() {
    let base = source();
    let first = variant(&base, &settings(&[]), None);
    for (change, same_world, same_surfaces) in [
        (("camera.main.fov", 50.0), true, true),
        (("camera.main.origin.x", 0.4), true, true),
        (("camera.main.origin.x", -100.0), true, true),
        // The camera is too far from the scene's center to use that as the frame's origin.
        (("camera.main.origin.x", -200.0), false, false),
        (("medium.fog.sigma_s", 0.4), false, true),
        (("material.lamp.ed", 60.0), false, true),
        (("material.lamp.ed", 0.0), false, false),
    ] {
        let settings = settings(&[change]);
        let (alone, shared) = (variant(&base, &settings, None), variant(&base, &settings, Some(&first)));
        assert_eq!(Arc::ptr_eq(&shared.world, &first.world), same_world, "{change:?}");
        assert_eq!(shared.frame_key.world == first.frame_key.world, same_world, "{change:?}");
        let surfaces = |prepared: &Prepared| prepared.instances[0].compiled.clone();
        assert_eq!(Arc::ptr_eq(&surfaces(&shared), &surfaces(&first)), same_surfaces, "{change:?}");
        assert_ne!(shared.frame_key.view, first.frame_key.view, "{change:?}");
        let [alone, shared] = [&alone, &shared].map(|prepared| pixel_digest(&render(prepared, &settings).color));
        assert_eq!(alone, shared, "{change:?}");
    }
}

#[test]
fn frames_static_in_shutter_share_world_and_pixels_stay_same() {
    let text = ROOM.replace("medium_everywhere", "").replace("film 16 16\n", "film 16 16\n shutter 0 .5\n").replace(
        "v s =\n p .6 .1 .1\nm lamp\nsph s .1\n",
        "time 0 4 10\npath drive = spline\n key 0\n key 1 -t .2 0 0\n key 3 -t .2 0 0\n key 4 -t .2 .3 0 -ry 20\n\
         v s =\n p .4 .1 .1\nm lamp\nxf -path drive\nsph s .1\nxf\n",
    );
    let (source, settings) = (SceneSource::new(parse_scene(&text)), settings(&[]));
    let frame = |number: u32, previous: Option<&Prepared>| {
        prepare_frame(&source, &settings, number, previous).unwrap_or_else(|error| panic!("{error}"))
    };
    for (first, second, is_shared) in [(12, 25, true), (25, 12, true), (5, 6, false), (12, 5, false), (25, 31, false)] {
        let first = frame(first, None);
        let (alone, after) = (frame(second, None), frame(second, Some(&first)));
        assert_eq!(Arc::ptr_eq(&after.world, &first.world), is_shared, "frame {second}");
        assert_eq!(after.frame_key.content == first.frame_key.content, is_shared, "frame {second}");
        let [alone, after] = [&alone, &after].map(|prepared| pixel_digest(&render(prepared, &settings).color));
        assert_eq!(alone, after, "frame {second}");
    }
}

#[test]
fn nothing_is_shared_between_different_scenes() {
    let (base, other) = (
        source(),
        SceneSource::new(parse_scene(&ROOM.replace("medium_everywhere", "").replace("sph s .1", "sph s .2"))),
    );
    let (first, settings) = (variant(&base, &settings(&[]), None), settings(&[]));
    let [alone, after] = [None, Some(&first)].map(|previous| render(&variant(&other, &settings, previous), &settings));
    assert_eq!(pixel_digest(&alone.color), pixel_digest(&after.color));
}

#[test]
fn cameras_share_scene_center_while_precision_suffices() {
    let at = |place: [f64; 3]| {
        let corner = |x: f64, y: f64| format!("p {} {} {}", place[0] + x, place[1] + y, place[2]);
        SceneSource::new(parse_scene(&format!(
            "camera main =\n origin 0 0 5\n target 1 0 0\n fov 60\n film 16 16\nm wall =\n sides 2\n rd .5\n\
             v a =\n {}\nv b =\n {}\nv c =\n {}\nm wall\nf a b c\n\
             v d =\n p 0 0 0\nv e =\n p 1 0 0\nv g =\n p 0 1 0\no far\nxf -t {} {} {}\nf d e g\nxf\no\n",
            corner(0.0, 0.0),
            corner(4.0, 0.0),
            corner(0.0, 6.0),
            place[0] + 99.0,
            place[1],
            place[2]
        )))
    };
    for place in [[0.0; 3], [4e6, -3e6, 100.0]] {
        let (source, here) = (at(place), DVec3::from(place));
        let middle = source.origin(here);
        assert_eq!(middle, here + DVec3::new(50.0, 3.0, 0.0));
        assert_eq!(source.origin(here + DVec3::new(170.0, -90.0, 40.0)), middle);
        let far = here + DVec3::new(1000.3, 0.0, 0.0);
        assert!((source.origin(far) - far).abs().max_element() <= 16.0, "{}", source.origin(far));
        assert_eq!(source.origin(far), source.origin(far + DVec3::new(0.1, 0.1, 0.1)));
    }
}
