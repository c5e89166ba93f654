//! Fault injection: real processes are killed, stopped and disconnected at chosen points. Each fault leaves a token file when its
//! point is reached. The frames must equal the frames of one process.
#![cfg(all(unix, debug_assertions))]

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::common;
use crate::common::proxy::{Direction, Proxy};
use crate::common::{STEP_TIMEOUT, TestFolder, TestProcess, file_names};
use femc_queue::{Queue as _, Sqlite};
use femc_schedule::Fact;

/// Settings of a job: two frames of four tiles; a tile takes some tenths of a second.
const SETTINGS: &str = "--spp 64 --size 32x32 --frames 1..2";
/// Tasks of a submitted job: per frame four tiles, two groups (of three tiles and of one) and an image. `femc render` reduces four
/// tiles at once.
const TASKS: usize = 2 * (4 + 2 + 1);
/// Number of points that are tested in parallel. Most of a test's time is waiting.
const PARALLEL_POINTS: usize = 4;

/// Time after which a resumed worker has reported everything that it had to report: one lease.
const REPORT_TIME: Duration = Duration::from_secs(2);

/// Fault at a point.
#[derive(Debug, Clone, Copy)]
enum Fault {
    CoordinatorKilled,
    /// The coordinator is killed in the middle of a task, restarted, and killed at the point.
    CoordinatorKilledTwice,
    CoordinatorStopped,
    WorkerKilled,
    /// The worker is killed with a finished result that is not acknowledged: the result is on disk.
    WorkerKilledWithResult,
    /// The worker is stopped until others have done its work.
    WorkerStopped,
    /// The worker's connections break.
    LinkCut,
    /// No bytes pass, until the worker has noticed.
    LinkFrozen,
    /// No bytes pass in one direction, until the worker has noticed.
    LinkFrozenOneWay(Direction),
    RenderKilled,
}
use Fault::*;

const POINTS: &[(Fault, &str)] = &[
    (CoordinatorKilled, "coordinator-before-append:1"),
    (CoordinatorKilled, "coordinator-before-append:4"),
    (CoordinatorKilled, "coordinator-after-append:1"),
    (CoordinatorKilled, "coordinator-after-append:5"),
    (CoordinatorKilled, "coordinator-before-snapshot:1"),
    (CoordinatorKilled, "coordinator-after-snapshot:1"),
    (CoordinatorKilled, "coordinator-before-answer:1"),
    // The second piece of the scene, and the third tile.
    (CoordinatorKilled, "coordinator-mid-upload:2"),
    (CoordinatorKilled, "coordinator-mid-upload:6"),
    (CoordinatorKilledTwice, "coordinator-before-join:1"),
    (CoordinatorStopped, "coordinator-after-append:4"),
    (WorkerKilled, "worker-mid-fetch:1"),
    (WorkerKilled, "worker-before-task:2"),
    (WorkerKilled, "worker-in-task:1"),
    (WorkerKilled, "worker-after-task:2"),
    (WorkerKilledWithResult, "worker-before-upload:1"),
    (WorkerKilledWithResult, "worker-after-upload:1"),
    (WorkerKilledWithResult, "worker-after-report:1"),
    (WorkerKilledWithResult, "worker-before-forget:1"),
    // A tile of the first group, and the second group.
    (WorkerKilled, "worker-mid-reduce:3"),
    (WorkerKilled, "worker-mid-reduce:6"),
    // The result of the first group.
    (WorkerKilledWithResult, "worker-after-upload:4"),
    (WorkerStopped, "worker-in-task:1"),
    (WorkerStopped, "worker-after-upload:2"),
    (LinkCut, "worker-in-task:1"),
    (LinkFrozen, "worker-in-task:1"),
    (LinkFrozenOneWay(Direction::Up), "worker-in-task:1"),
    (LinkFrozenOneWay(Direction::Down), "worker-in-task:1"),
    (LinkCut, "coordinator-mid-upload:6"),
    (LinkFrozen, "coordinator-mid-upload:6"),
    (LinkFrozenOneWay(Direction::Down), "coordinator-mid-upload:6"),
    (RenderKilled, "coordinator-after-append:5"),
    (RenderKilled, "worker-after-upload:3"),
    (RenderKilled, "worker-mid-reduce:7"),
    (RenderKilled, "render-before-file:2"),
    (RenderKilled, "render-after-file:1"),
];

