//! Fault injection: real processes are killed, stopped and disconnected at chosen points. Each fault leaves a token file when its
//! point is reached. The frames must equal the frames of one process.
#![cfg(all(unix, debug_assertions))]

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::common;
use crate::common::proxy::{Proxy, Way};
use crate::common::{PATIENCE, Place, Running, names};
use femc_queue::{Queue as _, Sqlite};
use femc_schedule::Fact;

/// Settings of a job: two frames of four tiles; a tile takes some tenths of a second.
const SETTINGS: &str = "--spp 64 --size 32x32 --frames 1..2";
/// Tasks of a submitted job: per frame four tiles, two groups (of three tiles and of one) and an image. `femc render` reduces four
/// tiles at once.
const TASKS: usize = 2 * (4 + 2 + 1);
/// Number of points that are tested in parallel. Most of a test's time is waiting.
const LANES: usize = 4;

/// Time after which a resumed worker has reported everything that it had to report: one lease.
const SETTLED: Duration = Duration::from_secs(2);

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
    LinkFrozenOneWay(Way),
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
    (LinkFrozenOneWay(Way::Up), "worker-in-task:1"),
    (LinkFrozenOneWay(Way::Down), "worker-in-task:1"),
    (LinkCut, "coordinator-mid-upload:6"),
    (LinkFrozen, "coordinator-mid-upload:6"),
    (LinkFrozenOneWay(Way::Down), "coordinator-mid-upload:6"),
    (RenderKilled, "coordinator-after-append:5"),
    (RenderKilled, "worker-after-upload:3"),
    (RenderKilled, "worker-mid-reduce:7"),
    (RenderKilled, "render-before-file:2"),
    (RenderKilled, "render-after-file:1"),
];

/// Bits of the frames by file name.
type Frames = BTreeMap<String, Vec<u32>>;

fn frames(place: &Place, folder: &str) -> Frames {
    let folder = place.path(folder);
    names(&folder).into_iter().map(|name| (name.clone(), common::pixels(&folder.join(name)))).collect()
}

/// A farm in which one fault happens.
struct Farm {
    place: Place,
    coordinator: Running,
    url: String,
    submission: Running,
    job: String,
}

