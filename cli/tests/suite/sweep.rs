//! End-to-end tests of `femc sweep`.

use crate::common;
use crate::common::{TestFolder, file_names, pixels, start_coordinator};
use serde_json::Value;

/// A job with two lamps, two fogs and two frames: eight frames to render.
const JOB: &str = "scene = \"fog.mgf\"\nframes = \"1..2\"\nspp = 2\nsize = \"16x16\"\nthreads = 1\n\
    [sweep]\n\"medium.fog.sigma_s\" = [0.05, 0.2]\n\"material.lamp.ed\" = [100, 300]\n";

fn test_folder(job: &str) -> TestFolder {
    let dir = TestFolder::new();
    dir.write("j.toml", job);
    dir
}

fn counts(report: &Value) -> [u64; 3] {
    ["rendered", "linked", "kept"].map(|key| report[key].as_u64().unwrap_or_else(|| panic!("{key} in {report}")))
}

fn sweep(dir: &TestFolder, line: &str) -> Value {
    dir.run(&format!("sweep j.toml --json {line}")).exits(0).json()
}

#[test]
fn grid_sweep_writes_folders_tables_sheet_and_equals_renders() {
    let dir = test_folder(&format!(
        "{JOB}[regions]\nlamp = [4, 0, 12, 4]\nfloor = [4, 12, 12, 16]\n[contrasts]\nseen = [\"lamp\", \"floor\"]\n"
    ));
    let planned = dir.run("plan j.toml").exits(0).stdout();
    assert!(planned.contains("4 variants, 8 frames: 8 to render"), "{planned}");
    let report = sweep(&dir, "-o out --local");
    assert_eq!(counts(&report), [8, 0, 0]);
    assert_eq!(
        file_names(&dir.path("out")),
        [
            "contact.png",
            "frames.csv",
            "frames.parquet",
            "jobs",
            "sigma_s=0.05,ed=100",
            "sigma_s=0.05,ed=300",
            "sigma_s=0.2,ed=100",
            "sigma_s=0.2,ed=300",
            "sweep.json",
            "variants.csv",
            "variants.parquet"
        ]
    );
    // Clips have a row for each variant; single frames have a row for each value of the first axis.
    sweep(&dir, "-o single --local --frames 1");
    let size = |name: &str| {
        let png = std::fs::read(dir.path(name)).expect("a sheet");
        [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().expect("four bytes")))
    };
    let (clips, single) = (size("out/contact.png"), size("single/contact.png"));
    assert!(clips[0] == single[0] && 4 * single[1] < 3 * clips[1], "{clips:?} {single:?}");
    dir.run("render fog.mgf -o alone --frames 1..2 --spp 2 --size 16x16 --set medium.fog.sigma_s=0.2 --set material.lamp.ed=300").exits(0);
    for name in ["fog.0001.exr", "fog.0002.exr"] {
        assert_eq!(pixels(&dir.path("out/sigma_s=0.2,ed=300").join(name)), pixels(&dir.path("alone").join(name)));
    }
    let compared = dir.run("compare out/sigma_s=0.2,ed=300 out/sigma_s=0.2,ed=100 --json").exits(0).json();
    assert_eq!(compared["frames"].as_array().map(Vec::len), Some(2));
    let mean_ratio = compared["mean"]["mean_ratio"].as_f64().expect("a ratio");
    assert!((mean_ratio - 3.0).abs() < 0.01, "{compared}");
    let csv = dir.read("out/variants.csv");
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines.len(), 5, "{csv}");
    assert_eq!(
        lines[0],
        "variant,medium.fog.sigma_s,material.lamp.ed,frames,frames_linked,mean_luminance,luminance.lamp,luminance.floor,contrast.seen,relative_error,spp,seconds"
    );
    let luminance =
        |line: &str| line.rsplit(',').nth(6).and_then(|cell| cell.parse::<f64>().ok()).expect("a luminance");
    let ratio = luminance(lines[2]) / luminance(lines[1]);
    assert!((ratio - 3.0).abs() < 0.01, "three times the lamp: {ratio}\n{csv}");
    assert_eq!(dir.read("out/frames.csv").lines().count(), 9);
}

