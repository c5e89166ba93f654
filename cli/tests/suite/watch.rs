//! Tests of the preview of `femc watch`.
#![cfg(unix)]

use crate::common;
use crate::common::{Place, Running};
use femc_film::{ToneCurve, exr};

/// Returns the picture of an EXR file, made like a preview.
fn picture(place: &Place, name: &str) -> Vec<u8> {
    let image = exr::read(&place.path(name)).expect("an EXR file").image;
    ToneCurve::auto([&image]).picture(&image).to_png().expect("a PNG")
}

/// Starts a farm, and a worker that stops in the middle of a frame whose tiles are reduced in pairs.
fn half_done(place: &Place) -> (Running, Running, String, String) {
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --lease 1m";
    let mut farm = place.start(line);
    let url = farm.address();
    let mut worker = place.start(&format!("worker --join {url} --threads 1"));
    let mut submit = place.command(&format!("submit fog.mgf --spp 200 --size 64x64 --frames 1 --server {url}"));
    let job = Running::of(submit.env("FEMC_PRETEND", "fan=2")).end().exits(0).stdout().trim().to_owned();
    let tiles = || common::status(place, &url, &job)["active"][0]["tiles_done"].as_u64().unwrap_or(0);
    farm.wait_until("three tiles", || tiles() >= 3);
    worker.signal("STOP");
    (farm, worker, url, job)
}

#[test]
fn preview_file_and_drawing_follow_the_frame_until_it_is_done() {
    let place = Place::new();
    let (_farm, mut worker, url, job) = half_done(&place);
    let line = format!("watch {job} --preview --preview-to now.png --server {url}");
    let mut watch = place.start_as("watch", &line);
    watch.wait_until("a picture", || place.path("now.png").exists());
    watch.wait_until("a drawing", || place.read("watch.err").contains("▀\x1b[0m\n"));
    place.run(&format!("fetch {job} -o out --partial --server {url}")).exits(1);
    let now = std::fs::read(place.path("now.png")).expect("a file");
    assert!(now == picture(&place, "out/fog.0001.partial.exr"), "the picture is what there is of the frame");
    worker.signal("CONT");
    watch.end().exits(0);
    place.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    let last = std::fs::read(place.path("now.png")).expect("a file");
    assert!(last != now && last == picture(&place, "out/fog.0001.exr"), "at the end it is the finished frame");
}

#[test]
fn preview_is_not_drawn_unless_requested_or_on_a_terminal() {
    let place = Place::new();
    let (_farm, mut worker, url, job) = half_done(&place);
    let mut watches = ["", "--preview=auto", "--preview=never", "--preview=always --quiet"].map(|flag| {
        let name = format!("watch{}", flag.replace(['-', '=', ' '], ""));
        (place.start_as(&name, &format!("watch {job} {flag} --color always --server {url}")), name)
    });
    std::thread::sleep(std::time::Duration::from_secs(3));
    worker.signal("CONT");
    for (watch, name) in &mut watches {
        watch.end().exits(0);
        assert!(!place.read(&format!("{name}.err")).contains('▀'), "{name}");
    }
    let refused = place.run(&format!("watch {job} --preview-to now.jpg --server {url}")).exits(2);
    assert!(refused.stderr().contains("FILE.png"), "{}", refused.stderr());
}

#[test]
fn a_picture_that_cannot_be_written_is_a_failure() {
    let place = Place::new();
    let (_farm, mut worker, url, job) = half_done(&place);
    place.write("taken", "a file");
    let ran = place.run(&format!("watch {job} --preview-to taken/now.png --server {url}")).exits(1);
    assert!(ran.stderr().contains("taken"), "{}", ran.stderr());
    worker.signal("CONT");
}
