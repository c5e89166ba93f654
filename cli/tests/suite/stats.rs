//! What a job took, as `femc stats` and `femc report` tell it, of real workers.

use crate::common::{Place, coordinator, submit};
use std::collections::BTreeSet;
use std::process::Command;

/// Processor seconds of a process so far, as the system says.
fn processor(id: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).expect("a process");
    let fields = stat.rsplit_once(')').expect("a name").1.split_whitespace();
    fields.skip(11).take(2).map(|ticks| ticks.parse::<f64>().expect("ticks")).sum::<f64>() / 100.0
}

fn sum(rows: &serde_json::Value, column: &str) -> f64 {
    rows.as_array().expect("rows").iter().map(|row| row[column].as_f64().expect("a number")).sum()
}

/// Until so many workers have registered: what their start takes is of no attempt.
fn wait_for_workers(place: &Place, url: &str, number: usize) {
    let start = std::time::Instant::now();
    let known = || place.run(&format!("workers --json --server {url}")).exits(0).json().as_array().map_or(0, Vec::len);
    while known() < number {
        assert!(start.elapsed().as_secs() < 60, "{number} workers never registered");
    }
}

#[test]
fn the_processor_seconds_of_all_attempts_are_those_that_the_system_says_the_workers_used() {
    let place = Place::new();
    let (_farm, url) = coordinator(&place, 0);
    let workers = [1, 2].map(|number| place.start(&format!("worker --join {url} --threads 2 --name lab{number}")));
    let used = || workers.iter().map(|worker| processor(worker.id())).sum::<f64>();
    wait_for_workers(&place, &url, workers.len());
    let started = used();
    let job = submit(&place, &url, "--spp 384 --frames 1..4");
    place.run(&format!("watch {job} --quiet --server {url}")).exits(0);
    let used = used() - started;
    let stats = |what: &str| place.run(&format!("stats {job} {what} --server {url}")).exits(0);
    for by in ["task", "frame", "worker", "attempt"] {
        let rows = stats(&format!("--by {by} --json")).json();
        let recorded = sum(&rows, "cpu_seconds");
        assert!((recorded - used).abs() <= 0.03 * used, "by {by}: {recorded} s of {used} s");
        assert_eq!(sum(&rows, "samples"), 4.0 * 32.0 * 32.0 * 384.0, "by {by}");
    }
    let attempts = stats("--by attempt --json").json();
    let leases: BTreeSet<(String, u64)> = attempts.as_array().expect("rows").iter().map(lease).collect();
    assert_eq!(Some(leases.len()), attempts.as_array().map(Vec::len), "each attempt once");
    assert!(sum(&attempts, "rays") > sum(&attempts, "samples") && sum(&attempts, "sent_bytes") > 0.0);

    place.write("attempts.csv", &stats("--by attempt --csv").stdout());
    stats("--by attempt --parquet attempts.parquet");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/frames");
    let arguments = ["attempts.parquet".into(), "attempts.csv".into(), used.to_string()];
    let ran = Command::new(script).args(arguments).current_dir(place.path("")).output().expect("a script");
    println!("{}", String::from_utf8_lossy(&ran.stdout));
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));

    place.run(&format!("report {job} -o report.html --server {url}")).exits(0);
    let page = place.read("report.html");
    assert_eq!(page.matches("<svg").count(), 5, "timeline, durations, errors, samples, cost");
    for outside in ["src=", "href=", "@import", "url("] {
        assert!(!page.contains(outside), "{outside} asks for something");
    }
}

fn lease(row: &serde_json::Value) -> (String, u64) {
    (row["task"].as_str().expect("a task").into(), row["epoch"].as_u64().expect("an epoch"))
}

#[test]
fn what_was_told_outlives_the_coordinator_and_failures_are_attempts_too() {
    let place = Place::new();
    let (mut farm, url) = coordinator(&place, 0);
    let small = place.start(&format!("worker --join {url} --threads 1 --name small --memory 1M"));
    let job = submit(&place, &url, "--spp 4 --frames 1");
    let stats = |url: &str| place.run(&format!("stats {job} --by attempt --json --server {url}")).exits(0).json();
    farm.wait_until("a failure", || sum_of(&stats(&url), "failed") > 0);
    drop(small);
    let _large = place.start(&format!("worker --join {url} --threads 1 --name large"));
    place.run(&format!("watch {job} --quiet --server {url}")).exits(0);
    let before = stats(&url);
    assert_eq!(sum_of(&before, "done"), 5, "four tiles and an image: {before}");
    let page = |url: &str| {
        place.run(&format!("report {job} -o report.html --server {url}")).exits(0);
        place.read("report.html")
    };
    assert!(page(&url).contains("out of resources"), "failures come with their logs");
    assert!(farm.kill(), "it was alive");
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let (_farm, url) = coordinator(&place, port);
    assert_eq!(stats(&url), before);
}

/// Attempts that ended so.
fn sum_of(rows: &serde_json::Value, ending: &str) -> usize {
    rows.as_array().expect("rows").iter().filter(|row| row["ending"] == ending).count()
}

#[test]
fn statistics_of_what_is_not_there_are_wrong_usage() {
    let place = Place::new();
    let (_farm, url) = coordinator(&place, 0);
    for line in ["stats 77", "report 77"] {
        let ran = place.run(&format!("{line} --server {url}")).exits(2);
        assert!(ran.stderr().contains("77"), "{line}: {}", ran.stderr());
    }
}
