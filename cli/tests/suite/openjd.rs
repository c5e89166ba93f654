//! Tests of Open Job Description with the real binary. Templates are checked and run by the reference implementation, if
//! `tests/python` has installed it.

#![cfg(feature = "openjd")]

use crate::common;
use crate::common::{TestFolder, TestProcess, file_names, pixels};
use femc_require::Prerequisite;
use std::path::PathBuf;
use std::process::Command;

/// A job with 2 x 2 variants of 4 frames.
const JOB: &str = "scene = \"fog.mgf\"\nsize = \"24x16\"\nspp = 2\nframes = \"1..4\"\nthreads = 1\n\
    [sweep]\n\"medium.fog.sigma_s\" = [0.01, 0.2]\nseed = [1, 2]\n";

fn plan(dir: &TestFolder, job: &str) -> serde_json::Value {
    dir.run(&format!("plan {job} --no-trial --json")).exits(0).json()
}

#[test]
fn an_exported_job_comes_back_with_the_same_plan() {
    let dir = TestFolder::new();
    for (name, job) in [
        ("grid", JOB.to_owned()),
        ("zip", JOB.replace("[sweep]\n", "[sweep]\nmode = \"zip\"\n")),
        ("frames", JOB.replace("frames = \"1..4\"\n", "").replace("seed = [1, 2]", "frames = [\"1..3\", \"2..8+3\"]")),
        ("plain", JOB.split("[sweep]").next().expect("its head").to_owned()),
        ("all", "scene = \"fog.mgf\"\nerror = 0.3\n".to_owned()),
    ] {
        dir.write(&format!("{name}.toml"), &job);
        for template in [format!("{name}.yaml"), format!("{name}.json --chunk 3")] {
            dir.run(&format!("openjd export {name}.toml -o {template}")).exits(0);
            let file = template.split(' ').next().expect("a file");
            dir.run(&format!("openjd import {file} -o again.toml")).exits(0);
            let (before, mut after) = (plan(&dir, &format!("{name}.toml")), plan(&dir, "again.toml"));
            if let Some(scene) = after.get_mut("scene") {
                *scene = before["scene"].clone();
            }
            assert_eq!(after, before, "{template}\n{}\n{}", dir.read(file), dir.read("again.toml"));
        }
    }
}

#[test]
fn what_cannot_be_read_or_used_has_its_exit_code() {
    let dir = TestFolder::new();
    dir.run("openjd import nothing.yaml -o job.toml").exits(2);
    dir.run("openjd export nothing.toml -o job.yaml").exits(2);
    dir.write("bad.yaml", "specificationVersion: jobtemplate-2023-09\nname: Bad\nsteps: []\n");
    let error = dir.run("openjd import bad.yaml -o job.toml").exits(1).stderr();
    assert!(error.contains("bad.yaml:1:1"), "{error}");
    dir.write("job.toml", "scene = \"fog.mgf\"\n[sweep]\ncamera = [\"cam9\"]\n");
    let error = dir.run("openjd export job.toml -o job.yaml").exits(2).stderr();
    assert!(error.contains("cam9") && !dir.path("job.yaml").exists(), "{error}");
    dir.run("openjd import bad.yaml -o job.toml -p Nonsense").exits(2);
}

/// Returns the folder of the reference implementation's programs.
fn programs() -> Option<PathBuf> {
    Prerequisite::Python.variable_or_skip("FEMC_TEST_PYTHON_BIN").map(PathBuf::from)
}

/// Runs `openjd` with the words of `line`; it uses this build's `femc`.
fn openjd(dir: &TestFolder, line: &str) -> Option<common::CommandOutput> {
    let femc = PathBuf::from(env!("CARGO_BIN_EXE_femc")).parent().expect("its folder").to_owned();
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path = std::env::join_paths([femc].into_iter().chain(std::env::split_paths(&path))).expect("a path");
    let mut command = Command::new(programs()?.join("openjd"));
    command.args(line.split_whitespace()).current_dir(dir.path("")).env("PATH", path);
    Some(TestProcess::spawn(&mut command).end())
}

#[test]
fn openjd_reference_runs_exported_templates_to_the_same_pixels() {
    if programs().is_none() {
        return;
    }
    let dir = TestFolder::new();
    dir.write("fog.toml", JOB);
    dir.run("sweep fog.toml -o swept --local").exits(0);
    let variants: Vec<String> = file_names(&dir.path("swept")).into_iter().filter(|name| name.contains('=')).collect();
    assert_eq!(variants.len(), 4);
    for (file, chunk, tasks) in [("fog.yaml", 1, 16), ("fog.json", 2, 8)] {
        dir.run(&format!("openjd export fog.toml -o {file} --chunk {chunk}")).exits(0);
        let Some(checked) = openjd(&dir, &format!("check {file}")) else { return };
        print!("$ openjd check {file}\n{}", checked.stdout());
        checked.exits(0);
        let summary = openjd(&dir, &format!("summary {file}")).expect("openjd").exits(0).stdout();
        assert!(summary.contains(&format!("{tasks} total Tasks")), "{summary}");
        let out = format!("out-{chunk}");
        let ran = openjd(&dir, &format!("run {file} --step Render -p Out={out}")).expect("openjd");
        print!("$ openjd run {file} --step Render -p Out={out}\n{}", ran.stdout());
        ran.exits(0);
        for variant in &variants {
            for frame in 1..=4 {
                let name = match chunk {
                    1 => format!("fog.{frame}.exr"),
                    _ => format!("{}/fog.{frame:04}.exr", ["1..2", "3..4"][(frame - 1) / 2]),
                };
                let run = dir.path(&out).join(variant).join(name);
                let swept = dir.path("swept").join(variant).join(format!("fog.{frame:04}.exr"));
                assert_eq!(pixels(&run), pixels(&swept), "{variant} {frame}");
            }
        }
    }
}
