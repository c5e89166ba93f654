//! End-to-end tests of `femc render`.

use crate::common;
use crate::common::{TestFolder, file_names};

#[test]
fn out_ending_in_exr_is_one_frame_and_leaves_nothing_else() {
    let dir = TestFolder::new();
    let ran = dir.run("render fog.mgf -o a.exr --spp 2 --frames 3 --json").exits(0);
    let summary = ran.json();
    assert_eq!(summary["files"], serde_json::json!(["a.exr"]));
    assert_eq!(summary["frames"][0]["frame"], 3);
    assert_eq!(summary["frames"][0]["spp"], 2);
    assert_eq!(summary["samples"], 2 * 32 * 32);
    assert_eq!(summary["bad_samples"], 0);
    assert_eq!(file_names(&dir.path(".")), ["a.exr", "fog.mgf"]);
}

#[test]
fn a_clip_becomes_a_folder_of_numbered_frames() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o out --spp 1 --frames 2..6+2 --preview").exits(0);
    let frames: Vec<String> = file_names(&dir.path("out")).into_iter().filter(|name| name.ends_with(".exr")).collect();
    assert_eq!(frames, ["fog.0002.exr", "fog.0004.exr", "fog.0006.exr"]);
    assert!(dir.path("out/fog.0002.png").exists());
    assert!(!dir.path("out/.femc").exists());
}

#[test]
fn rerun_renders_nothing_and_another_seed_renders_anew() {
    let dir = TestFolder::new();
    let line = "render fog.mgf -o out --spp 2 --frames 1..2";
    dir.run(line).exits(0);
    let first = std::fs::read(dir.path("out/fog.0001.exr")).expect("a frame");
    let again = dir.run(&format!("{line} --json")).exits(0).json();
    assert_eq!(again["rendered"], 0);
    assert_eq!(std::fs::read(dir.path("out/fog.0001.exr")).expect("a frame"), first);
    let other = dir.run(&format!("{line} --seed 2 --json")).exits(0).json();
    assert_eq!(other["rendered"], 2);
    assert_ne!(std::fs::read(dir.path("out/fog.0001.exr")).expect("a frame"), first);
}

#[test]
fn a_longer_clip_keeps_the_frames_that_are_there() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o out --spp 2 --frames 1..2").exits(0);
    let more = dir.run("render fog.mgf -o out --spp 2 --frames 1..4 --json").exits(0).json();
    assert_eq!(more["rendered"], 2);
    assert_eq!(file_names(&dir.path("out")).len(), 4);
}

#[test]
fn workers_threads_and_tiles_leave_no_trace_in_the_pixels() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o a.exr --spp 8 --frames 4 --workers 1 --threads 1").exits(0);
    dir.run("render fog.mgf -o b.exr --spp 8 --frames 4 --workers 3 --threads 2").exits(0);
    assert_eq!(common::pixels(&dir.path("a.exr")), common::pixels(&dir.path("b.exr")));
    dir.run("render fog.mgf -o c.exr --spp 8 --frames 4 --seed 2").exits(0);
    assert_ne!(common::pixels(&dir.path("a.exr")), common::pixels(&dir.path("c.exr")));
}

#[test]
fn a_looser_error_takes_fewer_samples_and_says_what_it_reached() {
    let dir = TestFolder::new();
    let spp = |error: &str| {
        let out = format!("e{error}.exr");
        let json = dir.run(&format!("render fog.mgf -o {out} --frames 1 --error {error} --json")).exits(0).json();
        let frame = json["frames"][0].clone();
        assert!(frame["relative_error"].as_f64().is_some_and(|reached| reached > 0.0), "{json}");
        frame["spp"].as_u64().expect("a number")
    };
    assert!(spp("0.9") < spp("0.02"));
}

#[test]
fn an_override_and_a_size_reach_the_image() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o dark.exr --spp 1 --frames 1 --size 16x8 --set material.lamp.ed=0").exits(0);
    let film = common::film(&dir.path("dark.exr"));
    assert_eq!((film.width, film.height), (16, 8));
    assert!(film.rgb.iter().all(|&value| value == 0.0));
}

