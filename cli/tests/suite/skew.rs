//! Tests of workers with other versions than their coordinator's. `FEMC_OLD` names an earlier program whose workers must also be
//! accepted: see `tests/skew`.

use crate::common::{TestFolder, TestProcess, file_names, finished_share, pixels, start_coordinator, submit, workers};
use femc_proto::{OLDEST_PROTOCOL, PROTOCOL};
use std::process::Command;

const JOB: &str = "--spp 64 --frames 1..3";

/// Starts a worker that pretends to be of another version.
fn worker(dir: &TestFolder, url: &str, name: &str, pretends: &str) -> TestProcess {
    let line = format!("worker --join {url} --threads 1 --name {name} --outbox memory");
    TestProcess::spawn(dir.command(&line).env("FEMC_PRETEND", pretends))
}

/// Checks that the job's frames equal those of one process.
fn assert_frames_equal(dir: &TestFolder, url: &str, job: &str) {
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run(&format!("render fog.mgf -o alone {JOB}")).exits(0);
    for frame in file_names(&dir.path("alone")) {
        assert_eq!(pixels(&dir.path("out").join(&frame)), pixels(&dir.path("alone").join(&frame)), "{frame}");
    }
}

/// Returns for each frame the workers whose results count.
fn workers_by_frame(dir: &TestFolder, url: &str, job: &str) -> Vec<(u64, String)> {
    let attempts = dir.run(&format!("stats {job} --by attempt --json --server {url}")).exits(0).json();
    let done = attempts.as_array().expect("a list").iter().filter(|attempt| attempt["ending"] == "done");
    let mut makers: Vec<(u64, String)> = done
        .map(|attempt| {
            let worker = attempt["worker"].as_str().expect("a name").to_owned();
            (attempt["frame"].as_u64().expect("a number"), worker)
        })
        .collect();
    makers.sort();
    makers.dedup();
    makers
}

#[test]
fn a_worker_of_the_oldest_protocol_works_beside_one_of_today() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let _old = match std::env::var_os("FEMC_OLD") {
        Some(program) => {
            let line = format!("worker --join {url} --threads 1 --name old --outbox memory");
            let mut command = Command::new(program);
            TestProcess::spawn(command.args(line.split_whitespace()).current_dir(dir.path(".")))
        }
        None => worker(&dir, &url, "old", &format!("protocol={OLDEST_PROTOCOL},engine=old")),
    };
    let _new = worker(&dir, &url, "new", "");
    farm.wait_until("both", || workers(&dir, &url).as_array().is_some_and(|all| all.len() == 2));
    let job = submit(&dir, &url, JOB);
    assert_frames_equal(&dir, &url, &job);
    let makers = workers_by_frame(&dir, &url, &job);
    assert_eq!(makers.len(), 3, "each frame is one build's: {makers:?}");
    let names: Vec<&str> = makers.iter().map(|(_, name)| name.as_str()).collect();
    assert!(names.contains(&"old") && names.contains(&"new"), "both had some: {makers:?}");
}

#[test]
fn worker_of_unsupported_protocol_is_refused_with_advice() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    for (protocol, said) in
        [(OLDEST_PROTOCOL - 1, "upgrade this worker"), (PROTOCOL + 1, "upgrade the coordinator first")]
    {
        let error = worker(&dir, &url, "other", &format!("protocol={protocol}")).end().exits(1).stderr();
        assert!(
            error.contains(said) && error.contains(&format!("{OLDEST_PROTOCOL} to {PROTOCOL}")),
            "{protocol}: {error}"
        );
    }
    assert_eq!(workers(&dir, &url).as_array().map(Vec::len), Some(0));
}

#[test]
fn a_frame_begun_by_one_build_waits_for_that_build() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut first = worker(&dir, &url, "first", "engine=one");
    let job = submit(&dir, &url, "--spp 2000 --frames 1");
    farm.wait_until("some samples", || finished_share(&dir, &url, &job) > 0.05);
    assert!(first.kill(), "it was at it");
    let _second = worker(&dir, &url, "second", "engine=two");
    let why = || dir.run(&format!("status {job} --why --server {url}")).exits(0).stdout();
    farm.wait_until("a reason", || why().contains("another engine build"));
    assert_eq!(workers(&dir, &url)[0]["engine"], "two");
    let _third = worker(&dir, &url, "third", "engine=one");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    let names: Vec<String> = workers_by_frame(&dir, &url, &job).into_iter().map(|(_, name)| name).collect();
    assert!(!names.contains(&"second".to_owned()) && names.contains(&"third".to_owned()), "{names:?}");
}
