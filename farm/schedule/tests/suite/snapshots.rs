//! Tests that a snapshot, together with the facts after it, gives the ledger that made them.

use std::collections::HashSet;

use crate::common::{TestFarm, config, grouped_job, job, panic_failure, registration};
use femc_model::*;
use femc_schedule::*;

use Decision::{Continue, Done};

/// A disk with a snapshot and the facts since.
struct TestDisk {
    snapshot: Vec<u8>,
    /// Number of facts in the farm's log that the snapshot includes.
    fact_count: usize,
}

impl TestDisk {
    fn from_farm(farm: &TestFarm) -> Self {
        Self { snapshot: farm.scheduler.ledger().encode().unwrap(), fact_count: farm.log.len() }
    }

    /// Returns the ledger that a starting coordinator would read.
    fn read(&self, farm: &TestFarm) -> Ledger {
        let mut ledger = Ledger::decode(&self.snapshot).unwrap();
        for (now, fact) in &farm.log[self.fact_count..] {
            let (now, fact) = Fact::decode(&fact.encode(*now).unwrap()).unwrap();
            ledger.apply(&fact, now);
        }
        ledger
    }

    /// Replaces this snapshot and the facts since with a new snapshot.
    fn replace_snapshot(&mut self, farm: &TestFarm) {
        let before = self.read(farm);
        *self = Self::from_farm(farm);
        assert_eq!(self.read(farm), before, "after {:?}", farm.log.last());
    }
}

/// Completes the worker's oldest task, if it has one.
fn complete_first(farm: &mut TestFarm, worker: u64, decision: Decision) {
    if farm.leases.iter().any(|(holder, _)| holder.0 == worker) {
        farm.complete_first(worker, decision);
    }
}

/// Life of a farm, a few events at a time.
const EVENTS: &[fn(&mut TestFarm)] = &[
    |farm| {
        let (key, spec) = (Some("fog".into()), Box::new(job(&[1, 2], 2, &[4, 8])));
        farm.handle(Event::Submitted { request: RequestId(0), key, spec, date: None });
        farm.submit(JobSpec { owner: "eve".into(), ..grouped_job(&[1], 4, &[4], 2) });
    },
    |farm| drop((farm.join(1), farm.join(2))),
    |farm| complete_first(farm, 1, Done),
    |farm| {
        let held = farm.first_lease_of(2);
        let text = LogText::Stored(Artifact::from_bytes(b"a log"));
        let log = TaskLog { outcome: AttemptOutcome::Failed, seconds: 1.0, text };
        farm.handle(Event::Logged { worker: WorkerId(2), task: held.task, epoch: held.epoch, log });
        farm.fail(2, &held, panic_failure());
    },
    |farm| drop(farm.control(JobId(1), Control::Priority(80))),
    |farm| (0..6).for_each(|_| complete_first(farm, 1, Continue)),
    |farm| drop(farm.handle(Event::Drained { worker: WorkerId(2), drain: Drain::Begin })),
    |farm| {
        let held = farm.first_lease_of(1);
        farm.join_after_death(3, 1, &[held]);
    },
    |farm| drop(farm.wait(30_000)),
    |farm| drop((farm.control(JobId(2), Control::Pause), farm.control(JobId(2), Control::Resume))),
    |farm| drop(farm.join_as(4, Registration { instance: 4, engine: "new".into(), ..registration() })),
    |farm| complete_first(farm, 4, Done),
    |farm| drop(farm.control(JobId(1), Control::Cancel)),
    |farm| drop(farm.control(JobId(1), Control::Retry)),
    |farm| drop(farm.control(JobId(2), Control::Cancel)),
    |farm| drop(farm.wait(90_000)),
];

#[test]
fn snapshot_equals_previous_snapshot_plus_later_facts() {
    // Vary which events a snapshot includes, and which come after it.
    for every in 1..=EVENTS.len() {
        let mut farm = TestFarm::with_config(Config { keep_ended: Some(60_000), ..config() });
        let mut disk = TestDisk::from_farm(&farm);
        for (number, event) in EVENTS.iter().enumerate() {
            event(&mut farm);
            assert_eq!(&disk.read(&farm), farm.scheduler.ledger(), "after {:?}", farm.log.last());
            if number % every == 0 {
                disk.replace_snapshot(&farm);
            }
        }
        assert_eq!(farm.scheduler.jobs(farm.now).len(), 1, "the other is forgotten");
        let kinds: HashSet<_> = farm.log.iter().map(|(_, fact)| std::mem::discriminant(fact)).collect();
        assert!(kinds.len() >= 11, "{:#?}", farm.log);
    }
}

/// Life of a farm, written by a program with version 8 of the log: a snapshot, and all facts, each preceded by its length.
const LOG_8: &[u8] = include_bytes!("../files/log-8.bin");

/// Ledger at the end of that life, as a snapshot of version 9.
const LEDGER_OF_LOG_8: &[u8] = include_bytes!("../files/ledger-9.bin");

/// Returns the parts of a file of this version: a snapshot, and the facts.
fn split_parts(mut file: &[u8], version: u8) -> Vec<&[u8]> {
    let mut parts = Vec::new();
    while let Some((length, after)) = file.split_first_chunk::<4>() {
        let (part, others) = after.split_at(u32::from_le_bytes(*length) as usize);
        assert_eq!(part[0], version);
        parts.push(part);
        file = others;
    }
    parts
}

