//! Tests of the identity of leases. A lease is identified by job, stage, index and epoch, and one session holds it. A lease that a
//! worker reports from an earlier session must also have the job's key and the steps of the running lease. A message that differs
//! in any of these changes nothing about the running lease.

use crate::common::{self, TestFarm, job, panic_failure, registration, result_of};
use femc_model::*;
use femc_schedule::*;

use Decision::{Continue, Done};

/// Returns the parts of a lease's key, each with a key that differs in that part: keys of other running leases, and of none.
fn differing_keys(Assignment { task, epoch, .. }: &Assignment) -> Vec<(&'static str, TaskKey, Epoch)> {
    let of = |part, stage| (part, TaskKey { stage, ..*task }, *epoch);
    let stage = task.stage;
    vec![
        ("job", TaskKey { job: JobId(2), ..*task }, *epoch),
        ("unknown job", TaskKey { job: JobId(7), ..*task }, *epoch),
        of("frame", Stage { frame: 2, ..stage }),
        of("unknown frame", Stage { frame: 7, ..stage }),
        of("round", Stage { round: 1, ..stage }),
        of("number of the stage", Stage { number: 1, ..stage }),
        of("kind of the stage", Stage { kind: StageKind::Image, ..stage }),
        of("stage", Stage { number: 1, kind: StageKind::Image, ..stage }),
        ("index", TaskKey { index: 1, ..*task }, *epoch),
        ("unknown index", TaskKey { index: 7, ..*task }, *epoch),
        ("epoch before", *task, Epoch(epoch.0 - 1)),
        ("epoch behind", *task, Epoch(epoch.0 + 1)),
        ("epoch of another life", *task, Epoch(epoch.0 + Epoch::new(1, 0).0)),
    ]
}

/// Creates a farm with two equal jobs, all of whose tiles worker 1 holds. Returns also its lease of the first job's first tile.
fn running_farm() -> (TestFarm, Assignment) {
    let mut farm = TestFarm::with_config(Config { prefetch: 20, ..common::config() });
    for number in 1..=2 {
        assert_eq!(farm.submit(job(&[1, 2], 2, &[8, 16])), JobId(number));
    }
    farm.join(1);
    assert_eq!(farm.tasks_of(1).len(), 8, "nothing is free");
    let held = farm.first_lease_of(1);
    assert_eq!((held.task.job, held.task.stage.frame, held.task.index), (JobId(1), 1, 0));
    (farm, held)
}

fn leases(farm: &TestFarm, worker: u64) -> Vec<LeaseStatus> {
    farm.scheduler.leases(WorkerId(worker), farm.now)
}

/// Checks that the commands revoke this lease of this worker once.
fn is_revoked_once(commands: &[Command], to: u64, lease: (TaskKey, Epoch)) -> bool {
    let is_it = |command: &&Command| matches!(command, Command::Revoke { worker, task, epoch, .. } if (worker.0, (*task, *epoch)) == (to, lease));
    commands.iter().filter(is_it).count() == 1
}

fn is_refused(commands: &[Command], from: u64, lease: (TaskKey, Epoch)) -> bool {
    let is_it = |command: &Command| matches!(command, Command::Refuse { worker, task, epoch, .. } if (worker.0, (*task, *epoch)) == (from, lease));
    let is_accepted = |command: &Command| matches!(command, Command::Accept { .. });
    commands.iter().any(is_it) && !commands.iter().any(is_accepted)
}

fn count_facts(commands: &[Command]) -> usize {
    commands.iter().filter(|command| matches!(command, Command::Record(_))).count()
}

fn is_recorded(commands: &[Command]) -> bool {
    commands.iter().any(|command| matches!(command, Command::Record(Fact::Done { .. })))
}

/// Returns jobs that differ from that of [`running_farm`] in one property that affects pixels.
fn other_jobs() -> Vec<(&'static str, JobSpec)> {
    let same = || job(&[1, 2], 2, &[8, 16]);
    let digest = Digest::compute(b"another");
    vec![
        ("scene", JobSpec { bundle: digest, ..same() }),
        ("file of the scene", JobSpec { entry: "mist.mgf".into(), ..same() }),
        ("settings", JobSpec { settings: "{ }".into(), ..same() }),
        ("frames", JobSpec { frames: vec![1, 3], ..same() }),
        ("film", JobSpec { grid: Grid { film: [16, 9], tile: 8 }, ..same() }),
        ("rounds", JobSpec { graph: common::tile_graph(2, &[8, 17], 0), ..same() }),
        ("contents", JobSpec { contents: vec![(2, digest)], ..same() }),
    ]
}

