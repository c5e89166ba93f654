//! Tests of tasks that kill workers.

use crate::common::{TestFarm, config, job, registration};
use femc_model::*;
use femc_schedule::*;

use Decision::Done;

fn registration_named(name: &str, instance: u64) -> Registration {
    Registration { name: name.into(), instance, ..registration() }
}

fn count_deaths(commands: &[Command]) -> usize {
    commands.iter().filter(|command| matches!(command, Command::Record(Fact::WorkerDied { .. }))).count()
}

/// Lets time pass while the connected workers report what they do.
fn pass_time(farm: &mut TestFarm, milliseconds: u64) -> Vec<Command> {
    let mut all = Vec::new();
    for _ in 0..milliseconds / 1_000 {
        farm.now = farm.now.after(1_000);
        for worker in farm.scheduler.workers(farm.now) {
            all.extend(farm.heartbeat(worker.worker.0, Phase::Working, farm.now.0));
        }
        all.extend(farm.wait(0));
    }
    all
}

#[test]
fn task_is_quarantined_after_five_deaths_and_retry_runs_only_it() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2], 1, &[4]));
    farm.join(1);
    let deadly = farm.first_lease_of(1);
    for life in 1..=5 {
        let held = farm.leases.iter().find(|(_, held)| held.task == deadly.task).expect("it is leased again").1.clone();
        assert_eq!(farm.status(id).quarantined, [], "{life}");
        let before = 10 * (life - 1) + u64::from(life == 1);
        assert_eq!(count_deaths(&farm.join_after_death(10 * life, before, &[held])), 1);
        // A restart of the coordinator changes nothing.
        if life == 3 {
            farm.restart();
            farm.join_as(31, registration_named("w", 30));
        }
        if life == 3 {
            farm.leave(31);
            farm.join(30);
        }
    }
    let status = farm.status(id);
    let failure = Failure::Killed { deaths: 5, worker: "w".into() };
    assert_eq!(status.quarantined, [QuarantinedTask { task: deadly.task, attempts: 5, failure: failure.clone() }]);
    assert_eq!(failure.to_string(), "workers died 5 times while computing this task; the last one was w");
    while farm.state(id) == JobState::Running {
        farm.complete_first(50, Done);
    }
    assert_eq!((farm.state(id), farm.status(id).frames_done), (JobState::Failed, 1));
    farm.restart();
    assert_eq!(farm.status(id).quarantined.len(), 1);
    farm.join(60);
    farm.control(id, Control::Retry);
    farm.complete_first(60, Done);
    farm.complete_first(60, Done);
    assert_eq!(farm.state(id), JobState::Done);
}

#[test]
fn death_counts_once_and_not_for_done_or_foreign_tasks() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    let (first, second) = (farm.leases[0].1.clone(), farm.leases[1].1.clone());
    farm.complete(1, &first, Done);
    assert_eq!(
        count_deaths(&farm.join_after_death(2, 1, &[first, second.clone()])),
        1,
        "the one that is done is innocent"
    );
    for life in 3..20 {
        farm.leave(life - 1);
        farm.join_after_death(life, 1, std::slice::from_ref(&second));
    }
    assert_eq!(farm.status(id).quarantined, []);
    let other = HeldLease { job: Digest::compute(b"another"), ..farm.held_lease(&second) };
    let death = Death { instance: 3, computing: vec![HeldLease { epoch: Epoch(7), ..other }] };
    assert_eq!(count_deaths(&farm.join_as(30, Registration { death: Some(death), ..registration_named("w", 30) })), 0);
}

#[test]
fn only_presumed_deaths_of_several_workers_quarantine_a_task() {
    for (names, is_quarantined) in [(["a", "b", "c", "a", "b"], true), (["a"; 5], false)] {
        let mut farm = TestFarm::new();
        let id = farm.submit(job(&[1], 1, &[4]));
        for (life, name) in names.into_iter().enumerate() {
            let worker = life as u64 + 1;
            farm.join_as(worker, registration_named(name, worker));
            assert_eq!(farm.tasks_of(worker).len(), 1);
            farm.wait(100);
            farm.leave(worker);
            pass_time(&mut farm, 20_000);
        }
        assert_eq!(farm.status(id).quarantined.len(), usize::from(is_quarantined), "{names:?}");
        farm.restart();
        assert_eq!(farm.status(id).quarantined.len(), usize::from(is_quarantined), "{names:?}");
    }
}