/// Bits of the frames by file name.
type Frames = BTreeMap<String, Vec<u32>>;

fn frames(dir: &TestFolder, folder: &str) -> Frames {
    let folder = dir.path(folder);
    file_names(&folder).into_iter().map(|name| (name.clone(), common::pixels(&folder.join(name)))).collect()
}

/// A farm in which one fault happens.
struct Farm {
    dir: TestFolder,
    coordinator: TestProcess,
    url: String,
    submission: TestProcess,
    job: String,
}

/// Waits for a condition that no single process of the test belongs to.
#[track_caller]
fn wait(event: &str, mut condition: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !condition() {
        assert!(begun.elapsed() < STEP_TIMEOUT, "{event} never came");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn start_coordinator(dir: &TestFolder, port: &str, fault: Option<&str>) -> (TestProcess, String) {
    // Tests that wait for a snapshot need only a few changes.
    let compact = if fault.is_some_and(|fault| fault.contains("snapshot")) { 4 } else { 20_000 };
    let line = format!(
        "coordinator --listen 127.0.0.1:{port} --store sqlite:farm.db --artifacts artifacts --lease 2s --compact {compact}"
    );
    let mut process = start(dir, &line, fault);
    let url = process.address();
    (process, url)
}

fn start(dir: &TestFolder, line: &str, fault: Option<&str>) -> TestProcess {
    let mut command = dir.command(line);
    if let Some(fault) = fault {
        command.env("FEMC_FAULT", format!("{fault}:{}", dir.path("token").display()));
    }
    TestProcess::spawn(&mut command)
}

fn worker(dir: &TestFolder, name: &str, url: &str, fault: Option<&str>) -> TestProcess {
    let mut command =
        dir.command(&format!("worker --join {url} --threads 1 --name {name} --outbox {name} --color never"));
    if let Some(fault) = fault {
        command.env("FEMC_FAULT", format!("{fault}:{}", dir.path("token").display()));
    }
    dir.start_command(name, &mut command)
}

/// Returns the finished tasks in the log, each with its lease's epoch, and whether the log is complete (without a snapshot). The
/// coordinator must have ended.
fn effects(dir: &TestFolder) -> (Vec<String>, bool) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let contents = runtime.block_on(async {
        Sqlite::open(&dir.path("farm.db")).await.expect("a log").load().await.expect("its content")
    });
    let mut effects = Vec::new();
    for record in &contents.records {
        match Fact::decode(record).expect("a fact").1 {
            Fact::Done { task, epoch, .. } => {
                effects.push(format!("{}.{}", task.to_string().replace('/', "-"), epoch.0));
            }
            Fact::CoordinatorStarted { .. }
            | Fact::Submitted { .. }
            | Fact::BuildAssigned { .. }
            | Fact::TimeCharged { .. }
            | Fact::Metered { .. }
            | Fact::Announced { .. }
            | Fact::WorkerDied { .. }
            | Fact::Logged { .. } => {}
            other => panic!("something failed, was lost or began anew: {other:?}"),
        }
    }
    (effects, contents.snapshot.is_none())
}

impl Farm {
    /// Creates a farm and submits a job.
    fn new(dir: TestFolder, fault: Option<&str>) -> Self {
        let (coordinator, url) = start_coordinator(&dir, "0", fault);
        let mut submission = dir.command(&format!("submit fog.mgf {SETTINGS} --server {url}"));
        let submission = TestProcess::spawn(submission.env("FEMC_PRETEND", "fan=3"));
        Self { dir, coordinator, url, submission, job: String::new() }
    }

    /// Waits until the fault has reached its point.
    fn wait_until_fired(&self) {
        wait("the token", || self.dir.path("token").exists());
    }

    /// Lets the process that waits at the point continue.
    fn release(&self) {
        std::fs::remove_file(self.dir.path("token")).expect("the token was there");
        // This file proves that the fault fired, after the token is removed.
        self.dir.write("fired", "");
    }

    /// Kills the coordinator and restarts it at the same address.
    fn restart(&mut self, fault: Option<&str>) {
        assert!(self.coordinator.kill(), "it was alive");
        let port = self.url.rsplit(':').next().expect("a port").to_owned();
        self.coordinator = start_coordinator(&self.dir, &port, fault).0;
    }

    /// Waits for the answer to the submission.
    fn wait_until_submitted(&mut self) {
        let ran = self.submission.end().exits(0);
        self.job = ran.stdout().lines().last().expect("a job").to_owned();
    }

    /// Returns the finished samples and frames.
    fn progress(&self) -> (u64, u64) {
        let status = common::status(&self.dir, &self.url, &self.job);
        let number = |key: &str| status[key].as_u64().expect("a number");
        assert!(number("frames_failed") == 0 && status["failure"].is_null(), "{status}");
        (number("samples"), number("frames_done"))
    }

    /// Waits until more than `before` is finished.
    fn wait_for_progress(&self, before: (u64, u64)) {
        wait("progress", || {
            let done = self.progress();
            assert!(done.1 >= before.1, "finished frames are gone: {before:?} before, {done:?} after");
            done > before || done.1 == 2
        });
    }

    fn finish(&self) -> Frames {
        self.dir.run(&format!("watch {} --server {}", self.job, self.url)).exits(0);
        assert_eq!(common::status(&self.dir, &self.url, &self.job)["state"], "done");
        self.dir.run(&format!("fetch {} -o out --server {}", self.job, self.url)).exits(0);
        let jobs = self.dir.run(&format!("jobs --json --server {}", self.url)).exits(0).json();
        assert_eq!(jobs.as_array().map(Vec::len), Some(1), "one submission is one job: {jobs}");
        frames(&self.dir, "out")
    }

    /// Ends the farm and checks the log: each task took effect once, and the results in `before` are unchanged.
    fn audit(mut self, before: &[String]) {
        assert!(self.coordinator.kill(), "it was alive");
        let (effects, is_all) = effects(&self.dir);
        if !is_all {
            return;
        }
        let mut tasks: Vec<&str> = effects.iter().map(|effect| effect.rsplit_once('.').expect("an epoch").0).collect();
        tasks.sort_unstable();
        tasks.dedup();
        assert_eq!((tasks.len(), effects.len()), (TASKS, TASKS), "each task once: {effects:?}");
        for effect in before {
            assert!(effects.contains(effect), "{effect} was done again: {effects:?}");
        }
    }
}

/// Adds incompressible comments to the scene, which stand in for a mesh of more than one piece.
fn enlarge_scene(dir: &TestFolder) {
    let mut state = 1u64;
    let mut line = |_| {
        let mut word = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state ^ (state >> 29)).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        };
        format!("# {:016x}{:016x}{:016x}{:016x}\n", word(), word(), word(), word())
    };
    let mesh: String = (0..50_000).map(&mut line).collect();
    dir.write("mesh.mgf", &mesh);
    dir.write("fog.mgf", &format!("i mesh.mgf\n{}", common::FOG));
}

