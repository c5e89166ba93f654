//! Tests of stills, contact sheets and clips from a farm.
#![cfg(unix)]

use crate::common;
use crate::common::{TestFolder, TestProcess, pixels, start_coordinator, status, submit, workers};
use femc_film::Picture;
use std::os::unix::fs::PermissionsExt;

const FRAMES: &str = "--frames 1..3 --size 48x32";
const OUTPUT_FLAGS: &str = "--video clip.png --contact-sheet sheet.png --preview";

/// Starts workers with one thread each.
fn start_workers(dir: &TestFolder, url: &str, count: u32) -> Vec<TestProcess> {
    (0..count).map(|_| dir.start(&format!("worker --join {url} --threads 1"))).collect()
}

/// Fetches the outputs of a job, rendered by this many workers, into a folder of this name.
fn render_and_fetch(dir: &TestFolder, out: &str, workers: u32, settings: &str) {
    let farm = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&farm, 0);
    let _workers = start_workers(&farm, &url, workers);
    let job = submit(&farm, &url, settings);
    farm.run(&format!("watch {job} --server {url}")).exits(0);
    let folder = dir.path(out);
    farm.run(&format!("fetch {job} -o {} --server {url}", folder.display())).exits(0);
}

/// Returns the number of frames of an animated PNG.
fn frames_of(clip: &[u8]) -> u32 {
    let at = clip.windows(4).position(|name| name == b"acTL").expect("an animated PNG") + 4;
    u32::from_be_bytes(clip[at..at + 4].try_into().expect("four bytes"))
}

#[test]
fn clip_outputs_ignore_worker_count_and_leave_images_unchanged() {
    let dir = TestFolder::new();
    let settings = format!("{FRAMES} --error 0.3");
    render_and_fetch(&dir, "one", 1, &format!("{settings} {OUTPUT_FLAGS}"));
    render_and_fetch(&dir, "three", 3, &format!("{settings} {OUTPUT_FLAGS}"));
    render_and_fetch(&dir, "plain", 1, &settings);
    let read = |folder: &str, name: &str| std::fs::read(dir.path(folder).join(name)).expect(name);
    let (stills, images) = ([1, 2, 3].map(|n| format!("fog.000{n}.png")), [1, 2, 3].map(|n| format!("fog.000{n}.exr")));
    let mut all = [&["clip.png".to_owned()][..], &images, &stills, &["sheet.png".to_owned()]].concat();
    all.sort();
    assert_eq!(common::file_names(&dir.path("three")), all);
    assert_eq!(common::file_names(&dir.path("plain")), images);
    for name in stills.iter().chain([&"clip.png".to_owned(), &"sheet.png".to_owned()]) {
        assert!(read("one", name) == read("three", name), "{name}");
    }
    for name in &images {
        assert_eq!(pixels(&dir.path("three").join(name)), pixels(&dir.path("plain").join(name)), "{name}");
    }
    assert_eq!(frames_of(&read("one", "clip.png")), 3);
    let still = |name: &String| Picture::from_png(&read("one", name)).expect("a picture");
    let [first, _, last] = [0, 1, 2].map(|frame| still(&stills[frame]));
    assert_eq!((first.width, first.height), (48, 32));
    assert_ne!(first, last, "the fog thickens");
    // All stills have one exposure: a brighter pixel of the scene is brighter in its still.
    let [dark, bright] = [0, 2].map(|frame| common::film(&dir.path("one").join(&images[frame])).rgb);
    let [shown_dark, shown_bright] = [first, last].map(|picture| picture.pixels.concat());
    let pairs = dark.iter().zip(&bright).zip(shown_dark.iter().zip(&shown_bright));
    let gray = |(_, (a, b)): &((&f32, &f32), (&u8, &u8))| **a < 250 && **b < 250 && a.abs_diff(**b) > 3;
    let clear: Vec<bool> =
        pairs.filter(gray).map(|((a, b), (shown_a, shown_b))| (a < b) == (shown_a < shown_b)).collect();
    let agree = clear.iter().filter(|agrees| **agrees).count() as f64 / clear.len() as f64;
    assert!(clear.len() > 100 && agree > 0.98, "{agree} of {}", clear.len());
}