#[test]
fn a_job_file_renders_as_its_flags_would() {
    let dir = TestFolder::new();
    dir.write("job.toml", "scene = \"fog.mgf\"\nframes = 2\nspp = 2\nseed = 7\n[set]\n\"material.wall.rd\" = 0.3\n");
    dir.run("render job.toml -o a.exr").exits(0);
    dir.run("render fog.mgf -o b.exr --frames 2 --spp 2 --seed 7 --set material.wall.rd=0.3").exits(0);
    assert_eq!(common::pixels(&dir.path("a.exr")), common::pixels(&dir.path("b.exr")));
}

#[test]
fn a_clip_gives_a_contact_sheet_and_a_video() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o out --spp 1 --frames 1..3 --video clip.png --contact-sheet sheet.png").exits(0);
    for name in ["clip.png", "sheet.png"] {
        let bytes = std::fs::read(dir.path(name)).expect(name);
        assert!(bytes.starts_with(b"\x89PNG"), "{name}");
    }
}

#[test]
fn what_a_run_took_is_a_page_or_a_table_by_the_name_s_ending() {
    let dir = TestFolder::new();
    let run = |frame: u32, file: &str| {
        dir.run(&format!("render fog.mgf -o {frame}.exr --spp 2 --frames {frame} --report {file}")).exits(0);
        std::fs::read(dir.path(file)).expect(file)
    };
    let page = String::from_utf8(run(1, "run.html")).expect("text");
    assert!(page.contains("<svg") && page.contains("Durations of tasks") && !page.contains("src=\"http"), "a page");
    let csv = String::from_utf8(run(2, "run.csv")).expect("text");
    let mut lines = csv.lines();
    let place_of =
        lines.next().and_then(|names| names.split(',').position(|name| name == "samples")).expect("a column");
    let samples: u64 =
        lines.map(|line| line.split(',').nth(place_of).map_or(0, |n| n.parse().expect("a number"))).sum();
    let json: serde_json::Value = serde_json::from_slice(&run(3, "run.json")).expect("JSON");
    let of_json: u64 = json.as_array().expect("rows").iter().filter_map(|row| row["samples"].as_u64()).sum();
    assert!(samples > 0 && samples == of_json, "{samples}, {of_json}");
    assert!(run(4, "run.parquet").starts_with(b"PAR1"));
    let again = dir.run("render fog.mgf -o 4.exr --spp 2 --frames 4 --report run.parquet").exits(0);
    assert!(again.stderr().contains("nothing was rendered"), "{}", again.stderr());
    let odd = dir.run("render fog.mgf -o 4.exr --spp 2 --frames 4 --report run.xlsx").exits(2);
    assert!(odd.stderr().contains(".parquet"), "{}", odd.stderr());
}

#[test]
fn the_header_says_where_the_image_comes_from() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o a.exr --spp 2 --frames 1").exits(0);
    let text = String::from_utf8_lossy(&std::fs::read(dir.path("a.exr")).expect("a frame")).into_owned();
    for name in ["femc:version", "femc:settings", "femc:scene", "femc:seconds", "femc:spp", "chromaticities"] {
        assert!(text.contains(name), "{name}");
    }
}

#[test]
fn samples_beyond_all_range_are_left_out_counted_and_told() {
    let dir = TestFolder::new();
    let ran = dir.run("render fog.mgf -o a.exr --spp 4 --frames 1 --set material.lamp.ed=1e30 --json").exits(0);
    let summary = ran.json();
    let bad = summary["bad_samples"].as_u64().expect("a number");
    assert!(bad > 0, "{summary}");
    assert_eq!(summary["bad"][0]["out_of_range"], bad);
    assert!(summary["bad"][0]["first"]["x"].is_u64(), "{summary}");
    assert!(ran.stderr().contains("warning") && ran.stderr().contains("left out"), "{}", ran.stderr());
    assert!(common::film(&dir.path("a.exr")).rgb.iter().all(|value| value.is_finite()));
    // A second run renders nothing and still reports the bad samples.
    let again = dir.run("render fog.mgf -o a.exr --spp 4 --frames 1 --set material.lamp.ed=1e30 --json").exits(0);
    assert_eq!((again.json()["rendered"].as_u64(), again.json()["bad_samples"].as_u64()), (Some(0), Some(bad)));
}