fn coordinator_killed(point: &str) -> (Frames, Duration) {
    let dir = TestFolder::new();
    if point == "coordinator-mid-upload:2" {
        enlarge_scene(&dir);
    }
    let mut farm = Farm::new(dir, Some(point));
    let _worker = worker(&farm.dir, "first", &farm.url, None);
    farm.wait_until_fired();
    assert!(farm.coordinator.kill(), "it was alive");
    let begun = Instant::now();
    let (before, _) = effects(&farm.dir);
    let port = farm.url.rsplit(':').next().expect("a port").to_owned();
    farm.coordinator = start_coordinator(&farm.dir, &port, None).0;
    farm.wait_until_submitted();
    let kept = farm.progress();
    assert!(kept.0 >= 64 * 256 * before.iter().filter(|effect| effect.contains("render")).count() as u64, "{kept:?}");
    farm.wait_for_progress(kept);
    let passed = begun.elapsed();
    let frames = farm.finish();
    farm.audit(&before);
    (frames, passed)
}

fn coordinator_killed_twice(point: &str) -> (Frames, Duration) {
    let mut farm = Farm::new(TestFolder::new(), None);
    let _worker = worker(&farm.dir, "first", &farm.url, None);
    farm.wait_until_submitted();
    // Wait for a finished tile: the samples that `done` counts may belong to a running task.
    wait("a tile", || {
        let status = common::status(&farm.dir, &farm.url, &farm.job);
        let tiles = |frame: &serde_json::Value| frame["tiles_done"].as_u64();
        status["frames_done"].as_u64() > Some(0)
            || status["active"].as_array().is_some_and(|active| active.iter().any(|frame| tiles(frame) > Some(0)))
    });
    let begun = Instant::now();
    farm.restart(Some(point));
    farm.wait_until_fired();
    assert!(farm.coordinator.kill(), "it was alive");
    let (before, _) = effects(&farm.dir);
    assert!(!before.is_empty(), "a tile was durable");
    let port = farm.url.rsplit(':').next().expect("a port").to_owned();
    farm.coordinator = start_coordinator(&farm.dir, &port, None).0;
    farm.wait_for_progress(farm.progress());
    let passed = begun.elapsed();
    let frames = farm.finish();
    farm.audit(&before);
    (frames, passed)
}

