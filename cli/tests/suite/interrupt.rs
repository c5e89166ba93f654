//! Tests of interrupted renders that resume.

use crate::common;
use crate::common::{TestFolder, TestProcess, file_names};
use std::time::SystemTime;

const LINE: &str = "render fog.mgf -o out --spp 12 --size 64x64 --threads 1";

/// Waits until frame 1 is finished, and checks that frame 8 is not.
fn wait_for_first_frame(dir: &TestFolder, render: &mut TestProcess) {
    let out = dir.path("out");
    render.wait_until("its first frame", || out.join("fog.0001.exr").exists());
    assert!(render.is_running() && !out.join("fog.0008.exr").exists(), "it is stopped half way");
}

fn modified_time(dir: &TestFolder) -> SystemTime {
    dir.path("out/fog.0001.exr").metadata().and_then(|data| data.modified()).expect("a time")
}

/// Renders the same frames without interruption.
fn reference(dir: &TestFolder) -> Vec<u32> {
    dir.run(&LINE.replace("-o out", "-o reference").replace("--threads 1", "--threads 2")).exits(0);
    common::pixels(&dir.path("reference/fog.0008.exr"))
}

fn assert_resumes(dir: &TestFolder) {
    let before = modified_time(dir);
    let ran = dir.run(&format!("{LINE} --json")).exits(0);
    assert_eq!(file_names(&dir.path("out")).len(), 8);
    assert!(ran.json()["rendered"].as_u64().is_some_and(|frames| (1..8).contains(&frames)), "{}", ran.stdout());
    assert_eq!(modified_time(dir), before, "a finished frame is not rendered again");
    assert_eq!(common::pixels(&dir.path("out/fog.0008.exr")), reference(dir));
    assert!(!dir.path("out/.femc").exists(), "nothing is left to resume");
}

#[test]
fn ctrl_c_ends_with_3_and_the_same_command_goes_on() {
    let dir = TestFolder::new();
    let mut render = dir.start(LINE);
    wait_for_first_frame(&dir, &mut render);
    render.signal("INT");
    let ran = render.end().exits(3);
    assert!(ran.stderr().contains("rerun the command to resume"), "{}", ran.stderr());
    assert_resumes(&dir);
}

#[test]
fn a_killed_render_goes_on_where_it_stopped() {
    let dir = TestFolder::new();
    let mut render = dir.start(LINE);
    wait_for_first_frame(&dir, &mut render);
    assert!(render.kill(), "the kill came before the end");
    assert_resumes(&dir);
}

#[test]
fn other_settings_do_not_go_on_from_a_stopped_render() {
    let dir = TestFolder::new();
    let mut render = dir.start(LINE);
    wait_for_first_frame(&dir, &mut render);
    assert!(render.kill(), "the kill came before the end");
    let ran = dir.run("render fog.mgf -o out --spp 1 --size 64x64 --json").exits(0);
    assert_eq!(ran.json()["rendered"], 8);
    assert!(ran.stderr().contains("rendering them again"), "{}", ran.stderr());
}

#[test]
fn two_renders_into_one_place_do_not_meet() {
    let dir = TestFolder::new();
    let mut render = dir.start(LINE);
    wait_for_first_frame(&dir, &mut render);
    let ran = dir.run(LINE).exits(1);
    assert!(ran.stderr().contains("another femc"), "{}", ran.stderr());
    assert!(render.kill());
}
