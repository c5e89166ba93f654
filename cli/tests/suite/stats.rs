//! Tests of a job's usage, as `femc stats` and `femc report` show it, with real workers.

use crate::common::http::{free_port, metrics};
use crate::common::{TestFolder, start_coordinator, submit};
use std::collections::BTreeSet;
use std::process::Command;

/// Returns the processor seconds of a process so far, as reported by the system.
fn process_cpu_seconds(id: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).expect("a process");
    let fields = stat.rsplit_once(')').expect("a name").1.split_whitespace();
    fields.skip(11).take(2).map(|ticks| ticks.parse::<f64>().expect("ticks")).sum::<f64>() / 100.0
}

fn sum(rows: &serde_json::Value, column: &str) -> f64 {
    rows.as_array().expect("rows").iter().map(|row| row[column].as_f64().expect("a number")).sum()
}

/// Returns the processor seconds of a worker's render threads so far, as reported by the system. Their names are the worker's name
/// and a number.
fn render_cpu_seconds(id: u32, name: &str) -> f64 {
    let tasks = std::fs::read_dir(format!("/proc/{id}/task")).expect("threads");
    let mut seconds = 0.0;
    for task in tasks {
        let stat = std::fs::read_to_string(task.expect("a thread").path().join("stat")).unwrap_or_default();
        let Some((head, fields)) = stat.rsplit_once(')') else { continue };
        let number = head.rsplit_once('(').and_then(|(_, comm)| comm.strip_prefix(name)?.strip_prefix(' '));
        if number.is_some_and(|number| number.parse::<u32>().is_ok()) {
            let ticks = fields.split_whitespace().skip(11).take(2).map(|ticks| ticks.parse::<f64>().expect("ticks"));
            seconds += ticks.sum::<f64>() / 100.0;
        }
    }
    seconds
}

/// Rounding error of a process's processor time in seconds: the system counts user time and system time in ticks of 10 ms each.
const TICKS: f64 = 0.02;

