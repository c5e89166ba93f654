//! Tests of several coordinators on one PostgreSQL as separate processes, with workers and real frames.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::time::Instant;

use crate::common;
use crate::common::{TestFolder, TestProcess, file_names};
use femc_model::{Stage, TaskKey};
use femc_queue::testing::ScratchDatabase;
use femc_queue::{Postgres, Queue as _, Standby};
use femc_schedule::Fact;

/// Addresses of two coordinators, and a database for both.
struct Farm {
    dir: TestFolder,
    runtime: tokio::runtime::Runtime,
    scratch: ScratchDatabase,
    urls: [String; 2],
}

/// Settings of a job that takes longer than a take-over on two slow cores.
const SETTINGS: &str = "--spp 64 --size 64x64";

impl Farm {
    fn new() -> Option<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let scratch = runtime.block_on(ScratchDatabase::new())?;
        // The ports are free now. Other programs get other ports, because the system assigns them in turn.
        let free = [(); 2].map(|()| TcpListener::bind("127.0.0.1:0").expect("a free port"));
        let urls = free.map(|port| format!("http://{}", port.local_addr().expect("an address")));
        Some(Self { dir: TestFolder::new(), runtime, scratch, urls })
    }

    fn start_coordinator(&self, number: usize) -> TestProcess {
        let (listen, store) = (self.urls[number].trim_start_matches("http://"), self.scratch.url());
        let line = format!("coordinator --listen {listen} --store {store} --artifacts artifacts");
        self.dir.start_as(&number.to_string(), &line)
    }

    /// Returns how often a coordinator has become the leader.
    fn terms(&self, number: usize) -> usize {
        self.dir.read(&format!("{number}.out")).matches(&format!("listening on {}", self.urls[number])).count()
    }

    /// Returns how often a coordinator has reported that the other leads.
    fn standby_notices(&self, number: usize) -> usize {
        self.dir
            .read(&format!("{number}.err"))
            .matches(&format!("standing by; {} leads", self.urls[1 - number]))
            .count()
    }

    fn both_urls(&self) -> String {
        self.urls.join(",")
    }

    fn worker(&self, name: &str) -> TestProcess {
        self.dir.start_as(name, &format!("worker --join {} --threads 1", self.both_urls()))
    }

    fn submit(&self) -> String {
        let ran = self.dir.run(&format!("submit fog.mgf {SETTINGS} --server {}", self.both_urls())).exits(0);
        ran.stdout().lines().last().expect("a job id").to_owned()
    }

    /// Returns the finished share of the samples, as reported by this coordinator; `None` if it does not answer.
    fn finished_share(&self, number: usize, job: &str) -> Option<f64> {
        let ran = self.dir.run(&format!("status {job} --json --server {}", self.urls[number]));
        (ran.code() == Some(0)).then(|| {
            let status = ran.json();
            status["samples"].as_f64().expect("a number") / status["samples_most"].as_f64().expect("a number")
        })
    }

    fn workers(&self, number: usize) -> usize {
        let ran = self.dir.run(&format!("workers --json --server {}", self.urls[number])).exits(0);
        ran.json().as_array().map_or(0, Vec::len)
    }

    /// Waits until `leader` leads, answers, has its workers back and makes progress with the job. Prints the times.
    fn assert_takeover(&self, leader: usize, process: &mut TestProcess, terms: usize, workers: usize, job: &str) {
        let begun = Instant::now();
        let passed = || begun.elapsed().as_secs_f64();
        process.wait_until("its term", || self.terms(leader) == terms);
        let listens = passed();
        let before = self.finished_share(leader, job).expect("an answer");
        let answers = passed();
        process.wait_until("the workers", || self.workers(leader) == workers);
        let joined = passed();
        process.wait_until("new samples", || {
            self.finished_share(leader, job).is_some_and(|share| share > before || share == 1.0)
        });
        println!(
            "take-over with {:.0} % of the samples done: listens after {listens:.2} s, answers after {answers:.2} s, \
             has all {workers} workers after {joined:.2} s, new samples after {:.2} s",
            100.0 * before,
            passed()
        );
        assert!(before < 0.9, "it was not over yet");
    }

    /// Checks that the frames equal those of one process, bit by bit.
    fn assert_same_as_one_process(&self, job: &str) {
        self.dir.run(&format!("fetch {job} -o out --server {}", self.both_urls())).exits(0);
        self.dir.run(&format!("render fog.mgf -o alone {SETTINGS}")).exits(0);
        assert_eq!(file_names(&self.dir.path("out")), file_names(&self.dir.path("alone")));
        for name in file_names(&self.dir.path("alone")) {
            let (farm, alone) = (self.dir.path("out").join(&name), self.dir.path("alone").join(&name));
            assert_eq!(common::pixels(&farm), common::pixels(&alone), "{name}");
        }
    }

    /// Checks in the log, after all coordinators have ended, that each task of the only job took effect once, and that none is
    /// missing.
    fn assert_each_task_once(&self) {
        let records = self.runtime.block_on(async {
            let database = self.scratch.url().parse().expect("an address");
            let standby = Standby::open(database, "http://test".into(), Postgres::SILENCE).await.expect("a database");
            let mut queue = standby.wait_for_lead(|_| ()).await.expect("the lead");
            queue.load().await.expect("a log").records
        });
        let (mut spec, mut effects, mut others, mut terms) = (None, BTreeMap::new(), Vec::new(), 0);
        for record in &records {
            match Fact::decode(record).expect("a fact").1 {
                Fact::Submitted { job, spec: submitted, .. } => spec = Some((job, submitted)),
                Fact::Done { task, .. } => {
                    *effects.entry(task).or_insert(0) += 1;
                }
                Fact::CoordinatorStarted { .. } => terms += 1,
                Fact::Logged { .. }
                | Fact::BuildAssigned { .. }
                | Fact::TimeCharged { .. }
                | Fact::Metered { .. }
                | Fact::Announced { .. } => {}
                other => others.push(other),
            }
        }
        let (job, spec) = spec.expect("a job");
        let mut tasks = Vec::new();
        for &frame in &spec.frames {
            for (number, template) in spec.graph.iter() {
                for round in 0..spec.graph.rounds(number) {
                    let stage = Stage { frame, round, number, kind: template.kind };
                    tasks.extend((0..template.tasks()).map(|index| TaskKey { job, stage, index }));
                }
            }
        }
        let lost = tasks.iter().filter(|task| !effects.contains_key(task)).count();
        let twice = effects.values().filter(|&&count| count > 1).count();
        println!("{} tasks, {terms} terms: {lost} lost, {twice} done twice with effect", tasks.len());
        assert_eq!((lost, twice, effects.len()), (0, 0, tasks.len()));
        assert_eq!(others, [], "nothing failed, was lost or began anew");
    }
}

