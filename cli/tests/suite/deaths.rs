//! Tests of real workers that die in the middle of a task: because of the task, or killed from outside.
#![cfg(all(unix, debug_assertions))]

use crate::common;
use crate::common::{Place, Running, coordinator, pixels, status, submit};

const SETTINGS: &str = "--spp 16 --size 32x32 --frames 1..2";

fn worker(place: &Place, url: &str, fault: Option<(&str, String)>) -> Running {
    let mut command = place.command(&format!("worker --join {url} --threads 1 --name lab --outbox box --color never"));
    command.envs(fault);
    Running::of(&mut command)
}

/// Returns the quarantined tasks of a job, as `status` reports them.
fn quarantined(place: &Place, url: &str, job: &str) -> Vec<serde_json::Value> {
    status(place, url, job)["quarantined"].as_array().cloned().unwrap_or_default()
}

fn frames(place: &Place, folder: &str) -> Vec<Vec<u32>> {
    common::names(&place.path(folder)).iter().map(|name| pixels(&place.path(folder).join(name))).collect()
}

#[test]
fn task_that_kills_workers_is_quarantined_other_frames_finish() {
    let place = Place::new();
    let (_coordinator, url) = coordinator(&place, 0);
    let job = submit(&place, &url, SETTINGS);
    let deadly = format!("{job}/1.0/render.0/2");
    let mut deaths = 0;
    while quarantined(&place, &url, &job).is_empty() {
        assert!(deaths < 8, "it kills one worker after the other: {}", status(&place, &url, &job));
        let mut victim = worker(&place, &url, Some(("FEMC_DEADLY", deadly.clone())));
        while victim.is_running() && quarantined(&place, &url, &job).is_empty() {
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        deaths += u32::from(!victim.kill());
    }
    assert_eq!(deaths, 5);
    let killed = worker(&place, &url, Some(("FEMC_DEADLY", deadly.clone())));
    place.run(&format!("watch {job} --server {url}")).exits(1);
    let answer = status(&place, &url, &job);
    assert_eq!((answer["state"].as_str(), answer["frames_done"].as_u64()), (Some("failed"), Some(1)), "{answer}");
    assert!(
        answer.to_string().contains("workers died 5 times while computing this task; the last one was lab"),
        "{answer}"
    );
    // A worker without the fault completes the task after a retry, and the frames equal the frames of one process.
    drop(killed);
    let _healthy = worker(&place, &url, None);
    place.run(&format!("retry {job} --server {url}")).exits(0);
    place.run(&format!("watch {job} --server {url}")).exits(0);
    place.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    place.run(&format!("render fog.mgf -o alone {SETTINGS}")).exits(0);
    assert_eq!(frames(&place, "out"), frames(&place, "alone"));
}

#[test]
fn externally_killed_workers_quarantine_no_task() {
    let place = Place::new();
    let (_coordinator, url) = coordinator(&place, 0);
    let job = submit(&place, &url, SETTINGS);
    for life in 1..=4 {
        let token = place.path(&format!("token{life}"));
        let mut victim =
            worker(&place, &url, Some(("FEMC_FAULT", format!("worker-before-task:1:{}", token.display()))));
        victim.wait_until("a task", || token.exists());
        assert!(victim.kill(), "it was alive");
    }
    let mut last = worker(&place, &url, None);
    last.wait_until("its end", || status(&place, &url, &job)["state"] == "done");
    assert_eq!(quarantined(&place, &url, &job), [] as [serde_json::Value; 0]);
}