/// Waits for a condition that no single process of the test belongs to.
#[track_caller]
fn wait(what: &str, mut condition: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !condition() {
        assert!(begun.elapsed() < PATIENCE, "{what} never came");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn coordinator(place: &Place, port: &str, fault: Option<&str>) -> (Running, String) {
    // Tests that wait for a snapshot need only a few changes.
    let compact = if fault.is_some_and(|fault| fault.contains("snapshot")) { 4 } else { 20_000 };
    let line = format!(
        "coordinator --listen 127.0.0.1:{port} --store sqlite:farm.db --artifacts artifacts --lease 2s --compact {compact}"
    );
    let mut process = started(place, &line, fault);
    let url = process.address();
    (process, url)
}

fn started(place: &Place, line: &str, fault: Option<&str>) -> Running {
    let mut command = place.command(line);
    if let Some(fault) = fault {
        command.env("FEMC_FAULT", format!("{fault}:{}", place.path("token").display()));
    }
    Running::of(&mut command)
}

fn worker(place: &Place, name: &str, url: &str, fault: Option<&str>) -> Running {
    let mut command =
        place.command(&format!("worker --join {url} --threads 1 --name {name} --outbox {name} --color never"));
    if let Some(fault) = fault {
        command.env("FEMC_FAULT", format!("{fault}:{}", place.path("token").display()));
    }
    place.start_command(name, &mut command)
}

/// Returns the finished tasks in the log, each with its lease's epoch, and whether the log is complete (without a snapshot). The
/// coordinator must have ended.
fn effects(place: &Place) -> (Vec<String>, bool) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let contents = runtime.block_on(async {
        Sqlite::open(&place.path("farm.db")).await.expect("a log").load().await.expect("its content")
    });
    let mut effects = Vec::new();
    for record in &contents.records {
        match Fact::decode(record).expect("a fact").1 {
            Fact::Done { task, epoch, .. } => {
                effects.push(format!("{}.{}", task.to_string().replace('/', "-"), epoch.0));
            }
            Fact::Opened { .. }
            | Fact::Submitted { .. }
            | Fact::Built { .. }
            | Fact::Used { .. }
            | Fact::Metered { .. }
            | Fact::Announced { .. }
            | Fact::Died { .. }
            | Fact::Logged { .. } => {}
            other => panic!("something failed, was lost or began anew: {other:?}"),
        }
    }
    (effects, contents.snapshot.is_none())
}

impl Farm {
    /// Creates a farm and submits a job.
    fn new(place: Place, fault: Option<&str>) -> Self {
        let (coordinator, url) = coordinator(&place, "0", fault);
        let mut submission = place.command(&format!("submit fog.mgf {SETTINGS} --server {url}"));
        let submission = Running::of(submission.env("FEMC_PRETEND", "fan=3"));
        Self { place, coordinator, url, submission, job: String::new() }
    }

    /// Waits until the fault has reached its point.
    fn fires(&self) {
        wait("the token", || self.place.path("token").exists());
    }

    /// Lets the process that waits at the point continue.
    fn release(&self) {
        std::fs::remove_file(self.place.path("token")).expect("the token was there");
        // This file proves that the fault fired, after the token is removed.
        self.place.write("fired", "");
    }

    /// Kills the coordinator and restarts it at the same address.
    fn restart(&mut self, fault: Option<&str>) {
        assert!(self.coordinator.kill(), "it was alive");
        let port = self.url.rsplit(':').next().expect("a port").to_owned();
        self.coordinator = coordinator(&self.place, &port, fault).0;
    }

    /// Waits for the answer to the submission.
    fn submitted(&mut self) {
        let ran = self.submission.end().exits(0);
        self.job = ran.stdout().lines().last().expect("a job").to_owned();
    }

    /// Returns the finished samples and frames.
    fn done(&self) -> (u64, u64) {
        let status = common::status(&self.place, &self.url, &self.job);
        let number = |key: &str| status[key].as_u64().expect("a number");
        assert!(number("frames_failed") == 0 && status["failure"].is_null(), "{status}");
        (number("samples"), number("frames_done"))
    }

    /// Waits until more than `before` is finished.
    fn goes_on(&self, before: (u64, u64)) {
        wait("progress", || {
            let done = self.done();
            assert!(done.1 >= before.1, "finished frames are gone: {before:?} before, {done:?} after");
            done > before || done.1 == 2
        });
    }

    fn ends(&self) -> Frames {
        self.place.run(&format!("watch {} --server {}", self.job, self.url)).exits(0);
        assert_eq!(common::status(&self.place, &self.url, &self.job)["state"], "done");
        self.place.run(&format!("fetch {} -o out --server {}", self.job, self.url)).exits(0);
        let jobs = self.place.run(&format!("jobs --json --server {}", self.url)).exits(0).json();
        assert_eq!(jobs.as_array().map(Vec::len), Some(1), "one submission is one job: {jobs}");
        frames(&self.place, "out")
    }

    /// Ends the farm and checks the log: each task took effect once, and the results in `before` are unchanged.
    fn audit(mut self, before: &[String]) {
        assert!(self.coordinator.kill(), "it was alive");
        let (effects, is_all) = effects(&self.place);
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
fn large(place: &Place) {
    let mut state = 1u64;
    let mut line = |_| {
        let mut word = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state ^ (state >> 29)).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        };
        format!("# {:016x}{:016x}{:016x}{:016x}\n", word(), word(), word(), word())
    };
    let mesh: String = (0..50_000).map(&mut line).collect();
    place.write("mesh.mgf", &mesh);
    place.write("fog.mgf", &format!("i mesh.mgf\n{}", common::FOG));
}

fn coordinator_killed(point: &str) -> (Frames, Duration) {
    let place = Place::new();
    if point == "coordinator-mid-upload:2" {
        large(&place);
    }
    let mut farm = Farm::new(place, Some(point));
    let _worker = worker(&farm.place, "first", &farm.url, None);
    farm.fires();
    assert!(farm.coordinator.kill(), "it was alive");
    let begun = Instant::now();
    let (before, _) = effects(&farm.place);
    let port = farm.url.rsplit(':').next().expect("a port").to_owned();
    farm.coordinator = coordinator(&farm.place, &port, None).0;
    farm.submitted();
    let kept = farm.done();
    assert!(kept.0 >= 64 * 256 * before.iter().filter(|effect| effect.contains("render")).count() as u64, "{kept:?}");
    farm.goes_on(kept);
    let passed = begun.elapsed();
    let frames = farm.ends();
    farm.audit(&before);
    (frames, passed)
}

fn coordinator_killed_twice(point: &str) -> (Frames, Duration) {
    let mut farm = Farm::new(Place::new(), None);
    let _worker = worker(&farm.place, "first", &farm.url, None);
    farm.submitted();
    // Wait for a finished tile: the samples that `done` counts may belong to a running task.
    wait("a tile", || {
        let status = common::status(&farm.place, &farm.url, &farm.job);
        let tiles = |frame: &serde_json::Value| frame["tiles_done"].as_u64();
        status["frames_done"].as_u64() > Some(0)
            || status["active"].as_array().is_some_and(|active| active.iter().any(|frame| tiles(frame) > Some(0)))
    });
    let begun = Instant::now();
    farm.restart(Some(point));
    farm.fires();
    assert!(farm.coordinator.kill(), "it was alive");
    let (before, _) = effects(&farm.place);
    assert!(!before.is_empty(), "a tile was durable");
    let port = farm.url.rsplit(':').next().expect("a port").to_owned();
    farm.coordinator = coordinator(&farm.place, &port, None).0;
    farm.goes_on(farm.done());
    let passed = begun.elapsed();
    let frames = farm.ends();
    farm.audit(&before);
    (frames, passed)
}

fn coordinator_stopped(point: &str) -> (Frames, Duration) {
    let mut farm = Farm::new(Place::new(), Some(point));
    let _worker = worker(&farm.place, "first", &farm.url, None);
    farm.submitted();
    farm.fires();
    farm.coordinator.signal("STOP");
    farm.release();
    wait("the worker's doubt", || farm.place.read("first.err").contains("coordinator is silent"));
    farm.coordinator.signal("CONT");
    let begun = Instant::now();
    farm.goes_on(farm.done());
    let passed = begun.elapsed();
    let frames = farm.ends();
    farm.audit(&[]);
    (frames, passed)
}

fn worker_killed(point: &str, results: usize) -> (Frames, Duration) {
    let mut farm = Farm::new(Place::new(), None);
    let mut victim = worker(&farm.place, "first", &farm.url, Some(point));
    farm.submitted();
    farm.fires();
    let kept = || -> Vec<String> {
        let names = names(&farm.place.path("first")).into_iter();
        names.filter_map(|name| name.strip_suffix(".done").map(str::to_owned)).collect()
    };
    if results > 0 {
        wait("a result on disk", || kept().len() >= results);
    }
    let before = farm.done();
    assert!(victim.kill(), "it was alive");
    let begun = Instant::now();
    let kept = kept();
    let _again = worker(&farm.place, "first", &farm.url, None);
    farm.goes_on(before);
    let passed = begun.elapsed();
    let frames = farm.ends();
    // The results on the worker's disk were not computed again.
    farm.audit(&kept);
    (frames, passed)
}

fn worker_stopped(point: &str) -> (Frames, Duration) {
    let mut farm = Farm::new(Place::new(), None);
    let mut victim = worker(&farm.place, "first", &farm.url, Some(point));
    farm.submitted();
    farm.fires();
    victim.signal("STOP");
    farm.release();
    let before = farm.done();
    let begun = Instant::now();
    let _other = worker(&farm.place, "second", &farm.url, None);
    farm.goes_on(before);
    let passed = begun.elapsed();
    let first = farm.ends();
    let before = (farm.done(), farm.place.run(&format!("fetch {} -o then --server {}", farm.job, farm.url)).code());
    victim.signal("CONT");
    let woken = Instant::now();
    // The worker reports its results: in a new session, or in the old one if the answer comes before it doubts the connection.
    wait("its return", || {
        let is_back = farm.place.read("first.err").matches("joined").count() >= 2 || woken.elapsed() > SETTLED;
        let is_empty = names(&farm.place.path("first")).iter().all(|name| !name.ends_with(".done"));
        is_back && is_empty && common::workers(&farm.place, &farm.url).as_array().map(Vec::len) == Some(2)
    });
    let after = (farm.done(), farm.place.run(&format!("fetch {} -o late --server {}", farm.job, farm.url)).code());
    assert_eq!(before, after, "late words change nothing");
    let late = frames(&farm.place, "late");
    assert!(late == first, "late words change no pixel");
    farm.audit(&[]);
    (late, passed)
}

fn link(point: &str, harm: impl FnOnce(&Proxy), is_noticed: impl Fn(&str) -> bool) -> (Frames, Duration) {
    let at = |name: &str| point.starts_with(name).then_some(point);
    let mut farm = Farm::new(Place::new(), at("coordinator"));
    let proxy = Proxy::to(&farm.url);
    let _worker = worker(&farm.place, "first", &proxy.url, at("worker"));
    farm.submitted();
    farm.fires();
    let before = farm.done();
    harm(&proxy);
    farm.release();
    wait("the worker's notice", || is_noticed(&farm.place.read("first.err")));
    let begun = Instant::now();
    proxy.thaw();
    farm.goes_on(before);
    let passed = begun.elapsed();
    let frames = farm.ends();
    farm.audit(&[]);
    (frames, passed)
}

fn render_killed(point: &str) -> (Frames, Duration) {
    let place = Place::new();
    let line = format!("render fog.mgf -o out {SETTINGS} --threads 1");
    let mut render = started(&place, &line, Some(point));
    render.wait_until("the token", || place.path("token").exists());
    assert!(render.kill(), "it was alive");
    let begun = Instant::now();
    let written =
        |name: &String| place.path("out").join(name).metadata().and_then(|data| data.modified()).expect("a time");
    let before: Vec<_> = names(&place.path("out")).into_iter().map(|name| (written(&name), name)).collect();
    let ran = place.run(&format!("{line} --json")).exits(0);
    let passed = begun.elapsed();
    assert_eq!(ran.json()["rendered"].as_u64(), Some(2 - before.len() as u64), "{}", ran.stdout());
    for (time, name) in before {
        assert_eq!(time, written(&name), "a finished frame is not written again");
    }
    assert!(!place.path("out/.femc").exists(), "nothing is left to resume");
    (frames(&place, "out"), passed)
}

fn done(fault: Fault, point: &str) -> (Frames, Duration) {
    let is_silent = |said: &str| said.contains("coordinator is silent");
    match fault {
        CoordinatorKilled => coordinator_killed(point),
        CoordinatorKilledTwice => coordinator_killed_twice(point),
        CoordinatorStopped => coordinator_stopped(point),
        WorkerKilled => worker_killed(point, 0),
        WorkerKilledWithResult => worker_killed(point, 1),
        WorkerStopped => worker_stopped(point),
        LinkCut => link(point, Proxy::cut, |said| said.contains("coordinator unreachable")),
        LinkFrozen => link(point, Proxy::freeze, is_silent),
        LinkFrozenOneWay(way) => link(point, |proxy| proxy.freeze_way(way), is_silent),
        RenderKilled => render_killed(point),
    }
}

#[test]
fn at_every_point_the_frames_are_those_of_one_process() {
    let place = Place::new();
    place.run(&format!("render fog.mgf -o alone {SETTINGS}")).exits(0);
    let alone = frames(&place, "alone");
    assert_eq!(alone.len(), 2);
    // A part of a line of the table selects that line alone.
    let only = std::env::var("FEMC_ONLY_FAULT").unwrap_or_default();
    let points: Vec<_> = POINTS.iter().filter(|(fault, point)| format!("{fault:?} {point}").contains(&only)).collect();
    let (next, failed) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let lane = || {
        while let Some((fault, point)) = points.get(next.fetch_add(1, Ordering::Relaxed)) {
            let begun = Instant::now();
            let name = format!("{:<32} {point:<32}", format!("{fault:?}"));
            match catch_unwind(AssertUnwindSafe(|| done(*fault, point))) {
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
    std::thread::scope(|scope| (0..LANES).for_each(|_| drop(scope.spawn(lane))));
    let failed = failed.into_inner().expect("no panic");
    assert!(failed.is_empty(), "{failed:#?}");
}
