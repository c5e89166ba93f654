//! Tests of a farm with artifacts on an S3 server; run by `tests/s3`.

use crate::common;
use crate::common::outage::OutageRelay;
use crate::common::{TestFolder, TestProcess, file_names, start_coordinator_with};
use femc_require::Prerequisite;

/// Returns the address of a bucket for this test alone, on the server that `tests/s3` starts.
fn bucket(name: &str) -> Option<String> {
    let bucket = Prerequisite::S3.variable_or_skip("FEMC_TEST_S3")?;
    Some(format!("{bucket}/{name}/{}", std::process::id()))
}

#[test]
fn a_farm_over_a_bucket_gives_the_bytes_of_one_process() {
    let Some(bucket) = bucket("farm") else { return };
    let dir = TestFolder::new();
    let settings = "--spp 8 --size 48x48 --frames 1..2";
    let (_farm, url) = start_coordinator_with(&dir, &bucket);
    let _workers = [(); 2].map(|()| dir.start(&format!("worker --join {url} --threads 1")));
    let ran = dir.run(&format!("submit fog.mgf {settings} --server {url}")).exits(0);
    let job = ran.stdout().lines().last().expect("a job id").to_owned();
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert!(!dir.path("artifacts").exists() && !dir.path("femc-farm").exists(), "nothing lies on this disk");
    dir.run(&format!("render fog.mgf -o alone {settings}")).exits(0);
    let frames = file_names(&dir.path("alone"));
    assert_eq!((file_names(&dir.path("out")), frames.len()), (frames.clone(), 2));
    for name in frames {
        let (farm, alone) = (dir.path("out").join(&name), dir.path("alone").join(&name));
        assert_eq!(common::pixels(&farm), common::pixels(&alone), "{name}");
    }
}

#[test]
fn temporary_store_outage_costs_no_task_and_no_pixel() {
    let (Some(bucket), Some(server)) = (bucket("outage"), Prerequisite::S3.variable_or_skip("AWS_ENDPOINT_URL")) else {
        return;
    };
    let (dir, outage) = (TestFolder::new(), OutageRelay::new(&server));
    let line = format!("coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts {bucket}");
    let mut command = dir.command(&line);
    command.env("AWS_ENDPOINT_URL", &outage.url);
    let mut farm = dir.start_command("farm", &mut command);
    farm.wait_until("its address", || dir.read("farm.out").ends_with('\n'));
    let line = dir.read("farm.out");
    let url = line.split_whitespace().find(|word| word.starts_with("http://")).expect("the address");
    let mut worker = dir.start(&format!("worker --join {url} --threads 1"));
    let settings = "--spp 24 --size 64x64";
    let ran = dir.run(&format!("submit fog.mgf {settings} --server {url}")).exits(0);
    let job = ran.stdout().lines().last().expect("a job id").to_owned();
    let frames_done = || {
        let status = dir.run(&format!("status {job} --json --server {url}")).exits(0).json();
        status["frames_done"].as_u64().expect("a number")
    };
    worker.wait_until("a finished frame", || frames_done() >= 1);
    outage.begin();
    let log = || dir.read("farm.err");
    farm.wait_until("a task that met the outage", || {
        log().lines().any(|line| line.contains("task failed") && line.contains(&bucket))
    });
    assert!(outage.refused() > 0 && frames_done() < 8, "it is not over yet");
    outage.end();
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    let status = dir.run(&format!("status {job} --json --server {url}")).exits(0).json();
    assert!(status["quarantined"].as_array().is_some_and(Vec::is_empty), "{status}");
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run(&format!("render fog.mgf -o alone {settings}")).exits(0);
    assert_eq!(file_names(&dir.path("out")), file_names(&dir.path("alone")));
    for name in file_names(&dir.path("alone")) {
        let (farm, alone) = (dir.path("out").join(&name), dir.path("alone").join(&name));
        assert_eq!(common::pixels(&farm), common::pixels(&alone), "{name}");
    }
}

#[test]
fn a_store_that_is_away_is_named_and_costs_no_job() {
    let dir = TestFolder::new();
    // No server listens there.
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts s3://nobody/there";
    let mut command = dir.command(line);
    command.env("AWS_ENDPOINT_URL", "http://127.0.0.1:9").env("AWS_ALLOW_HTTP", "true");
    command.env("AWS_ACCESS_KEY_ID", "a").env("AWS_SECRET_ACCESS_KEY", "b").env("AWS_REGION", "us-east-1");
    let mut farm = TestProcess::spawn(&mut command);
    let url = farm.address();
    let refused = dir.run(&format!("submit fog.mgf --spp 1 --frames 1 --server {url}")).exits(4);
    let error = refused.stderr();
    assert!(error.contains("s3://nobody/there") && error.contains("127.0.0.1:9"), "{error}");
    let jobs = dir.run(&format!("jobs --json --server {url}")).exits(0).json();
    assert_eq!(jobs.as_array().map(Vec::len), Some(0), "the coordinator itself answers");
}