#[test]
fn grown_sweep_runs_only_new_variants_and_a_rerun_nothing() {
    let dir = test_folder(JOB);
    assert_eq!(counts(&sweep(&dir, "-o out --local")), [8, 0, 0]);
    assert_eq!(counts(&sweep(&dir, "-o out --local")), [0, 0, 8]);
    dir.write("j.toml", &JOB.replace("[0.05, 0.2]", "[0.05, 0.1, 0.2]"));
    assert_eq!(counts(&sweep(&dir, "-o out --local")), [4, 0, 8]);
    dir.write("j.toml", &JOB.replace("1..2", "1..3"));
    assert_eq!(counts(&sweep(&dir, "-o out --local")), [4, 0, 8]);
    dir.write("j.toml", &format!("{JOB}seed = [1, 2]\n"));
    assert_eq!(
        counts(&sweep(&dir, "-o out --local")),
        [8, 8, 0],
        "the variants have other names, and half of them is there"
    );
    std::fs::remove_file(dir.path("out/sigma_s=0.05,ed=100,seed=2/fog.0001.exr")).expect("a frame");
    assert_eq!(counts(&sweep(&dir, "-o out --local")), [1, 0, 15], "what was removed is rendered again");
}

#[test]
fn frames_of_another_engine_build_are_not_reused() {
    let dir = test_folder(JOB);
    assert_eq!(counts(&sweep(&dir, "-o out --local")), [8, 0, 0]);
    let mut other = dir.command("sweep j.toml --json -o out --local");
    let again = other.env("FEMC_PRETEND", "engine=another").output().expect("femc starts");
    let notes = String::from_utf8_lossy(&again.stderr);
    assert!(notes.contains("another build of the engine") && notes.contains("this is another"), "{notes}");
    let report = serde_json::from_slice(&again.stdout).unwrap_or_else(|error| panic!("{error}: {notes}"));
    assert_eq!(counts(&report), [8, 0, 0]);
    let renders = |engine: Option<&str>| {
        let mut command = dir.command("render fog.mgf -o alone --frames 1..2 --spp 2 --size 16x16 --json");
        engine.map(|engine| command.env("FEMC_PRETEND", format!("engine={engine}")));
        let report: Value = serde_json::from_slice(&command.output().expect("femc starts").stdout).expect("JSON");
        report["rendered"].clone()
    };
    let [first, second, other] = [None, None, Some("another")].map(renders);
    assert_eq!((&first, &other), (&Value::from(2), &Value::from(2)), "another build renders its own");
    assert_eq!(second, 0);
}

#[test]
fn what_a_sweep_took_is_kept_in_its_folder_and_asks_no_farm() {
    let dir = test_folder(JOB);
    sweep(&dir, "-o out --local");
    let stats = |what: &str| dir.run(&format!("stats out {what}")).exits(0);
    let samples = |rows: &Value| -> Vec<u64> {
        rows.as_array().expect("rows").iter().map(|row| row["samples"].as_u64().expect("a count")).collect()
    };
    assert_eq!(samples(&stats("--by variant --json").json()), [2 * 2 * 16 * 16; 4]);
    dir.write("j.toml", &JOB.replace("[0.05, 0.2]", "[0.05, 0.1, 0.2]"));
    sweep(&dir, "-o out --local");
    assert_eq!(samples(&stats("--by variant --json").json()), [2 * 2 * 16 * 16; 6]);
    let frames = stats("--by frame --json").json();
    assert_eq!(samples(&frames), [2 * 16 * 16; 12], "jobs of two farms with equal numbers are not one");
    let run = |variant: &str, time: &str| {
        let of_variant = |row: &&Value| row["variant"].as_str().is_some_and(|name| name.starts_with(variant));
        let times = frames.as_array().expect("rows").iter().filter(of_variant).map(|row| row[time].as_f64());
        times.map(|time| time.expect("seconds")).collect::<Vec<f64>>()
    };
    let last = run("sigma_s=0.2", "ended_seconds").into_iter().fold(0.0, f64::max);
    assert!(run("sigma_s=0.1", "began_seconds").iter().all(|began| *began >= last - 1e-3), "one run after the other");
    let table = stats("--by variant").stdout();
    assert!(table.contains("sigma_s=0.1,ed=300"), "{table}");
    dir.run("report out").exits(0);
    let page = dir.read("out/report.html");
    assert_eq!(page.matches("<svg").count(), 5, "timeline, durations, errors, samples, variants");
    assert!(page.contains("sigma_s=0.1,ed=300"));
    let ran = dir.run("stats nowhere").exits(2);
    assert!(ran.stderr().contains("nowhere"), "{}", ran.stderr());
}