#[test]
fn a_lease_from_elsewhere_takes_over_none_that_runs() {
    let (farm, held) = running_farm();
    let own = farm.held_lease(&held);
    let named = differing_keys(&held).into_iter();
    let named = named.map(|(what, task, epoch)| (what, HeldLease { task, epoch, ..own.clone() }));
    // A job of another farm with the same number, or one that was lost with an earlier log: all numbers are equal by chance.
    let jobs = other_jobs().into_iter().map(|(what, spec)| (what, HeldLease { job: spec.key(), ..own.clone() }));
    // A lease of another farm for the same job, whose tasks that farm has divided differently.
    let steps = [0..7, 1..8, 0..9, 0..16, 8..16, 0..0].map(|steps| ("steps", HeldLease { steps, ..own.clone() }));
    let mut cases = 0;
    for (what, reported) in named.chain(jobs).chain(steps) {
        let (mut farm, name) = (running_farm().0, (reported.task, reported.epoch));
        let before = leases(&farm, 1);
        let commands = farm.join_as(2, Registration { instance: 2, held: vec![reported.clone()], ..registration() });
        assert!(is_revoked_once(&commands, 2, name), "another {what}: {commands:?}");
        assert_eq!((leases(&farm, 1), leases(&farm, 2)), (before, vec![]), "another {what}");
        assert!(is_recorded(&farm.complete(1, &held, Done)), "another {what}: the lease holds");
        cases += 1;
    }
    assert_eq!(cases, 13 + 7 + 6);
    // With the same key, job and steps it is the same worker.
    let (mut farm, _) = running_farm();
    let mut commands = farm.join_as(2, Registration { instance: 2, held: vec![own], ..registration() });
    commands.retain(|command| matches!(command, Command::Revoke { .. }));
    assert_eq!((commands, leases(&farm, 2).len(), leases(&farm, 1).len()), (vec![], 1, 7));
}

#[test]
fn running_lease_is_not_adopted_by_worker_of_another_build() {
    let (mut farm, held) = running_farm();
    farm.complete_first(1, Done);
    let running = farm.first_lease_of(1);
    assert_eq!(running.task.stage.frame, held.task.stage.frame, "of the frame that has a build now");
    let (before, reported) = (leases(&farm, 1), farm.held_lease(&running));
    let other = Registration { instance: 2, engine: "another".into(), held: vec![reported], ..registration() };
    let commands = farm.join_as(2, other);
    assert!(is_revoked_once(&commands, 2, (running.task, running.epoch)), "{commands:?}");
    assert_eq!((leases(&farm, 1), leases(&farm, 2)), (before, vec![]));
}

#[test]
fn reports_count_only_for_named_lease_and_its_session() {
    let (_, held) = running_farm();
    let names = differing_keys(&held).into_iter().map(|(what, task, epoch)| (what, 1, task, epoch));
    for (what, from, task, epoch) in names.chain([("session", 2, held.task, held.epoch)]) {
        let (worker, named) = (WorkerId(from), (task, epoch));
        let (result, artifact) = (result_of(&held, Done), Digest::compute(b"tile"));
        let reports = [
            Event::Completed { worker, task, epoch, result },
            Event::Failed { worker, task, epoch, failure: panic_failure() },
            Event::ArtifactMissing { worker, task, epoch, artifact, message: "gone".into() },
        ];
        for report in reports {
            let mut farm = running_farm().0;
            farm.join(2);
            let before = leases(&farm, 1);
            let commands = farm.handle(report.clone());
            assert!(is_refused(&commands, from, named), "another {what}, {report:?}: {commands:?}");
            assert_eq!(count_facts(&commands), 0, "another {what}, {report:?}: {commands:?}");
            assert_eq!(leases(&farm, 1), before, "another {what}, {report:?}");
            assert!(is_recorded(&farm.complete(1, &held, Done)), "another {what}, {report:?}: the lease holds");
        }
    }
}

