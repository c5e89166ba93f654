//! Tests of a worker process: its outbox, its settings, its end.

use crate::common;
use crate::common::proxy::Proxy;
use crate::common::{TestFolder, finished_share, start_coordinator, status, submit, workers};

/// Settings of a job with one tile that takes some seconds and is done in parts.
const TILE: &str = "--spp 2500 --size 16x16 --frames 1";

/// Returns the results in an outbox.
fn outbox_results(dir: &TestFolder, folder: &str) -> Vec<String> {
    let names = common::file_names(&dir.path(folder));
    names.into_iter().filter(|name| name.ends_with(".done")).collect()
}

#[test]
fn worker_killed_before_acknowledgement_later_uploads_result() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let proxy = Proxy::new(&url);
    let mut first = dir.start(&format!("worker --join {} --threads 1 --tags lab --outbox box --name first", proxy.url));
    let job = submit(&dir, &url, &format!("{TILE} --tags lab"));
    farm.wait_until("some samples", || finished_share(&dir, &url, &job) > 0.05);
    proxy.freeze();
    // One part may have been on its way to the coordinator.
    first.wait_until("two finished parts", || outbox_results(&dir, "box").len() >= 2);
    let completed = |name: &str| {
        let all = workers(&dir, &url);
        let worker = all.as_array().expect("a list").iter().find(|worker| worker["name"] == name);
        worker.and_then(|worker| worker["completed"].as_u64()).unwrap_or(0)
    };
    assert!(first.kill(), "it was alive");
    assert!(outbox_results(&dir, "box").len() >= 2, "they outlive the kill");

    // This worker lacks the tag, so it gets no task of this job: it uploads only the results in the outbox.
    let mut second = dir.start(&format!("worker --join {url} --threads 1 --outbox box --name second"));
    farm.wait_until("a result", || completed("second") >= 1);
    second.wait_until("an empty outbox", || outbox_results(&dir, "box").is_empty());
    let third = dir.start(&format!("worker --join {url} --threads 1 --tags lab --name third"));
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    assert!(completed("third") >= 1, "at least the image was left to do");
    drop(third);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run(&format!("render fog.mgf -o alone {TILE}")).exits(0);
    let name = &common::file_names(&dir.path("alone"))[0];
    assert_eq!(
        common::pixels(&dir.path("out").join(name)),
        common::pixels(&dir.path("alone").join(name)),
        "the parts of the killed worker are the tile's"
    );
}

#[test]
fn drained_worker_gets_no_tasks_and_says_so_until_undrained() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 1 --name lab"));
    farm.wait_until("a worker", || workers(&dir, &url)[0].is_object());
    let ran = dir.run(&format!("drain lap --server {url}")).exits(2);
    assert!(ran.stderr().contains("there is no worker lap"), "{}", ran.stderr());
    let ran = dir.run(&format!("drain lab --server {url}")).exits(0);
    assert!(ran.stderr().contains("--undo"), "{}", ran.stderr());
    assert_eq!(workers(&dir, &url)[0]["intake"], "draining");
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    let why = dir.run(&format!("status {job} --why --server {url}")).exits(0).stdout();
    assert!(why.contains("accepts no new tasks"), "{why}");
    let number = workers(&dir, &url)[0]["worker"].to_string();
    dir.run(&format!("drain {number} --undo --server {url}")).exits(0);
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    assert_eq!(workers(&dir, &url)[0]["intake"], "open");
}

#[test]
fn drained_worker_returns_unbegun_tasks_within_two_seconds() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 1 --name lab"));
    // Each tile takes some seconds.
    let job = submit(&dir, &url, "--spp 4000 --size 32x32 --frames 1..6");
    let held = || workers(&dir, &url)[0]["tasks"].as_array().map_or(0, Vec::len);
    let tasks = |state: &str| {
        let path = format!("GET /api/v1/jobs/{job}/tasks?state={state}");
        common::http::send_request(url.trim_start_matches("http://"), &path, &[], "").json()["total"]
            .as_u64()
            .expect("a number")
    };
    farm.wait_until("a task that is queued behind one that runs", || tasks("queued") >= 1);
    let begun = std::time::Instant::now();
    dir.run(&format!("drain lab --server {url}")).exits(0);
    farm.wait_until("the drained worker to have one task at most", || held() <= 1 && tasks("queued") == 0);
    println!("{:.1} s until it held {} task", begun.elapsed().as_secs_f64(), held());
    let status = status(&dir, &url, &job);
    assert_eq!(status["state"], "running", "{status}");
    // A task that was given back is not a failure, and another worker does it.
    let _other = dir.start(&format!("worker --join {url} --threads 1 --name other"));
    farm.wait_until("a task at the other worker", || {
        let all = workers(&dir, &url);
        all.as_array()
            .expect("a list")
            .iter()
            .any(|it| it["name"] == "other" && !it["tasks"].as_array().expect("tasks").is_empty())
    });
    let why = dir.run(&format!("status {job} --why --server {url}")).exits(0).stdout();
    assert!(!why.contains("fail"), "{why}");
    dir.run(&format!("cancel {job} --server {url}")).exits(0);
}