#[test]
fn frames_that_are_the_same_are_rendered_once_and_linked() {
    // The change of another camera does not affect the frames of `main`.
    let dir = test_folder(
        "scene = \"fog.mgf\"\nframes = \"1..2\"\nspp = 2\nsize = \"16x16\"\n[sweep]\n\"camera.other.fov\" = [30, 50]\n\
         camera = [\"main\", \"other\"]\n",
    );
    dir.write("fog.mgf", &format!("{}camera other =\n\torigin 0 -3 1\n\ttarget 0 0 1\n\tfov 40\n", common::FOG));
    let plan = dir.run("plan j.toml --json").exits(0).json();
    assert_eq!(
        (plan["frames"].as_u64(), plan["render"].as_u64(), plan["linked"].as_u64()),
        (Some(8), Some(6), Some(2))
    );
    assert_eq!(counts(&sweep(&dir, "-o out --local")), [6, 2, 0]);
    let [first, second] = ["fov=30", "fov=50"].map(|fov| dir.path(&format!("out/{fov},camera=main/fog.0001.exr")));
    assert_eq!(pixels(&first), pixels(&second));
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let inode = |path: &std::path::Path| path.metadata().expect("a file").ino();
        assert_eq!(inode(&first), inode(&second), "one file under two names");
    }
    // Replacing a frame does not change its linked twin.
    let before = pixels(&second);
    let job = dir.read("j.toml").replace("[30, 50]", "[30]").replace("spp = 2", "spp = 3");
    dir.write("j.toml", &job);
    assert_eq!(counts(&sweep(&dir, "-o out --local")), [4, 0, 0]);
    assert_eq!(pixels(&second), before);
    assert_ne!(pixels(&first), before);
}

#[test]
fn variants_that_differ_in_the_camera_share_their_worlds() {
    let dir = test_folder(
        "scene = \"fog.mgf\"\nframes = \"1..2\"\nspp = 1\n[sweep]\n\"camera.main.fov\" = [30, 40, 50]\n\"medium.fog.sigma_s\" = [0.1, 0.2]\n",
    );
    let plan = dir.run("plan j.toml --no-trial --json").exits(0).json();
    assert_eq!(plan["render"], 12);
    assert_eq!(plan["worlds"], 2, "one for each fog: nothing else changes from frame to frame");
}

