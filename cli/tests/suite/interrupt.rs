//! Tests of interrupted renders that resume.

use crate::common;
use crate::common::{Place, Running, names};
use std::time::SystemTime;

const LINE: &str = "render fog.mgf -o out --spp 12 --size 64x64 --threads 1";

/// Waits until frame 1 is finished, and checks that frame 8 is not.
fn under_way(place: &Place, render: &mut Running) {
    let out = place.path("out");
    render.wait_until("its first frame", || out.join("fog.0001.exr").exists());
    assert!(render.is_running() && !out.join("fog.0008.exr").exists(), "it is stopped half way");
}

fn written(place: &Place) -> SystemTime {
    place.path("out/fog.0001.exr").metadata().and_then(|data| data.modified()).expect("a time")
}

/// Renders the same frames without interruption.
fn reference(place: &Place) -> Vec<u32> {
    place.run(&LINE.replace("-o out", "-o reference").replace("--threads 1", "--threads 2")).exits(0);
    common::pixels(&place.path("reference/fog.0008.exr"))
}

fn goes_on(place: &Place) {
    let before = written(place);
    let ran = place.run(&format!("{LINE} --json")).exits(0);
    assert_eq!(names(&place.path("out")).len(), 8);
    assert!(ran.json()["rendered"].as_u64().is_some_and(|frames| (1..8).contains(&frames)), "{}", ran.stdout());
    assert_eq!(written(place), before, "a finished frame is not rendered again");
    assert_eq!(common::pixels(&place.path("out/fog.0008.exr")), reference(place));
    assert!(!place.path("out/.femc").exists(), "nothing is left to resume");
}

#[test]
fn ctrl_c_ends_with_3_and_the_same_command_goes_on() {
    let place = Place::new();
    let mut render = place.start(LINE);
    under_way(&place, &mut render);
    render.signal("INT");
    let ran = render.end().exits(3);
    assert!(ran.stderr().contains("rerun the command to resume"), "{}", ran.stderr());
    goes_on(&place);
}

#[test]
fn a_killed_render_goes_on_where_it_stopped() {
    let place = Place::new();
    let mut render = place.start(LINE);
    under_way(&place, &mut render);
    assert!(render.kill(), "the kill came before the end");
    goes_on(&place);
}

#[test]
fn other_settings_do_not_go_on_from_a_stopped_render() {
    let place = Place::new();
    let mut render = place.start(LINE);
    under_way(&place, &mut render);
    assert!(render.kill(), "the kill came before the end");
    let ran = place.run("render fog.mgf -o out --spp 1 --size 64x64 --json").exits(0);
    assert_eq!(ran.json()["rendered"], 8);
    assert!(ran.stderr().contains("rendering them again"), "{}", ran.stderr());
}

#[test]
fn two_renders_into_one_place_do_not_meet() {
    let place = Place::new();
    let mut render = place.start(LINE);
    under_way(&place, &mut render);
    let ran = place.run(LINE).exits(1);
    assert!(ran.stderr().contains("another femc"), "{}", ran.stderr());
    assert!(render.kill());
}