#[test]
fn non_finite_samples_are_dropped_counted_and_reported() {
    let dir = TestFolder::new();
    let trap = "medium trap =\n\tsigma_s 1e-6\nmbox trap 0.2 -0.9 0.9 0.45 -0.8 1.15\n";
    dir.write("trap.mgf", &format!("{}{trap}", common::FOG));
    let line = "render trap.mgf -o OUT --spp 64 --frames 1 --json";
    let clean = dir.run(&line.replace("OUT", "clean.exr")).exits(0).json();
    assert_eq!(clean["bad_samples"], 0);
    // Overflow: in the small box the albedo becomes infinity divided by infinity.
    let ran = dir.run(&format!("{} --set medium.trap.sigma_s=1e39", line.replace("OUT", "a.exr"))).exits(0);
    let summary = ran.json();
    let bad = summary["bad_samples"].as_u64().expect("a number");
    assert!(bad > 100 && summary["bad"][0]["nan"] == bad, "{summary}");
    assert!(ran.stderr().contains(&format!("{bad} NaN")), "{}", ran.stderr());
    let (clean, image) = (common::film(&dir.path("clean.exr")), common::film(&dir.path("a.exr")));
    assert!(image.rgb.iter().all(|value| value.is_finite()));
    // Where the camera looks into the box, every sample is bad and the pixel is black. Elsewhere some samples are bad, and the
    // others determine the value of the pixel.
    let near = |(a, b): &(&f32, &f32)| (*a - *b).abs() <= 0.25 * b.abs();
    let kept = image.rgb.iter().zip(&clean.rgb).filter(near).count() as f64 / image.rgb.len() as f64;
    println!("{bad} NaN; {kept} of the values are within 25 %");
    assert!(kept > 0.9, "{kept}");
}

#[test]
fn timed_frame_records_sample_allocation_and_replays_exactly() {
    let dir = TestFolder::new();
    let json = dir.run("render fog.mgf -o a.exr --frames 2 --size 96x64 --time 1s --json").exits(0).json();
    assert!(json["frames"][0]["spp"].as_u64().is_some_and(|spp| spp >= 1), "{json}");
    let allocation = |name: &str| femc_film::exr::read_attributes(&dir.path(name)).unwrap().remove("femc:allocation");
    let first = allocation("a.exr").expect("an allocation");
    let parsed: serde_json::Value = serde_json::from_str(&first).expect("JSON");
    assert_eq!(parsed["ends"].as_array().map(Vec::len), Some(24), "tiles of 16 pixels: {first}");

    dir.run("render fog.mgf -o b.exr --replay a.exr --workers 2 --threads 1").exits(0);
    assert_eq!(common::pixels(&dir.path("a.exr")), common::pixels(&dir.path("b.exr")));
    assert_eq!(allocation("b.exr"), Some(first));
    let again = dir.run("render fog.mgf -o b.exr --replay a.exr --json").exits(0).json();
    assert_eq!(again["rendered"], 0, "it is there: {again}");
    // Every frame written by femc can be replayed.
    dir.run("render fog.mgf -o c.exr --frames 3 --spp 2 --set medium.fog.sigma_s=0.2").exits(0);
    dir.run("render fog.mgf -o d.exr --replay c.exr").exits(0);
    assert_eq!(common::pixels(&dir.path("c.exr")), common::pixels(&dir.path("d.exr")));
}

#[test]
fn a_frame_of_another_scene_or_of_nobody_is_not_rendered_again() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o a.exr --frames 1 --spp 1").exits(0);
    let refused = |line: &str, code: i32, says: &str| {
        let ran = dir.run(line).exits(code);
        assert!(ran.stderr().contains(says), "{line}: {}", ran.stderr());
    };
    refused("render fog.mgf -o b.exr --replay nothing.exr", 2, "not a readable frame");
    refused("render fog.mgf -o b.exr --replay a.exr --spp 4", 2, "--replay");
    let text = dir.read("fog.mgf");
    dir.write("other.mgf", &format!("{text}\nm another =\n    c\n    rd 0.5\n"));
    refused("render other.mgf -o b.exr --replay a.exr", 1, "another scene");
}