fn coordinator_stopped(point: &str) -> (Frames, Duration) {
    let mut farm = Farm::new(TestFolder::new(), Some(point));
    let _worker = worker(&farm.dir, "first", &farm.url, None);
    farm.wait_until_submitted();
    farm.wait_until_fired();
    farm.coordinator.signal("STOP");
    farm.release();
    wait("the worker's doubt", || farm.dir.read("first.err").contains("coordinator is silent"));
    farm.coordinator.signal("CONT");
    let begun = Instant::now();
    farm.wait_for_progress(farm.progress());
    let passed = begun.elapsed();
    let frames = farm.finish();
    farm.audit(&[]);
    (frames, passed)
}

fn worker_killed(point: &str, results: usize) -> (Frames, Duration) {
    let mut farm = Farm::new(TestFolder::new(), None);
    let mut victim = worker(&farm.dir, "first", &farm.url, Some(point));
    farm.wait_until_submitted();
    farm.wait_until_fired();
    let kept = || -> Vec<String> {
        let names = file_names(&farm.dir.path("first")).into_iter();
        names.filter_map(|name| name.strip_suffix(".done").map(str::to_owned)).collect()
    };
    if results > 0 {
        wait("a result on disk", || kept().len() >= results);
    }
    let before = farm.progress();
    assert!(victim.kill(), "it was alive");
    let begun = Instant::now();
    let kept = kept();
    let _again = worker(&farm.dir, "first", &farm.url, None);
    farm.wait_for_progress(before);
    let passed = begun.elapsed();
    let frames = farm.finish();
    // The results on the worker's disk were not computed again.
    farm.audit(&kept);
    (frames, passed)
}

fn worker_stopped(point: &str) -> (Frames, Duration) {
    let mut farm = Farm::new(TestFolder::new(), None);
    let mut victim = worker(&farm.dir, "first", &farm.url, Some(point));
    farm.wait_until_submitted();
    farm.wait_until_fired();
    victim.signal("STOP");
    farm.release();
    let before = farm.progress();
    let begun = Instant::now();
    let _other = worker(&farm.dir, "second", &farm.url, None);
    farm.wait_for_progress(before);
    let passed = begun.elapsed();
    let first = farm.finish();
    let before = (farm.progress(), farm.dir.run(&format!("fetch {} -o then --server {}", farm.job, farm.url)).code());
    victim.signal("CONT");
    let woken = Instant::now();
    // The worker reports its results: in a new session, or in the old one if the answer comes before it doubts the connection.
    wait("its return", || {
        let is_back = farm.dir.read("first.err").matches("joined").count() >= 2 || woken.elapsed() > REPORT_TIME;
        let is_empty = file_names(&farm.dir.path("first")).iter().all(|name| !name.ends_with(".done"));
        is_back && is_empty && common::workers(&farm.dir, &farm.url).as_array().map(Vec::len) == Some(2)
    });
    let after = (farm.progress(), farm.dir.run(&format!("fetch {} -o late --server {}", farm.job, farm.url)).code());
    assert_eq!(before, after, "late words change nothing");
    let late = frames(&farm.dir, "late");
    assert!(late == first, "late words change no pixel");
    farm.audit(&[]);
    (late, passed)
}