#[test]
fn cpu_seconds_of_attempts_equal_system_cpu_seconds_of_workers() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let start = |name: &'static str| {
        let port = free_port();
        let line = format!("worker --join {url} --threads 2 --name {name} --metrics {port}");
        (name, port, dir.start(&line))
    };
    let workers = [start("lab1"), start("lab2")];
    let job = submit(&dir, &url, "--spp 384 --frames 1..4");
    dir.run(&format!("watch {job} --quiet --server {url}")).exits(0);
    // When a worker holds no task, the coordinator has acknowledged all of its results.
    let counted = |name: &str| workers.iter().map(|(_, port, _)| metrics(*port).sum(name, &[])).sum::<f64>();
    farm.wait_until("the workers hold nothing", || counted("femc_worker_tasks_held") == 0.0);
    let render_seconds = workers.iter().map(|(name, _, worker)| render_cpu_seconds(worker.id(), name)).sum::<f64>();
    let (in_tasks, idle) = (counted("femc_worker_cpu_seconds_total"), counted("femc_worker_idle_cpu_seconds_total"));
    let used = workers.iter().map(|(_, _, worker)| process_cpu_seconds(worker.id())).sum::<f64>();
    let stats = |what: &str| dir.run(&format!("stats {job} {what} --server {url}")).exits(0);
    // The usage of a second lease of a late task arrives with its worker's next heartbeat. No bound depends on the load of the
    // machine, because all values are sums of processor time. After rendering, threads search for more work for some microseconds,
    // which may be counted after the report.
    let mut recorded = 0.0;
    farm.wait_until("the attempts have the time of the threads that render", || {
        recorded = sum(&stats("--by attempt --json").json(), "cpu_seconds");
        recorded >= 0.98 * render_seconds - 2.0 * TICKS
    });
    println!(
        "{recorded} s of attempts, {render_seconds} s of threads that render, {in_tasks} s of tasks, {idle} s idle, {used} s"
    );
    assert!(recorded <= in_tasks * (1.0 + 1e-9), "{recorded} s of {in_tasks} s that workers counted");
    // Waiting for the acknowledgment after a task's report takes some time that belongs to neither value.
    let counted = in_tasks + idle;
    let is_all = counted >= 0.98 * used - 2.0 * TICKS && counted <= used + 2.0 * TICKS;
    assert!(is_all, "{in_tasks} s of tasks and {idle} s idle of {used} s");
    // The tables are consistent if nothing has arrived between the first and the last one.
    let (mut attempts, mut tables) = (serde_json::Value::Null, Vec::new());
    farm.wait_until("tables of one moment", || {
        attempts = stats("--by attempt --json").json();
        tables = ["task", "frame", "worker"].map(|by| (by, stats(&format!("--by {by} --json")).json())).to_vec();
        stats("--by attempt --json").json() == attempts
    });
    let recorded = sum(&attempts, "cpu_seconds");
    for (by, rows) in tables {
        let by_rows = sum(&rows, "cpu_seconds");
        assert!((by_rows - recorded).abs() <= 1e-6 * recorded, "by {by}: {by_rows} s of {recorded} s");
        assert_eq!(sum(&rows, "samples"), 4.0 * 32.0 * 32.0 * 384.0, "by {by}");
    }
    let leases: BTreeSet<(String, u64)> = attempts.as_array().expect("rows").iter().map(lease).collect();
    assert_eq!(Some(leases.len()), attempts.as_array().map(Vec::len), "each attempt once");
    assert!(sum(&attempts, "rays") > sum(&attempts, "samples") && sum(&attempts, "sent_bytes") > 0.0);

    dir.write("attempts.csv", &stats("--by attempt --csv").stdout());
    stats("--by attempt --parquet attempts.parquet");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/frames");
    let arguments = ["attempts.parquet".into(), "attempts.csv".into(), recorded.to_string()];
    let ran = Command::new(script).args(arguments).current_dir(dir.path("")).output().expect("a script");
    println!("{}", String::from_utf8_lossy(&ran.stdout));
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));

    dir.run(&format!("report {job} -o report.html --server {url}")).exits(0);
    let page = dir.read("report.html");
    assert_eq!(page.matches("<svg").count(), 5, "timeline, durations, errors, samples, cost");
    for outside in ["src=", "href=", "@import", "url("] {
        assert!(!page.contains(outside), "{outside} asks for something");
    }
}

fn lease(row: &serde_json::Value) -> (String, u64) {
    (row["task"].as_str().expect("a task").into(), row["epoch"].as_u64().expect("an epoch"))
}

#[test]
fn stats_outlive_the_coordinator_and_failures_are_attempts() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let small = dir.start(&format!("worker --join {url} --threads 1 --name small --memory 1M"));
    let job = submit(&dir, &url, "--spp 4 --frames 1");
    let stats = |url: &str| dir.run(&format!("stats {job} --by attempt --json --server {url}")).exits(0).json();
    farm.wait_until("a failure", || count_endings(&stats(&url), "failed") > 0);
    drop(small);
    let _large = dir.start(&format!("worker --join {url} --threads 1 --name large"));
    dir.run(&format!("watch {job} --quiet --server {url}")).exits(0);
    let before = stats(&url);
    assert_eq!(count_endings(&before, "done"), 5, "four tiles and an image: {before}");
    let page = |url: &str| {
        dir.run(&format!("report {job} -o report.html --server {url}")).exits(0);
        dir.read("report.html")
    };
    assert!(page(&url).contains("out of resources"), "failures come with their logs");
    assert!(farm.kill(), "it was alive");
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let (_farm, url) = start_coordinator(&dir, port);
    assert_eq!(stats(&url), before);
}

/// Returns the number of attempts with this ending.
fn count_endings(rows: &serde_json::Value, ending: &str) -> usize {
    rows.as_array().expect("rows").iter().filter(|row| row["ending"] == ending).count()
}

#[test]
fn statistics_of_what_is_not_there_are_wrong_usage() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    for line in ["stats 77", "report 77"] {
        let ran = dir.run(&format!("{line} --server {url}")).exits(2);
        assert!(ran.stderr().contains("77"), "{line}: {}", ran.stderr());
    }
}
