//! Tests that a scene's needs hold for the whole clip, and that each feature left out has a reason.

use crate::common::*;
use femc_scene::*;

fn required_features(scene: &Scene) -> RequiredFeatures {
    let (required, unused) = (scene.required_features(&scene.cameras[0]), scene.unused_features(&scene.cameras[0]));
    let denied =
        [required.media, required.glossy, required.textures, required.motion].iter().filter(|need| !**need).count();
    assert_eq!(denied, unused.len(), "a reason for each: {unused:?}");
    required
}

#[test]
fn a_plain_floor_needs_nothing_special() {
    let scene = lit_floor();
    assert_eq!(required_features(&scene), RequiredFeatures::default());
    let reasons: Vec<String> =
        scene.unused_features(&scene.cameras[0]).into_iter().map(|spared| spared.reason).collect();
    assert!(reasons[0].contains("no medium") && reasons[3].contains("`time`"), "{reasons:?}");
}

#[test]
fn a_medium_is_needed_once_it_is_placed_and_acts_at_some_time() {
    let mut scene = lit_floor();
    scene.media = vec![Medium { sigma_s: 0.0, ..medium("fog", 4) }];
    assert!(!required_features(&scene).media, "defined");
    scene.regions = vec![MediumRegion { medium: MediumId(0), bounds: RegionBounds::Everywhere, location: line(5) }];
    assert!(!required_features(&scene).media, "placed, but empty");
    scene.varies =
        vec![Vary { selector: "medium.fog.glow".into(), location: line(7), keys: vec![(0.0, 0.0), (1.0, 2.0)] }];
    assert!(required_features(&scene).media, "it glows later");
    scene.varies.clear();
    scene.regions.clear();
    scene.media[0].sigma_a = 1.0;
    scene.materials[0].inside = Some(MediumId(0));
    assert!(required_features(&scene).media, "inside a surface");
}

#[test]
fn only_surfaces_that_are_shown_at_some_time_count() {
    let mut scene = lit_floor();
    let gloss = Material { rs: tinted(0.2), map_rd: Some(ImageId(0)), ..material("gloss", 5) };
    scene.images = vec![Image::default()];
    scene.materials.push(gloss);
    assert!(!required_features(&scene).glossy, "on no surface");
    scene.objects = vec![Object { hidden: true, ..object("car", None) }];
    add_face(&mut scene.groups[0], &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 2, 9);
    scene.groups[0].faces[2].object = Some(ObjectId(0));
    assert!(!required_features(&scene).glossy && !required_features(&scene).textures, "hidden");
    scene.varies =
        vec![Vary { selector: "object.car.hidden".into(), location: line(7), keys: vec![(0.0, 1.0), (1.0, 0.0)] }];
    assert!(required_features(&scene).glossy && required_features(&scene).textures, "shown later");
    let world = std::mem::take(&mut scene.groups[0]);
    scene.groups.push(world);
    assert!(!required_features(&scene).glossy, "in a group that is placed nowhere");
}

#[test]
fn motion_is_needed_only_if_something_moves_during_the_shutter() {
    let mut scene = lit_floor();
    scene.paths =
        vec![path("p", 6, Interpolation::Linear, &[(0.0, pose(0.0, 0.0, 0.0, 0.0)), (1.0, pose(1.0, 0.0, 0.0, 0.0))])];
    scene.cameras[0].along = Some(PathId(0));
    scene.cameras[0].shutter_close = 0.5;
    assert!(!required_features(&scene).motion, "a still");
    scene.clip = Some(Clip { start: 0.0, end: 1.0, fps: 10.0 });
    assert!(required_features(&scene).motion);
    scene.cameras[0].shutter_close = 0.0;
    assert!(!required_features(&scene).motion, "the shutter stays shut");
    scene.cameras[0] = Camera { shutter_close: 0.5, ..camera("main", 3) };
    assert!(!required_features(&scene).motion, "nothing moves");
    let steps = vec![MotionStep::Along(PathId(0))];
    scene.groups[0].instances = vec![Instance { group: GroupId(1), motion: Motion { steps } }];
    scene.groups.push(Group::default());
    assert!(required_features(&scene).motion);
}