#[test]
fn painted_clip_has_same_bytes_for_any_workers_despite_a_kill() {
    let dir = TestFolder::new();
    let settings = "--frames 1..4 --size 48x32 --spp 4 --style oil";
    render_and_fetch(&dir, "one", 1, settings);
    let farm = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&farm, 0);
    let mut workers = start_workers(&farm, &url, 3);
    let job = submit(&farm, &url, settings);
    let mut doomed = workers.pop().expect("three");
    doomed.wait_until("a frame is done", || status(&farm, &url, &job)["frames_done"].as_u64() > Some(0));
    doomed.kill();
    farm.run(&format!("watch {job} --server {url}")).exits(0);
    let folder = dir.path("three");
    let json = farm.run(&format!("fetch {job} -o {} --server {url} --json", folder.display())).exits(0).json();
    assert_eq!(json["painted"].as_array().map(Vec::len), Some(4), "{json}");
    let read = |folder: &str, frame: u32| {
        std::fs::read(dir.path(folder).join(format!("fog.000{frame}.painted.png"))).expect("painted")
    };
    for frame in 1..=4 {
        assert!(read("one", frame) == read("three", frame), "frame {frame}");
        let painted = Picture::from_png(&read("one", frame)).expect("a picture");
        assert_eq!((painted.width, painted.height), (48, 32));
    }
    assert!(read("one", 1) != read("one", 4), "the fog thickens");
    let ran = farm.run(&format!("submit fog.mgf --style mine.png --server {url}")).exits(2);
    assert!(ran.stderr().contains("--style mine.png"), "{}", ran.stderr());
}

#[test]
fn clip_waits_for_a_worker_with_ffmpeg_and_has_every_frame() {
    let dir = TestFolder::new();
    std::fs::create_dir(dir.path("bin")).expect("made");
    dir.write(
        "bin/ffmpeg",
        "#!/bin/sh\n[ \"$1\" = -version ] && echo ffmpeg version 7.1-test and so on && exit 0\n\
         for out; do :; done\necho \"$*\" > \"${0%/*}/../told\"\nexec /bin/cat > \"$out\"\n",
    );
    std::fs::set_permissions(dir.path("bin/ffmpeg"), PermissionsExt::from_mode(0o755)).expect("made executable");
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let start = |path: &str| {
        TestProcess::spawn(
            dir.command(&format!("worker --join {url} --threads 1 --name {path}")).env("PATH", dir.path(path)),
        )
    };
    let mut plain = start("nowhere");
    let job = submit(&dir, &url, "--frames 1..3 --size 8x4 --spp 1 --video clip.mp4 --contact-sheet sheet.png");
    let waits = || status(&dir, &url, &job)["waits"].to_string();
    plain.wait_until("the job waits for ffmpeg", || waits().contains("no worker has all the tags ffmpeg"));
    let sheetless = dir.run(&format!("fetch {job} -o out --server {url}")).exits(1);
    assert!(sheetless.stderr().contains("cannot be fetched yet"), "{}", sheetless.stderr());
    let _able = start("bin");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    assert!(
        workers(&dir, &url).to_string().contains(
            r#""tags":["ffmpeg","first-pass","first-pass-blocks","statistics","layers","features","painting","task-kinds","geometry","solution","measurements","guide-1998","targets"]"#
        ),
        "{}",
        workers(&dir, &url)
    );
    let json = dir.run(&format!("fetch {job} -o out --server {url} --json")).exits(0).json();
    assert_eq!((json["video"].as_str(), json["contact_sheet"].as_str()), (Some("out/clip.mp4"), Some("out/sheet.png")));
    assert_eq!(std::fs::read(dir.path("out/clip.mp4")).expect("a clip").len(), 3 * 8 * 4 * 3);
    assert_eq!(json["previews"].as_array().map(Vec::len), Some(0), "nobody asked for stills");
    let log = dir.read("told");
    assert!(log.contains("ffmpeg 7.1-test") && log.contains("-s 8x4"), "{log}");
}