#[cfg(unix)]
#[test]
fn ffmpeg_gets_every_frame_and_an_animated_png_is_the_fallback() {
    use std::os::unix::fs::PermissionsExt;
    let dir = TestFolder::new();
    std::fs::create_dir(dir.path("bin")).expect("made");
    let line = "render fog.mgf -o out --spp 1 --frames 1..3 --size 8x4 --video clip.mp4 --json";
    let with_path = |path| dir.command(line).env("PATH", path).output().expect("femc starts");
    let without = with_path(dir.path("nowhere"));
    assert_eq!(without.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&without.stderr).contains("ffmpeg is not on the PATH"));
    assert!(std::fs::read(dir.path("clip.png")).is_ok_and(|bytes| bytes.starts_with(b"\x89PNG")));
    // A fake ffmpeg, which writes its input to the file named by the last argument.
    dir.write(
        "bin/ffmpeg",
        "#!/bin/sh\n[ \"$1\" = -version ] && exit 0\nfor out; do :; done\nexec /bin/cat > \"$out\"\n",
    );
    std::fs::set_permissions(dir.path("bin/ffmpeg"), PermissionsExt::from_mode(0o755)).expect("made executable");
    let with = with_path(dir.path("bin"));
    assert_eq!(with.status.code(), Some(0), "{}", String::from_utf8_lossy(&with.stderr));
    assert_eq!(std::fs::read(dir.path("clip.mp4")).expect("a clip").len(), 3 * 8 * 4 * 3);
}

#[test]
fn png_output_is_one_tone_mapped_frame_and_leaves_nothing_else() {
    let dir = TestFolder::new();
    let line = "render fog.mgf --spp 2 --frames 3 --json";
    let auto = dir.run(&format!("{line} -o a.png")).exits(0).json();
    assert_eq!((auto["files"].clone(), auto["rendered"].as_u64()), (serde_json::json!(["a.png"]), Some(1)));
    assert_eq!(file_names(&dir.path(".")), ["a.png", "fog.mgf"]);
    // The picture equals the preview of the same frame.
    dir.run(&format!("{line} -o b.exr --preview")).exits(0);
    let pixels = |name: &str| {
        let bytes = std::fs::read(dir.path(name)).expect("a file");
        femc_film::Picture::from_png(&bytes).expect("a picture")
    };
    assert_eq!(pixels("a.png"), pixels("b.png"));
    let ev = auto["exposure_ev"].as_f64().expect("an exposure value");
    let fixed = dir.run(&format!("{line} -o a.png --exposure {}", ev - 2.0)).exits(0).json();
    assert_eq!(fixed["rendered"], 1, "another exposure is another picture");
    let sum = |name: &str| pixels(name).pixels.as_flattened().iter().map(|&byte| u64::from(byte)).sum::<u64>();
    assert!(sum("a.png") > sum("b.png"), "two stops brighter");
    let again = dir.run(&format!("{line} -o a.png --exposure {}", ev - 2.0)).exits(0).json();
    assert_eq!((again["rendered"].as_u64(), again["exposure_ev"].as_f64()), (Some(0), fixed["exposure_ev"].as_f64()));
    assert!((fixed["exposure_ev"].as_f64().expect("a number") - (ev - 2.0)).abs() < 1e-2);
}

#[test]
fn exposure_without_picture_or_picture_with_clip_is_wrong_usage() {
    let dir = TestFolder::new();
    for (line, says) in [
        ("-o a.exr --exposure 3", "give -o NAME.png"),
        ("-o a.png --video a.gif", "need EXR files"),
        ("-o a.png --exposure bright", "`bright` is not an exposure"),
        ("-o a.png --frames 1..2", "this name is for one frame"),
        ("-o a.jpg", "give NAME.exr or NAME.png"),
    ] {
        let said = dir.run(&format!("render fog.mgf --spp 1 {line}")).exits(2).stderr();
        assert!(said.contains(says), "{line}: {said}");
    }
    let bright = dir.run("render fog.mgf --spp 1 --frames 1..2 -o out --preview --exposure -4 --json").exits(0).json();
    assert_eq!(bright["exposure_ev"].as_f64().map(|ev| (ev * 100.0).round()), Some(-400.0));
}