/// Returns `HH:MM`, this many hours from now, in UTC.
fn hours_from_now(hours: u64) -> String {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).expect("after 1970").as_secs();
    let minutes = (now / 60 + hours * 60) % (24 * 60);
    format!("{:02}:{:02}", minutes / 60, minutes % 60)
}

#[test]
fn a_worker_takes_tasks_within_its_hours_alone() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    let start = |begin, end| {
        let hours = format!("{}-{}", hours_from_now(begin), hours_from_now(end));
        let mut command = dir.command(&format!("worker --join {url} --threads 1 --hours {hours}"));
        common::TestProcess::spawn(command.env("TZ", "UTC"))
    };
    let mut off = start(2, 20);
    farm.wait_until("a worker off duty", || workers(&dir, &url)[0]["intake"] == "off");
    let why = dir.run(&format!("status {job} --why --server {url}")).exits(0).stdout();
    assert!(why.contains("accepts no new tasks"), "{why}");
    assert_eq!(workers(&dir, &url)[0]["completed"], 0);
    let _on = start(22, 10);
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    assert!(off.is_running(), "it stays");
    assert_eq!(workers(&dir, &url)[0]["completed"], 0);
}

#[test]
fn a_worker_without_a_task_ends_by_itself() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --idle-exit 700ms"));
    let job = submit(&dir, &url, "--spp 4 --frames 1..3");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    let ran = worker.end().exits(0);
    assert!(ran.stderr().contains("idle limit reached"), "{}", ran.stderr());
    assert_eq!(workers(&dir, &url).as_array().map(Vec::len), Some(0));
}

#[cfg(target_os = "linux")]
#[test]
fn worker_over_its_memory_limit_returns_tasks_with_a_reason() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut small = dir.start(&format!("worker --join {url} --threads 1 --memory 1M"));
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    let why = || dir.run(&format!("status {job} --why --server {url}")).exits(0).stdout();
    farm.wait_until("a rest", || why().contains("rest after a failure"));
    let large = dir.start(&format!("worker --join {url} --threads 1 --memory 4G"));
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    let all = workers(&dir, &url);
    assert_eq!((&all[0]["completed"], &all[1]["completed"]), (&0.into(), &5.into()), "four tiles and the image: {all}");
    small.signal("TERM");
    small.end().exits(0);
    drop(large);
    let said = farm.kill_for_stderr();
    assert!(said.contains("MiB are in use") && said.contains("--memory"), "{said}");
}

#[cfg(target_os = "linux")]
#[test]
fn compute_threads_are_nice_and_network_threads_are_not() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let worker = dir.start(&format!("worker --join {url} --threads 2 --nice 7 --name w"));
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    farm.wait_until("the job's end", || status(&dir, &url, &job)["state"] == "done");
    let threads = std::fs::read_dir(format!("/proc/{}/task", worker.id())).expect("its threads");
    let mut niceness: Vec<(String, i32)> = Vec::new();
    for thread in threads {
        let Ok(stat) = std::fs::read_to_string(thread.expect("a thread").path().join("stat")) else { continue };
        let (name, rest) = stat.split_once(") ").expect("a name");
        // The niceness is the 19th field of proc(5)'s stat, and the 17th after the name.
        let nice = rest.split_whitespace().nth(16).and_then(|field| field.parse().ok()).expect("a niceness");
        niceness.push((name.split_once('(').expect("a name").1.to_owned(), nice));
    }
    let of = |part: &str| niceness.iter().filter(|(name, _)| name.contains(part)).map(|(_, nice)| *nice).collect();
    let (pool, hands, talk): (Vec<i32>, Vec<i32>, Vec<i32>) = (of("w "), of("hand"), of("tokio"));
    assert_eq!(hands, [7, 7], "{niceness:?}");
    assert!(pool.len() > 2 && pool.iter().filter(|&&nice| nice == 7).count() >= 4, "{niceness:?}");
    assert!(!talk.is_empty() && talk.iter().all(|&nice| nice == 0), "{niceness:?}");
}

#[test]
fn an_outbox_in_use_is_refused_and_the_default_one_is_not() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let mut first = dir.start(&format!("worker --join {url} --threads 1 --outbox box"));
    first.wait_until("its folder", || dir.path("box/lock").exists() && workers(&dir, &url)[0].is_object());
    let ran = dir.run(&format!("worker --join {url} --threads 1 --outbox box")).exits(1);
    assert!(ran.stderr().contains("--outbox box: another worker uses this folder"), "{}", ran.stderr());
    let mut others = [1, 2].map(|_| dir.start(&format!("worker --join {url} --threads 1 --name same")));
    let count = || workers(&dir, &url).as_array().map_or(0, Vec::len);
    others[0].wait_until("both", || count() == 3);
    let folders = common::file_names(&dir.path(".state/femc/outbox"));
    assert!(folders.len() == 2 && folders[1].ends_with("same-2"), "{folders:?}");
}