#[test]
fn killed_farm_sweep_resumes_without_rendering_twice() {
    let dir = test_folder(&JOB.replace("spp = 2", "spp = 200"));
    let (mut farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    let mut run = dir.start(&format!("sweep j.toml -o out --server {url}"));
    run.wait_until("a frame", || !file_names(&dir.path("out/sigma_s=0.05,ed=100")).is_empty());
    assert!(run.kill(), "it was under way");
    farm.wait_until("all jobs", || {
        let jobs = dir.run(&format!("jobs --json --server {url}")).exits(0).json();
        let jobs = jobs.as_array().expect("a list").clone();
        jobs.len() == 4 && jobs.iter().all(|job| job["state"] == "done")
    });
    let report = sweep(&dir, &format!("-o out --server {url}"));
    let [rendered, linked, kept] = counts(&report);
    assert_eq!((rendered + kept, linked), (8, 0), "{report}");
    let jobs = dir.run(&format!("jobs --json --server {url}")).exits(0).json();
    assert_eq!(jobs.as_array().map(Vec::len), Some(4), "no job was queued twice: {jobs}");
    let frames: u64 = jobs.as_array().expect("a list").iter().filter_map(|job| job["frames"].as_u64()).sum();
    assert_eq!(frames, 8);
    assert_eq!(dir.read("out/frames.csv").lines().count(), 9);
}

#[test]
fn a_killed_local_sweep_goes_on() {
    let dir = test_folder(&JOB.replace("spp = 2", "spp = 200"));
    let mut run = dir.start("sweep j.toml -o out --local");
    run.wait_until("a frame", || !file_names(&dir.path("out/sigma_s=0.05,ed=100")).is_empty());
    assert!(run.kill(), "it was under way");
    sweep(&dir, "-o out --local");
    dir.run("sweep j.toml -o other --local").exits(0);
    for variant in ["sigma_s=0.05,ed=100", "sigma_s=0.2,ed=300"] {
        let [out, other] =
            ["out", "other"].map(|folder| pixels(&dir.path(&format!("{folder}/{variant}/fog.0002.exr"))));
        assert_eq!(out, other);
    }
    assert!(!dir.path("out/.femc").exists(), "nothing is left to resume");
}

#[test]
fn detached_sweep_prints_its_jobs_and_is_collected_later() {
    let dir = test_folder(JOB);
    let (_farm, url) = start_coordinator(&dir, 0);
    let ran = dir.run(&format!("sweep j.toml --server {url}")).exits(0);
    assert_eq!(ran.stdout().lines().collect::<Vec<_>>(), ["1", "2", "3", "4"]);
    let ran = dir.run(&format!("sweep j.toml -o out --detach --server {url}")).exits(0);
    assert_eq!(ran.stdout().lines().collect::<Vec<_>>(), ["5", "6", "7", "8"]);
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    let report = sweep(&dir, &format!("-o out --server {url}"));
    assert_eq!(report["jobs"][0]["job"], 5, "{report}");
    dir.run(&format!("watch 4 --server {url}")).exits(0);
    dir.run(&format!("fetch 4 -o fetched --server {url}")).exits(0);
    // `femc fetch` uses the job's name, which contains the variant, for file names; a sweep has a folder for each variant.
    let (fetched, own) = ("fetched/fog-sigma_s=0.2,ed=300.0002.exr", "out/sigma_s=0.2,ed=300/fog.0002.exr");
    assert_eq!(pixels(&dir.path(fetched)), pixels(&dir.path(own)));
}

#[test]
fn scene_errors_of_a_sweep_name_the_place_in_the_job_file() {
    let dir = test_folder(JOB);
    for (from, to, said) in [
        ("0.05, 0.2", "0.05, -1", "j.toml:7:31: `medium.fog.sigma_s`"),
        ("medium.fog", "medium.frog", "j.toml:7:26: unknown scalar `medium.frog.sigma_s`"),
        ("1..2", "1..99", "j.toml:2:1: frame 99"),
        ("[sweep]\n", "[sweep]\ncamera = [\"main\", \"side\"]\n", "j.toml:7:19: "),
        ("[sweep]\n", "[set]\n\"material.lmp.ed\" = 3\n[sweep]\n", "j.toml:7:1: unknown scalar"),
        ("[sweep]\n", "[regions]\nsign = [0, 0, 16, 17]\n[sweep]\n", "j.toml:7:8: region `sign`"),
        ("spp = 2", "spp = 0", "j.toml:3:1: spp must be at least 1"),
    ] {
        dir.write("j.toml", &JOB.replace(from, to));
        let ran = dir.run("sweep j.toml -o out --local").exits(2);
        assert!(ran.stderr().contains(said), "{to}: {}", ran.stderr());
    }
    dir.write("j.toml", JOB);
    let ran = dir.run("sweep j.toml -o out --local --set material.lamp.ed=3").exits(2);
    assert!(ran.stderr().contains("j.toml:8:1: `material.lamp.ed` is an axis"), "{}", ran.stderr());
    let ran = dir.run("submit j.toml").exits(2);
    assert!(ran.stderr().contains("j.toml:6:1") && ran.stderr().contains("femc sweep"), "{}", ran.stderr());
    dir.write("j.toml", JOB.split("[sweep]").next().unwrap_or_default());
    let ran = dir.run("sweep j.toml -o out --local").exits(2);
    assert!(ran.stderr().contains("femc submit"), "{}", ran.stderr());
    dir.run("sweep fog.toml --detach").exits(2);
    assert!(!dir.path("out").exists(), "nothing was begun");
}
