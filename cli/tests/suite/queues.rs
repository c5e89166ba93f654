//! Tests of queues of real workers: images beside render tasks of another owner, and a single worker on which every task fails.

use crate::common::{TestFolder, start_coordinator, submit};
use serde_json::Value;

/// Returns all attempts at the tasks of these jobs, with times of the coordinator's clock.
fn attempts(dir: &TestFolder, url: &str, jobs: &str) -> Vec<Value> {
    let rows = dir.run(&format!("stats {jobs} --by attempt --json --server {url}")).exits(0).json();
    rows.as_array().expect("rows").clone()
}

fn seconds(row: &Value, column: &str) -> f64 {
    row[column].as_f64().unwrap_or_else(|| panic!("{column} of {row}"))
}

/// Returns whether an attempt belongs to a task of this job.
fn belongs_to(row: &Value, job: &str) -> bool {
    row["job"].as_u64().is_some_and(|number| Ok(number) == job.parse())
}

#[test]
fn image_of_a_finished_frame_waits_for_no_task_of_another_owner() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let start = |name: &str| dir.start(&format!("worker --join {url} --threads 1 --name {name}"));
    let _workers = [start("lab1"), start("lab2")];
    // Tiles of a second or more each, and more of them than can be rendered while the other job runs.
    let long: Vec<String> = (0..6).map(|_| submit(&dir, &url, "--spp 1000 --frames 1..8 --owner ann")).collect();
    let long = long.join(" ");
    let renders = |all: &[Value]| -> Vec<Value> {
        let is_long = |row: &&Value| long.split(' ').any(|job| belongs_to(row, job));
        all.iter().filter(is_long).filter(|row| row["stage"] == "render").cloned().collect()
    };
    farm.wait_until("render tasks on both workers", || {
        let all = attempts(&dir, &url, &long);
        ["lab1", "lab2"].iter().all(|name| renders(&all).iter().any(|row| row["worker"] == *name))
    });
    let short = submit(&dir, &url, "--spp 16 --frames 1..4 --owner bob");
    dir.run(&format!("watch {short} --quiet --server {url}")).exits(0);
    // A running attempt is listed only after its end.
    let ended = attempts(&dir, &url, &long).len();
    farm.wait_until("later render tasks", || attempts(&dir, &url, &long).len() >= ended + 4);
    let all = attempts(&dir, &url, &format!("{long} {short}"));

    let others = renders(&all);
    let shortest = others.iter().map(|row| seconds(row, "wall_seconds")).fold(f64::INFINITY, f64::min);
    let bound = shortest.max(1.0);
    println!("the shortest render task took {shortest:.3} s");
    let (mut images, mut beside) = (0, 0);
    for image in all.iter().filter(|row| belongs_to(row, &short) && row["stage"] == "image") {
        let is_before =
            |row: &&Value| row["job"] == image["job"] && row["frame"] == image["frame"] && row["stage"] != "image";
        let ready = all.iter().filter(is_before).map(|row| seconds(row, "ended_seconds")).fold(0.0, f64::max);
        let (began, worker) = (seconds(image, "began_seconds"), &image["worker"]);
        let (wait, whole) = (began - ready, seconds(image, "ended_seconds") - ready);
        println!("frame {}: its image waited for {wait:.3} s and was made after {whole:.3} s", image["frame"]);
        // The bound scales with the load of the machine, because render tasks take longer, too.
        assert!(wait < bound && whole < 2.0 * bound, "{wait} s, {whole} s beside render tasks of {shortest} s");
        let is_there = |row: &&Value| seconds(row, "began_seconds") <= began && began < seconds(row, "ended_seconds");
        beside += u32::from(others.iter().filter(|row| row["worker"] == *worker).any(|row| is_there(&row)));
        images += 1;
    }
    assert_eq!(images, 4);
    assert!(beside >= 1, "no image was made on a worker that rendered for the other owner");
}

#[cfg(debug_assertions)]
#[test]
fn lone_failing_worker_pauses_and_status_reports_it() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut command = dir.command(&format!("worker --join {url} --threads 1 --name sick --color never"));
    let _worker = crate::common::TestProcess::spawn(command.env("FEMC_SICK", "yes"));
    let job = submit(&dir, &url, "--spp 4 --frames 1..8");
    farm.wait_until("nine failures", || attempts(&dir, &url, &job).len() >= 9);
    let why = dir.run(&format!("status {job} --why --server {url}")).exits(0).stdout();
    assert!(why.contains("tasks failed repeatedly on 1 worker; the next attempt there is in"), "{why}");
    let mut all = attempts(&dir, &url, &job);
    all.sort_by(|a, b| seconds(a, "began_seconds").total_cmp(&seconds(b, "began_seconds")));
    assert!(all.iter().all(|row| row["ending"] == "failed" && row["worker"] == "sick"), "{all:?}");
    let begins: Vec<f64> = all.iter().map(|row| seconds(row, "began_seconds")).collect();
    println!("attempts began after {begins:.1?} s");
    // Three tasks fail, then the tasks in the queue behind them. Pauses of 1, 2, 4 and 8 s follow; load cannot make a pause
    // shorter.
    let in_first = |seconds: f64| begins.iter().filter(|&&began| began - begins[0] < seconds).count();
    assert!(in_first(0.9) <= 6, "{begins:?}");
    assert!(in_first(14.0) <= 10, "{begins:?}");
    dir.run(&format!("cancel {job} --server {url}")).exits(0);
}
