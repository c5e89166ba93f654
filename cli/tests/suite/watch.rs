//! Tests of the preview of `femc watch`.
#![cfg(unix)]

use crate::common;
use crate::common::{TestFolder, TestProcess};
use femc_film::{ToneCurve, exr};

/// Returns the picture of an EXR file, made like a preview.
fn picture(dir: &TestFolder, name: &str) -> Vec<u8> {
    let image = exr::read(&dir.path(name)).expect("an EXR file").image;
    ToneCurve::auto([&image]).picture(&image).to_png().expect("a PNG")
}

/// Starts a farm, and a worker that stops in the middle of a frame whose tiles are reduced in pairs.
fn half_rendered_farm(dir: &TestFolder) -> (TestProcess, TestProcess, String, String) {
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --lease 1m";
    let mut farm = dir.start(line);
    let url = farm.address();
    let mut worker = dir.start(&format!("worker --join {url} --threads 1"));
    let mut submit = dir.command(&format!("submit fog.mgf --spp 200 --size 64x64 --frames 1 --server {url}"));
    let job = TestProcess::spawn(submit.env("FEMC_PRETEND", "fan=2")).end().exits(0).stdout().trim().to_owned();
    let tiles = || common::status(dir, &url, &job)["active"][0]["tiles_done"].as_u64().unwrap_or(0);
    farm.wait_until("three tiles", || tiles() >= 3);
    worker.signal("STOP");
    (farm, worker, url, job)
}

#[test]
fn preview_file_and_drawing_follow_the_frame_until_it_is_done() {
    let dir = TestFolder::new();
    let (_farm, mut worker, url, job) = half_rendered_farm(&dir);
    let line = format!("watch {job} --preview --preview-to now.png --server {url}");
    let mut watch = dir.start_as("watch", &line);
    watch.wait_until("a picture", || dir.path("now.png").exists());
    watch.wait_until("a drawing", || dir.read("watch.err").contains("▀\x1b[0m\n"));
    dir.run(&format!("fetch {job} -o out --partial --server {url}")).exits(1);
    let now = std::fs::read(dir.path("now.png")).expect("a file");
    assert!(now == picture(&dir, "out/fog.0001.partial.exr"), "the picture is what there is of the frame");
    worker.signal("CONT");
    watch.end().exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    let last = std::fs::read(dir.path("now.png")).expect("a file");
    assert!(last != now && last == picture(&dir, "out/fog.0001.exr"), "at the end it is the finished frame");
}

#[test]
fn preview_is_not_drawn_unless_requested_or_on_a_terminal() {
    let dir = TestFolder::new();
    let (_farm, mut worker, url, job) = half_rendered_farm(&dir);
    let mut watches = ["", "--preview=auto", "--preview=never", "--preview=always --quiet"].map(|flag| {
        let name = format!("watch{}", flag.replace(['-', '=', ' '], ""));
        (dir.start_as(&name, &format!("watch {job} {flag} --color always --server {url}")), name)
    });
    std::thread::sleep(std::time::Duration::from_secs(3));
    worker.signal("CONT");
    for (watch, name) in &mut watches {
        watch.end().exits(0);
        assert!(!dir.read(&format!("{name}.err")).contains('▀'), "{name}");
    }
    let refused = dir.run(&format!("watch {job} --preview-to now.jpg --server {url}")).exits(2);
    assert!(refused.stderr().contains("FILE.png"), "{}", refused.stderr());
}

#[test]
fn a_picture_that_cannot_be_written_is_a_failure() {
    let dir = TestFolder::new();
    let (_farm, mut worker, url, job) = half_rendered_farm(&dir);
    dir.write("taken", "a file");
    let ran = dir.run(&format!("watch {job} --preview-to taken/now.png --server {url}")).exits(1);
    assert!(ran.stderr().contains("taken"), "{}", ran.stderr());
    worker.signal("CONT");
}