fn link_broken(point: &str, harm: impl FnOnce(&Proxy), is_noticed: impl Fn(&str) -> bool) -> (Frames, Duration) {
    let at = |name: &str| point.starts_with(name).then_some(point);
    let mut farm = Farm::new(TestFolder::new(), at("coordinator"));
    let proxy = Proxy::new(&farm.url);
    let _worker = worker(&farm.dir, "first", &proxy.url, at("worker"));
    farm.wait_until_submitted();
    farm.wait_until_fired();
    let before = farm.progress();
    harm(&proxy);
    farm.release();
    wait("the worker's notice", || is_noticed(&farm.dir.read("first.err")));
    let begun = Instant::now();
    proxy.thaw();
    farm.wait_for_progress(before);
    let passed = begun.elapsed();
    let frames = farm.finish();
    farm.audit(&[]);
    (frames, passed)
}

fn render_killed(point: &str) -> (Frames, Duration) {
    let dir = TestFolder::new();
    let line = format!("render fog.mgf -o out {SETTINGS} --threads 1");
    let mut render = start(&dir, &line, Some(point));
    render.wait_until("the token", || dir.path("token").exists());
    assert!(render.kill(), "it was alive");
    let begun = Instant::now();
    let written =
        |name: &String| dir.path("out").join(name).metadata().and_then(|data| data.modified()).expect("a time");
    let before: Vec<_> = file_names(&dir.path("out")).into_iter().map(|name| (written(&name), name)).collect();
    let ran = dir.run(&format!("{line} --json")).exits(0);
    let passed = begun.elapsed();
    assert_eq!(ran.json()["rendered"].as_u64(), Some(2 - before.len() as u64), "{}", ran.stdout());
    for (time, name) in before {
        assert_eq!(time, written(&name), "a finished frame is not written again");
    }
    assert!(!dir.path("out/.femc").exists(), "nothing is left to resume");
    (frames(&dir, "out"), passed)
}

fn run_fault(fault: Fault, point: &str) -> (Frames, Duration) {
    let is_silent = |said: &str| said.contains("coordinator is silent");
    match fault {
        CoordinatorKilled => coordinator_killed(point),
        CoordinatorKilledTwice => coordinator_killed_twice(point),
        CoordinatorStopped => coordinator_stopped(point),
        WorkerKilled => worker_killed(point, 0),
        WorkerKilledWithResult => worker_killed(point, 1),
        WorkerStopped => worker_stopped(point),
        LinkCut => link_broken(point, Proxy::cut, |said| said.contains("coordinator unreachable")),
        LinkFrozen => link_broken(point, Proxy::freeze, is_silent),
        LinkFrozenOneWay(direction) => link_broken(point, |proxy| proxy.freeze_direction(direction), is_silent),
        RenderKilled => render_killed(point),
    }
}

#[test]
fn at_every_point_the_frames_are_those_of_one_process() {
    let dir = TestFolder::new();
    dir.run(&format!("render fog.mgf -o alone {SETTINGS}")).exits(0);
    let alone = frames(&dir, "alone");
    assert_eq!(alone.len(), 2);
    // A part of a line of the table selects that line alone.
    let only = std::env::var("FEMC_ONLY_FAULT").unwrap_or_default();
    let points: Vec<_> = POINTS.iter().filter(|(fault, point)| format!("{fault:?} {point}").contains(&only)).collect();
    let (next, failed) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let lane = || {
        while let Some((fault, point)) = points.get(next.fetch_add(1, Ordering::Relaxed)) {
            let begun = Instant::now();
            let name = format!("{:<32} {point:<32}", format!("{fault:?}"));
            match catch_unwind(AssertUnwindSafe(|| run_fault(*fault, point))) {
                Ok((frames, passed)) if frames == alone => println!(
                    "{name} fired, went on after {:5.2} s, all in {:5.2} s",
                    passed.as_secs_f64(),
                    begun.elapsed().as_secs_f64()
                ),
                Ok(_) => failed.lock().expect("no panic").push(format!("{name} other pixels")),
                Err(_) => failed.lock().expect("no panic").push(name),
            }
        }
    };
    std::thread::scope(|scope| (0..PARALLEL_POINTS).for_each(|_| drop(scope.spawn(lane))));
    let failed = failed.into_inner().expect("no panic");
    assert!(failed.is_empty(), "{failed:#?}");
}