#[test]
fn a_log_of_version_8_is_read_as_the_ledger_that_wrote_it() {
    let parts = split_parts(LOG_8, 8);
    let wanted = Ledger::decode(LEDGER_OF_LOG_8).unwrap();
    assert_eq!(Ledger::decode(parts[0]).as_ref(), Ok(&wanted));
    let mut ledger = Ledger::default();
    for part in &parts[1..] {
        let (now, fact) = Fact::decode(part).unwrap();
        ledger.apply(&fact, now);
    }
    assert_eq!(ledger, wanted);
    assert!(parts.len() > 11);
    // Version 9 wrote submissions as version 8 did, without their date.
    let submitted = |part: &[u8]| {
        let part: Vec<u8> = [9].into_iter().chain(part[1..].iter().copied()).collect();
        match Fact::decode(&part) {
            Ok((_, Fact::Submitted { spec, date, .. })) => Some((spec.name, date)),
            _ => None,
        }
    };
    let names: Vec<_> = parts[1..].iter().filter_map(|part| submitted(part)).collect();
    assert_eq!(names, [("fog".to_owned(), None), ("fog".to_owned(), None)]);
}

/// Life of a farm, written by a program with version 10 of the log.
const LOG_10: &[u8] = include_bytes!("../files/log-10.bin");

#[test]
fn version_10_log_is_read_with_dates_and_announces_no_end() {
    let parts = split_parts(LOG_10, 10);
    let mut ledger = Ledger::default();
    for part in &parts[1..] {
        let (now, fact) = Fact::decode(part).unwrap();
        ledger.apply(&fact, now);
    }
    assert_eq!(Ledger::decode(parts[0]).as_ref(), Ok(&ledger));
    let now = ledger.now();
    let (scheduler, _) = Scheduler::new(config(), ledger);
    assert_eq!(scheduler.status(JobId(1), now).unwrap().submitted_date, Some(1_795_680_000_000));
    assert_eq!(scheduler.status(JobId(2), now).unwrap().state, JobState::Cancelled);
    assert_eq!(scheduler.ends_to_announce(), []);
}

/// Life of a farm, written by a program with version 11 of the log. The first pass of job 1 has begun: its elements are made, and the
/// rays of one of two blocks are cast. Job 2 lacks its still and its sheet.
const LOG_11: &[u8] = include_bytes!("../files/log-11.bin");

#[test]
fn version_11_log_continues_with_the_present_kinds_and_roles() {
    let parts = split_parts(LOG_11, 11);
    let mut replayed = Ledger::default();
    for part in &parts[1..] {
        let (now, fact) = Fact::decode(part).unwrap();
        replayed.apply(&fact, now);
    }
    for ledger in [Ledger::decode(parts[0]).unwrap(), replayed] {
        let mut farm = TestFarm::from_ledger(Config { prefetch: 0, ..config() }, ledger);
        farm.join(1);
        assert_eq!(farm.leases, [], "a worker without the tag does not know the kinds");
        farm.join_with(2, ["first-pass", "task-kinds"].map(Into::into).into());
        let mut done = Vec::new();
        while let Some((_, held)) = farm.leases.first().cloned() {
            let states = held.spec.inputs_of_role(Role::SolverState).map(|input| (input.need, input.item));
            let stage = held.task.stage;
            done.push((
                held.task.job.is_shared(),
                stage.number,
                stage.kind,
                held.task.index,
                states.collect::<Vec<_>>(),
            ));
            complete_as_graph(&mut farm, 2, &held);
        }
        done.sort_by_key(|(is_shared, number, kind, index, _)| (!is_shared, *number, *kind, *index));
        let of_frames = |number, kind, index| (false, number, kind, index, vec![]);
        use StageKind::{EncodePicture, EncodeSheet, FirstPassFinish, FirstPassRays, Image, Render};
        assert_eq!(
            done,
            [
                // Elements and links were two outputs.
                (true, 1, FirstPassRays, 1, vec![(0, 0), (0, 0)]),
                (true, 2, FirstPassFinish, 0, vec![(0, 0), (0, 0), (1, 0), (1, 1)]),
                of_frames(3, Render, 0),
                of_frames(3, Render, 1),
                of_frames(4, Image, 0),
                of_frames(4, EncodePicture, 0),
                of_frames(5, EncodeSheet, 0),
            ]
        );
        assert!([1, 2].into_iter().all(|job| farm.state(JobId(job)) == JobState::Done));
    }
}

/// Completes a task with the outputs of its stage.
fn complete_as_graph(farm: &mut TestFarm, worker: u64, held: &Assignment) {
    let spec = farm.scheduler.spec(held.task.job).expect("the job is there");
    let stage = spec.graph.stage(held.task.stage.number).expect("the stage is there");
    let output = |&role: &Role| Output {
        role,
        artifact: Artifact::from_bytes(format!("{} {}", role.name(), held.task).as_bytes()),
    };
    let units = if stage.kind.is_divided() { held.spec.steps.len() as u64 * 64 } else { 0 };
    let outputs = stage.outputs.iter().map(output).collect();
    farm.complete_with(worker, held, TaskResult { outputs, units, seconds: 0.5, ..TaskResult::default() });
}
