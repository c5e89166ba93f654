//! Tests of services that are asked to stop.

use crate::common;
use crate::common::{TestFolder, file_names, finished_share, start_coordinator, status, submit, workers};

#[test]
fn stopped_coordinator_leaves_one_file_and_resumes_from_it() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    assert!(dir.path("farm.db-wal").exists(), "while it runs there is another");
    farm.signal("TERM");
    farm.end().exits(0);
    let left: Vec<String> = file_names(&dir.path(".")).into_iter().filter(|name| name.starts_with("farm.db")).collect();
    assert_eq!(left, ["farm.db", "farm.db-mark"]);
    std::fs::remove_file(dir.path("farm.db-mark")).expect("it is there");
    let (_again, url) = start_coordinator(&dir, 0);
    assert_eq!(status(&dir, &url, &job)["state"], "queued");
}

#[test]
fn a_worker_whose_grace_is_over_gives_back_what_it_is_at() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --grace 1ms"));
    let job = submit(&dir, &url, "--spp 4000 --size 16x16 --frames 1");
    farm.wait_until("some samples", || finished_share(&dir, &url, &job) > 0.01);
    worker.signal("TERM");
    let ran = worker.end().exits(0);
    assert!(ran.stderr().contains("grace period over"), "{}", ran.stderr());
    assert_eq!(workers(&dir, &url).as_array().map(Vec::len), Some(0));
    let attempts = dir.run(&format!("stats {job} --by attempt --json --server {url}")).exits(0).json();
    let endings: Vec<&str> =
        attempts.as_array().expect("a list").iter().filter_map(|attempt| attempt["ending"].as_str()).collect();
    assert!(endings.contains(&"cancelled") && !endings.contains(&"lost"), "nobody waits for a deadline: {endings:?}");
}

#[test]
fn the_log_is_json_with_ids_where_that_is_asked_for() {
    let dir = TestFolder::new();
    let mut farm = dir.start("coordinator --listen 127.0.0.1:0 --store memory --artifacts memory --log-format json");
    let url = farm.address();
    let mut command = dir.command(&format!("worker --join {url} --threads 1 --log-format json --idle-exit 500ms"));
    let mut worker = common::TestProcess::spawn(command.env("FEMC_LOG", "femc=debug"));
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    let said = [worker.end().exits(0).stderr(), farm.kill_for_stderr()];
    let read = |text: &str| -> Vec<serde_json::Value> {
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    };
    let [worker, farm] = said.each_ref().map(|text| read(text));
    let has = |lines: &[serde_json::Value], message: &str, check: &dyn Fn(&serde_json::Value) -> bool| {
        assert!(lines.iter().any(|line| line["message"] == message && check(line)), "{message}: {said:?}");
    };
    has(&worker, "joined", &|line| line["span"]["worker"].is_number());
    has(&worker, "rendered", &|line| line["span"]["job"] == 1 && line["span"]["task"] == "1/1.0/render.0/0");
    has(&farm, "job submitted", &|line| line["job"] == 1);
    has(&farm, "worker joined", &|line| line["worker"].is_number() && line["engine"].is_string());
}