#[test]
fn repeated_completion_is_accepted_only_for_counted_lease() {
    let ends: [fn(&Assignment) -> bool; 3] = [
        |held| held.task.stage.kind == StageKind::Render,
        // Its outputs are already released when the next round has begun.
        |held| held.task.stage.kind == StageKind::Image,
        |held| (held.task.stage.kind, held.task.stage.round) == (StageKind::Image, 1),
    ];
    for is_last in ends {
        let mut farm = running_farm().0;
        let held = loop {
            let held = farm.first_lease_of(1);
            farm.complete(1, &held, Continue);
            if is_last(&held) {
                break held;
            }
        };
        let repeat = |farm: &mut TestFarm, task, epoch| {
            farm.handle(Event::Completed { worker: WorkerId(1), task, epoch, result: result_of(&held, Continue) })
        };
        let stage = Stage { number: 0, kind: StageKind::Render, ..held.task.stage };
        let tile = ("tile", TaskKey { stage, ..held.task }, held.epoch);
        let named = differing_keys(&held).into_iter().chain([tile]);
        for (what, task, epoch) in named.filter(|(_, task, epoch)| (*task, *epoch) != (held.task, held.epoch)) {
            let commands = repeat(&mut farm, task, epoch);
            let is_answered = is_refused(&commands, 1, (task, epoch)) && count_facts(&commands) == 0;
            assert!(is_answered, "another {what} than {}: {commands:?}", held.task);
        }
        let commands = repeat(&mut farm, held.task, held.epoch);
        assert_eq!(commands, [Command::Accept { worker: WorkerId(1), task: held.task, epoch: held.epoch }]);
    }
}

#[test]
fn heartbeat_renews_only_named_leases_of_its_session() {
    let (_, held) = running_farm();
    let names = differing_keys(&held).into_iter().map(|(what, task, epoch)| (what, 1, task, epoch));
    for (what, from, task, epoch) in names.chain([("session", 2, held.task, held.epoch)]) {
        let mut farm = running_farm().0;
        farm.join(2);
        farm.now = farm.now.after(1_000);
        let (before, runs) = (leases(&farm, 1), farm.leases.iter().any(|(_, it)| (it.task, it.epoch) == (task, epoch)));
        assert!(!runs || from == 2, "{what}");
        let tasks = vec![TaskProgress { task, epoch, phase: Phase::Working, units: 3 }];
        let commands = farm.handle(Event::Heartbeat { worker: WorkerId(from), tasks });
        assert!(is_revoked_once(&commands, from, (task, epoch)), "another {what}: {commands:?}");
        assert_eq!(leases(&farm, 1), before, "another {what}: nothing is renewed");
        assert_eq!(farm.status(JobId(1)).stale_messages, u64::from(task.job == JobId(1)), "another {what}");
        assert_eq!(farm.status(JobId(1)).samples_done, 0, "another {what}: it has got no further");
    }
    let mut farm = running_farm().0;
    farm.now = farm.now.after(1_000);
    let tasks = vec![TaskProgress { task: held.task, epoch: held.epoch, phase: Phase::Working, units: 3 }];
    farm.handle(Event::Heartbeat { worker: WorkerId(1), tasks });
    let left: Vec<u64> = leases(&farm, 1).iter().map(|lease| lease.remaining).collect();
    assert_eq!(left, [vec![5_000], vec![4_000; 7]].concat(), "just the one that it names");
}

#[test]
fn logs_and_usage_are_kept_only_for_named_lease() {
    let (_, held) = running_farm();
    let names = differing_keys(&held).into_iter().map(|(what, task, epoch)| (what, 1, task, epoch));
    for (what, from, task, epoch) in names.chain([("session", 2, held.task, held.epoch)]) {
        let mut farm = running_farm().0;
        farm.join(2);
        let (worker, text) = (WorkerId(from), LogText::Inline("rendered".into()));
        let log = TaskLog { outcome: AttemptOutcome::Done, seconds: 0.5, text };
        assert_eq!(farm.handle(Event::Logged { worker, task, epoch, log }), [], "another {what}");
        let usage = TaskUsage { task, epoch, usage: ResourceUsage { cpu: 3.0, ..ResourceUsage::default() } };
        farm.handle(Event::Usage { worker, usage });
        let commands = farm.complete(1, &held, Done);
        let noted: Vec<Option<ResourceUsage>> = commands
            .iter()
            .filter_map(|command| if let Command::RecordAttempt(note) = command { Some(note.usage) } else { None })
            .collect();
        assert_eq!(noted, [None], "another {what}");
        let logs = [1, 2].map(|job| farm.scheduler.logs(JobId(job), Tick(0)).unwrap());
        assert_eq!(logs, [vec![], vec![]], "another {what}");
    }
}

