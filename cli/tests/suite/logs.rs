//! Tests of task logs, as `femc logs` prints them.

use crate::common;
use crate::common::{TestFolder, start_coordinator, submit};

#[test]
fn every_attempt_has_a_log_and_failures_outlive_the_coordinator() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let worker = dir.start(&format!("worker --join {url} --threads 1 --name lab"));
    let job = submit(&dir, &url, "--spp 2 --frames 1..2");
    let followed = dir.run(&format!("logs {job} --follow --json --server {url}")).exits(0).stdout();
    let lines: Vec<serde_json::Value> =
        followed.lines().map(|line| serde_json::from_str(line).expect("a document a line")).collect();
    assert_eq!(lines.len(), 10, "two frames of four tiles and an image: {followed}");
    let all = dir.run(&format!("logs {job} --json --server {url}")).exits(0).json();
    assert_eq!(all.as_array().map(Vec::len), Some(10));
    let one = dir.run(&format!("logs {job} 2.0/render.0/3 --server {url}")).exits(0).stdout();
    let words = [
        "2.0/render.0/3 on lab: done",
        "engine",
        "512 pixel samples",
        "peak memory of this process",
        "rendered",
        "shadow_rays=",
    ];
    for said in words {
        assert!(one.contains(said), "{said}: {one}");
    }
    let image = dir.run(&format!("logs {job}/1.0/image/0 --server {url}")).exits(0).stdout();
    assert!(image.contains("assembled the frame") && !image.contains("render."), "{image}");
    let none = dir.run(&format!("logs {job} --failed --server {url}")).exits(0);
    assert_eq!(none.stdout(), "");
    assert!(none.stderr().contains("the job has 10 logs of other attempts"), "{}", none.stderr());

    // A scene that cannot be parsed.
    dir.write("fog.mgf", &common::FOG.replace("origin 0 -3.4 1", "origin 0 -3.4"));
    let ran = dir.run(&format!("submit fog.mgf --spp 1 --server {url}"));
    assert_eq!(ran.code(), Some(1), "it is refused before it is submitted");
    // A worker with too little memory gives tasks back.
    dir.write("fog.mgf", common::FOG);
    drop(worker);
    let other = submit(&dir, &url, "--spp 2 --frames 1");
    let _small = dir.start(&format!("worker --join {url} --threads 1 --name small --memory 1M"));
    let failed = || dir.run(&format!("logs {other} --failed --server {url}")).exits(0).stdout();
    farm.wait_until("a failure", || failed().contains("FAILED"));
    let text = failed();
    assert!(text.contains("on small: FAILED") && text.contains("out of resources") && text.contains("WARN"), "{text}");

    let waits = || dir.run(&format!("jobs --server {url}")).exits(0).stdout().contains("waits for memory");
    farm.wait_until("the job says that it waits for memory", waits);
    let status = dir.run(&format!("status {other} --server {url}")).exits(0).stdout();
    assert!(status.contains("waits for memory"), "{status}");

    assert!(farm.kill(), "it was alive");
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let (_farm, url) = start_coordinator(&dir, port);
    let kept = dir.run(&format!("logs {job} --json --server {url}")).exits(0).json();
    assert_eq!(kept.as_array().map(Vec::len), Some(2), "the images: {kept}");
    assert!(dir.run(&format!("logs {other} 1 --failed --server {url}")).exits(0).stdout().contains("FAILED"));
}

#[test]
fn logs_of_what_is_not_there_are_wrong_usage() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    for (line, said) in [("logs 77", "77"), ("logs 1 first", "is not a task"), ("logs 1/2 3", "twice")] {
        let ran = dir.run(&format!("{line} --server {url}")).exits(2);
        assert!(ran.stderr().contains(said), "{line}: {}", ran.stderr());
    }
}