#[test]
fn lost_links_drains_and_tasks_that_wait_do_not_count_as_deaths() {
    let mut farm = TestFarm::with_config(Config { prefetch: 1, ..config() });
    let id = farm.submit(job(&[1], 2, &[4]));
    for round in 0..20 {
        // Two processes come back repeatedly: immediately, or after they were presumed dead.
        let (worker, process) = (round + 1, round % 2);
        farm.join_as(worker, registration_named(&format!("w{process}"), process));
        farm.wait(100);
        farm.leave(worker);
        pass_time(&mut farm, if round % 3 == 0 { 40_000 } else { 0 });
    }
    assert_eq!(farm.status(id).quarantined, []);
    pass_time(&mut farm, 40_000);
    for round in 100..120 {
        farm.join_as(round, registration_named(&format!("w{round}"), round));
        farm.handle(Event::Drained { worker: WorkerId(round), drain: Drain::Begin });
        farm.wait(100);
        farm.leave(round);
        assert_eq!(count_deaths(&pass_time(&mut farm, 20_000)), 0, "drained");
    }
    // The death does not count for the second task, which was waiting.
    farm.join_as(200, registration_named("x", 200));
    let waiting = farm.leases[1].1.task;
    farm.leave(200);
    pass_time(&mut farm, 20_000);
    let died = farm.log.iter().filter_map(|(_, fact)| match fact {
        Fact::WorkerDied { task, death: casualty, .. } if casualty.worker == "x" => Some(*task),
        _ => None,
    });
    let died: Vec<TaskKey> = died.collect();
    assert!(died.len() == 1 && died[0] != waiting, "{died:?}");
}

#[test]
fn worker_killed_by_a_task_does_not_get_it_if_another_is_free() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    farm.handle(Event::Joined { worker: WorkerId(2), registration: registration_named("other", 2) });
    farm.handle(Event::Draining { worker: WorkerId(2) });
    farm.join_after_death(3, 1, &[held]);
    assert_eq!(farm.tasks_of(3).len(), 1, "alone, it may try again");
    let held = farm.first_lease_of(3);
    farm.handle(Event::Available { worker: WorkerId(2) });
    farm.join_after_death(4, 3, &[held]);
    assert_eq!((farm.tasks_of(4).len(), farm.tasks_of(2).len()), (0, 1));
}

#[test]
fn death_counts_for_all_parts_of_its_lease_and_isolates_them() {
    let grain = std::num::NonZeroU64::new(64).unwrap();
    let mut farm = TestFarm::with_config(Config {
        chunk_size: grain,
        prefetch: 0,
        work_per_lease: 60_000,
        min_work_per_lease: 60_000,
        ..config()
    });
    let id = farm.submit(job(&[1], 1, &[8]));
    farm.join(1);
    farm.now = farm.now.after(10);
    farm.complete_first(1, Done);
    let held = farm.first_lease_of(1);
    assert_eq!(held.spec.steps, 1..8, "all that is left");
    farm.join_after_death(2, 1, std::slice::from_ref(&held));
    // The third sample kills workers.
    let mut deaths = 1;
    while farm.state(id) == JobState::Running && deaths < 9 {
        let worker = farm.leases[0].0.0;
        let held = farm.first_lease_of(worker);
        if held.task.stage.kind != StageKind::Render {
            break;
        }
        let samples = &held.spec.steps;
        assert_eq!(samples.len(), 1);
        if samples.start == 3 {
            deaths += 1;
            farm.join_after_death(worker + 1, worker, &[held]);
        } else {
            farm.now = farm.now.after(10);
            farm.complete_first(worker, Done);
        }
    }
    let status = farm.status(id);
    assert_eq!((deaths, status.quarantined.len(), status.quarantined[0].attempts), (5, 1, 5), "{status:?}");
}

#[test]
fn death_waits_for_the_other_lease_and_is_void_if_that_finishes() {
    let mut farm = TestFarm::with_config(Config { late: 1_000, prefetch: 0, ..config() });
    let id = farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    farm.now = farm.now.after(100);
    farm.complete_first(1, Done);
    farm.handle(Event::Joined { worker: WorkerId(2), registration: registration_named("other", 2) });
    let original = farm.first_lease_of(1);
    farm.now = farm.now.after(2_000);
    (1..=2).for_each(|worker| drop(farm.heartbeat(worker, Phase::Working, 1)));
    farm.wait(0);
    let copy = farm.first_lease_of(2);
    assert_eq!((copy.task, farm.status(id).copies), (original.task, 1));
    assert_eq!(count_deaths(&farm.join_after_death(3, 1, std::slice::from_ref(&original))), 0, "another still does it");
    assert_eq!(count_deaths(&farm.complete(2, &copy, Done)), 0);
    assert_eq!(count_deaths(&pass_time(&mut farm, 30_000)), 0);
}
