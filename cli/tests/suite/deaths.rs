//! Tests of real workers that die in the middle of a task: because of the task, or killed from outside.
#![cfg(all(unix, debug_assertions))]

use crate::common;
use crate::common::{TestFolder, TestProcess, pixels, start_coordinator, status, submit};

const SETTINGS: &str = "--spp 16 --size 32x32 --frames 1..2";

fn worker(dir: &TestFolder, url: &str, fault: Option<(&str, String)>) -> TestProcess {
    let mut command = dir.command(&format!("worker --join {url} --threads 1 --name lab --outbox box --color never"));
    command.envs(fault);
    TestProcess::spawn(&mut command)
}

/// Returns the quarantined tasks of a job, as `status` reports them.
fn quarantined(dir: &TestFolder, url: &str, job: &str) -> Vec<serde_json::Value> {
    status(dir, url, job)["quarantined"].as_array().cloned().unwrap_or_default()
}

fn frames(dir: &TestFolder, folder: &str) -> Vec<Vec<u32>> {
    common::file_names(&dir.path(folder)).iter().map(|name| pixels(&dir.path(folder).join(name))).collect()
}

#[test]
fn task_that_kills_workers_is_quarantined_other_frames_finish() {
    let dir = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, SETTINGS);
    let deadly = format!("{job}/1.0/render.0/2");
    let mut deaths = 0;
    while quarantined(&dir, &url, &job).is_empty() {
        assert!(deaths < 8, "it kills one worker after the other: {}", status(&dir, &url, &job));
        let mut victim = worker(&dir, &url, Some(("FEMC_DEADLY", deadly.clone())));
        while victim.is_running() && quarantined(&dir, &url, &job).is_empty() {
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        deaths += u32::from(!victim.kill());
    }
    assert_eq!(deaths, 5);
    let killed = worker(&dir, &url, Some(("FEMC_DEADLY", deadly.clone())));
    dir.run(&format!("watch {job} --server {url}")).exits(1);
    let answer = status(&dir, &url, &job);
    assert_eq!((answer["state"].as_str(), answer["frames_done"].as_u64()), (Some("failed"), Some(1)), "{answer}");
    assert!(
        answer.to_string().contains("workers died 5 times while computing this task; the last one was lab"),
        "{answer}"
    );
    // A worker without the fault completes the task after a retry, and the frames equal the frames of one process.
    drop(killed);
    let _healthy = worker(&dir, &url, None);
    dir.run(&format!("retry {job} --server {url}")).exits(0);
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run(&format!("render fog.mgf -o alone {SETTINGS}")).exits(0);
    assert_eq!(frames(&dir, "out"), frames(&dir, "alone"));
}

#[test]
fn externally_killed_workers_quarantine_no_task() {
    let dir = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, SETTINGS);
    for life in 1..=4 {
        let token = dir.path(&format!("token{life}"));
        let mut victim = worker(&dir, &url, Some(("FEMC_FAULT", format!("worker-before-task:1:{}", token.display()))));
        victim.wait_until("a task", || token.exists());
        assert!(victim.kill(), "it was alive");
    }
    let mut last = worker(&dir, &url, None);
    last.wait_until("its end", || status(&dir, &url, &job)["state"] == "done");
    assert_eq!(quarantined(&dir, &url, &job), [] as [serde_json::Value; 0]);
}