#[test]
fn a_death_counts_for_the_task_and_job_that_it_names_alone() {
    let (farm, held) = running_farm();
    let own = farm.held_lease(&held);
    let named = differing_keys(&held).into_iter().filter(|(_, task, _)| *task != held.task);
    // These parts are left out: they give tasks that exist here, too, and may have caused the death.
    let named = named.filter(|(what, ..)| !["job", "frame", "index"].contains(what));
    let named = named.map(|(what, task, _)| (what, HeldLease { task, ..own.clone() }));
    let jobs = other_jobs().into_iter().map(|(what, spec)| (what, HeldLease { job: spec.key(), ..own.clone() }));
    for (what, lease) in named.chain(jobs).chain([("steps", HeldLease { steps: 0..7, ..own.clone() })]) {
        let mut farm = running_farm().0;
        farm.leave(1);
        let died = Some(Death { instance: 1, computing: vec![lease] });
        let commands = farm.join_as(2, Registration { instance: 2, death: died, ..registration() });
        assert_eq!(count_facts(&commands), 0, "another {what}: {commands:?}");
    }
}

#[test]
fn unheld_lease_is_adopted_only_for_existing_task() {
    let (farm, held) = running_farm();
    let own = farm.held_lease(&held);
    // These parts give tasks that exist here and are not leased; the epochs are of leases that nobody holds any more.
    let free = ["job", "frame", "index", "epoch before", "epoch behind", "epoch of another life"];
    let named = differing_keys(&held).into_iter();
    let named = named.map(|(what, task, epoch)| (what, HeldLease { task, epoch, ..own.clone() }));
    let jobs = other_jobs().into_iter().map(|(what, spec)| (what, HeldLease { job: spec.key(), ..own.clone() }));
    let steps = [0..7, 1..8, 0..9, 0..16, 8..16, 0..0].map(|steps| ("steps", HeldLease { steps, ..own.clone() }));
    for (what, reported) in named.chain(jobs).chain(steps).chain([("nothing", own.clone())]) {
        let (mut farm, name) = (running_farm().0, (reported.task, reported.epoch));
        farm.restart();
        let commands = farm.join_as(2, Registration { instance: 2, held: vec![reported], ..registration() });
        let is_adopted = leases(&farm, 2).iter().any(|lease| (lease.task, lease.epoch) == name);
        assert_eq!(is_adopted, free.contains(&what) || what == "nothing", "another {what}: {commands:?}");
        assert_eq!(is_revoked_once(&commands, 2, name), !is_adopted, "another {what}: {commands:?}");
    }
}

#[test]
fn what_a_lease_took_is_noted_of_it_whichever_ends_first() {
    let noted = |commands: &[Command]| -> Vec<Option<f64>> {
        let note = |command: &Command| if let Command::RecordAttempt(note) = command { Some(note.usage) } else { None };
        commands.iter().filter_map(note).map(|usage| usage.map(|usage| usage.cpu)).collect()
    };
    for (reported, other) in [(0, 1), (1, 0)] {
        let mut farm = running_farm().0;
        let held = [0, 1].map(|at: usize| farm.leases[at].1.clone());
        let usage = ResourceUsage { cpu: 3.0, ..ResourceUsage::default() };
        let usage = TaskUsage { task: held[reported].task, epoch: held[reported].epoch, usage };
        farm.handle(Event::Usage { worker: WorkerId(1), usage });
        assert_eq!(noted(&farm.complete(1, &held[other], Done)), [None]);
        assert_eq!(noted(&farm.complete(1, &held[reported], Done)), [Some(3.0)]);
    }
}

#[test]
fn adopted_lease_gets_full_time_and_restarts_preparation() {
    let (mut farm, held) = running_farm();
    let config = farm.scheduler.config().clone();
    farm.heartbeat(1, Phase::Working, 300);
    farm.now = farm.now.after(config.lease - 1);
    let own = farm.held_lease(&held);
    farm.join_as(2, Registration { instance: 2, held: vec![own], ..registration() });
    assert_eq!(leases(&farm, 2)[0].remaining, config.lease);
    // Longer than the stall limit of a working task, and shorter than that of a preparation.
    let ends = farm.now.after(config.stall + 2 * config.lease);
    assert!(config.stall + 3 * config.lease < config.preparation_stall);
    while farm.now < ends {
        let (task, epoch) = (held.task, held.epoch);
        let tasks = vec![TaskProgress { task, epoch, phase: Phase::Preparing, units: 0 }];
        farm.handle(Event::Heartbeat { worker: WorkerId(2), tasks });
        farm.wait(config.lease - 1);
    }
    assert!(leases(&farm, 2).iter().any(|lease| lease.epoch == held.epoch));
}