#[test]
fn a_killed_leader_is_replaced_and_costs_no_pixel() {
    let Some(farm) = Farm::new() else { return };
    let mut one = farm.start_coordinator(0);
    one.wait_until("its term", || farm.terms(0) == 1);
    let mut two = farm.start_coordinator(1);
    two.wait_until("its bow", || farm.standby_notices(1) == 1);
    let (_first, _second) = (farm.worker("first"), farm.worker("second"));
    let job = farm.submit();
    let mut watch = farm.dir.start(&format!("watch {job} --server {}", farm.both_urls()));
    one.wait_until("some samples", || farm.finished_share(0, &job).is_some_and(|share| share > 0.1));
    assert_eq!(farm.terms(1), 0, "who stands by does not listen");
    assert!(one.kill(), "the leader was alive");
    farm.assert_takeover(1, &mut two, 1, 2, &job);
    watch.end().exits(0);
    farm.assert_same_as_one_process(&job);
    drop((one, two));
    farm.assert_each_task_once();
}

#[test]
fn frozen_leader_becomes_standby_and_leads_after_the_next_death() {
    let Some(farm) = Farm::new() else { return };
    let mut one = farm.start_coordinator(0);
    one.wait_until("its term", || farm.terms(0) == 1);
    let mut two = farm.start_coordinator(1);
    two.wait_until("its bow", || farm.standby_notices(1) == 1);
    let (_first, _second) = (farm.worker("first"), farm.worker("second"));
    let job = farm.submit();
    let mut watch = farm.dir.start(&format!("watch {job} --server {}", farm.both_urls()));
    one.wait_until("some samples", || farm.finished_share(0, &job).is_some_and(|share| share > 0.1));
    one.signal("STOP");
    farm.assert_takeover(1, &mut two, 1, 2, &job);
    one.signal("CONT");
    one.wait_until("its bow", || farm.standby_notices(0) == 1);
    assert_eq!((farm.terms(0), farm.terms(1)), (1, 1), "it has not led since");
    assert_eq!(farm.finished_share(0, &job), None, "and does not answer");
    assert!(two.kill(), "the leader was alive");
    farm.assert_takeover(0, &mut one, 2, 2, &job);
    watch.end().exits(0);
    farm.assert_same_as_one_process(&job);
    drop((one, two));
    farm.assert_each_task_once();
}

#[test]
fn a_database_that_does_not_let_one_in_is_told_in_one_line() {
    let Some(farm) = Farm::new() else { return };
    let url = farm.scratch.url();
    let (head, tail) = url.split_once('@').expect("a user");
    let (user, password) = head.rsplit_once(':').expect("a password");
    let nobody = farm.urls[0].trim_start_matches("http://");
    for (store, code, word) in [
        (format!("{user}:wrong@{tail}"), 1, "password"),
        (format!("{head}@{}/nowhere", tail.split_once('/').expect("a path").0), 1, "nowhere"),
        (format!("postgres://ann:{password}@{nobody}/farm"), 1, "check that PostgreSQL runs there"),
        ("postgres://host:port/farm".to_owned(), 2, "postgres://user@host"),
    ] {
        let ran = farm.dir.run(&format!("coordinator --listen 127.0.0.1:0 --store {store} --artifacts a")).exits(code);
        assert!(ran.stderr().contains(word), "{}", ran.stderr());
        assert!(!ran.stderr().contains(password) && !ran.stderr().contains("panicked"), "{}", ran.stderr());
    }
    let ran = farm.dir.run(&format!("coordinator --listen 127.0.0.1:0 --store {url} --artifacts memory")).exits(2);
    assert!(ran.stderr().contains("share a folder"), "{}", ran.stderr());
}