#[test]
fn ffmpeg_refusal_fails_the_clip_with_its_message_but_no_frame() {
    let dir = TestFolder::new();
    std::fs::create_dir(dir.path("bin")).expect("made");
    dir.write("bin/ffmpeg", "#!/bin/sh\n[ \"$1\" = -version ] && exit 0\necho no such muxer >&2\nexit 1\n");
    std::fs::set_permissions(dir.path("bin/ffmpeg"), PermissionsExt::from_mode(0o755)).expect("made executable");
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let mut worker = dir.command(&format!("worker --join {url} --threads 1"));
    let _worker = TestProcess::spawn(worker.env("PATH", dir.path("bin")));
    let job = submit(&dir, &url, "--frames 1..2 --size 8x4 --spp 1 --video clip.xyz");
    dir.run(&format!("watch {job} --server {url}")).exits(1);
    let output = dir.run(&format!("status {job} --server {url}")).exits(0).stdout();
    assert!(output.contains("2 of 2 done") && output.contains("ffmpeg: no such muxer"), "{output}");
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(1);
    assert_eq!(common::file_names(&dir.path("out")), ["fog.0001.exr", "fog.0002.exr"]);
}

#[cfg(debug_assertions)]
#[test]
fn failed_frame_is_a_card_in_the_clip_until_it_is_retried() {
    let dir = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, &format!("{FRAMES} --spp 2 {OUTPUT_FLAGS}"));
    let deadly = || {
        let mut command = dir.command(&format!("worker --join {url} --threads 1 --name lab --outbox box"));
        TestProcess::spawn(command.env("FEMC_DEADLY", format!("{job}/2.0/render.0/0")))
    };
    let failed = || status(&dir, &url, &job)["state"] == "failed";
    let mut deaths = 0;
    while !failed() {
        assert!(deaths < 8, "{}", status(&dir, &url, &job));
        let mut victim = deadly();
        while victim.is_running() && !failed() {
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        deaths += u32::from(!victim.kill());
    }
    let fetch = |out: &str, code| dir.run(&format!("fetch {job} -o {out} --server {url}")).exits(code);
    fetch("gap", 1);
    let read = |name: &str| std::fs::read(dir.path(name)).expect(name);
    let still = |name: &str| Picture::from_png(&read(name)).expect("a picture");
    assert_eq!(frames_of(&read("gap/clip.png")), 3, "a frame that is missing is not left out");
    assert_eq!(still("gap/fog.0002.png"), Picture::placeholder(48, 32));
    assert_ne!(still("gap/fog.0001.png"), Picture::placeholder(48, 32));
    let _healthy = dir.start(&format!("worker --join {url} --threads 1"));
    dir.run(&format!("retry {job} --server {url}")).exits(0);
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    fetch("whole", 0);
    assert_ne!(still("whole/fog.0002.png"), Picture::placeholder(48, 32));
    render_and_fetch(&dir, "fresh", 1, &format!("{FRAMES} --spp 2 {OUTPUT_FLAGS}"));
    for name in ["clip.png", "sheet.png", "fog.0001.png", "fog.0002.png", "fog.0003.png"] {
        assert!(read(&format!("whole/{name}")) == read(&format!("fresh/{name}")), "{name}");
    }
}

#[test]
fn plan_shows_the_graph_of_a_clip_and_bad_names_are_refused() {
    let dir = TestFolder::new();
    let line = format!("plan fog.mgf {FRAMES} --spp 2 --no-trial --video clip.mp4");
    let output = dir.run(&line).exits(0).stdout();
    assert!(output.contains("thumbnail") && output.contains("clip") && output.contains("ffmpeg"), "{output}");
    let graph = &dir.run(&format!("{line} --json")).exits(0).json()["graph"]["stages"];
    assert_eq!(graph.as_array().map(Vec::len), Some(6), "{graph}");
    for (flags, said) in [
        ("--video ../clip.mp4", "--video"),
        ("--video clip", "--video"),
        ("--contact-sheet sheet.jpg", "--contact-sheet"),
        ("--contact-sheet out/sheet.png", "--contact-sheet"),
        ("--contact-sheet a.png --video a.png", "--contact-sheet"),
    ] {
        let ran = dir.run(&format!("plan fog.mgf --no-trial {flags}")).exits(2);
        assert!(ran.stderr().contains(said), "{flags}: {}", ran.stderr());
    }
}
