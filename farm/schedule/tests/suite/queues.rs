//! Tests of a worker's queues: their depth, join tasks beside compute tasks, drains, and pauses of a failing worker.

use crate::common::{TestFarm, config, job, panic_failure, registration, result_in};
use femc_model::*;
use femc_schedule::Config;

use Decision::Done;

/// Creates a farm with the default queues.
fn farm() -> TestFarm {
    let Config { prefetch, queue, ahead, .. } = Config::default();
    TestFarm::with_config(Config { prefetch, queue, ahead, lease: 60_000, ..config() })
}

/// Completes the worker's oldest task after these milliseconds.
fn complete_first_after(farm: &mut TestFarm, worker: u64, milliseconds: u64) {
    let held = farm.first_lease_of(worker);
    farm.wait(milliseconds);
    let seconds = milliseconds as f64 / 1000.0;
    farm.complete_with(worker, &held, result_in(&held, Done, seconds));
}

#[test]
fn short_tasks_of_one_job_do_not_deepen_the_queue_for_another() {
    let mut farm = farm();
    farm.submit(job(&[1], 1000, &[4]));
    farm.join(1);
    (0..100).for_each(|_| complete_first_after(&mut farm, 1, 1));
    assert!(farm.tasks_of(1).len() > 60, "tasks of a millisecond are queued: {}", farm.tasks_of(1).len());
    // A job of higher priority is submitted. The pace of its tasks is unknown at first; then they take three seconds each.
    let slow = farm.submit(JobSpec { priority: 90, ..job(&[1], 60, &[4]) });
    let held = |farm: &TestFarm| farm.leases.iter().filter(|(_, held)| held.task.job == slow).count();
    while farm.first_lease_of(1).task.job != slow {
        complete_first_after(&mut farm, 1, 1);
    }
    assert!(held(&farm) <= 3, "{} tasks of unknown pace", held(&farm));
    for _ in 0..5 {
        complete_first_after(&mut farm, 1, 3_000);
        assert!((1..=3).contains(&held(&farm)), "{} tasks of three seconds", held(&farm));
    }
    assert_eq!(held(&farm), 2, "one runs and one waits");
}

#[test]
fn a_result_on_its_way_makes_room_for_the_task_behind_the_next() {
    let mut farm = farm();
    farm.submit(job(&[1], 60, &[4]));
    farm.join(1);
    (0..4).for_each(|_| complete_first_after(&mut farm, 1, 5_000));
    assert_eq!(farm.tasks_of(1).len(), 2);
    let first = farm.first_lease_of(1);
    let tasks = vec![TaskProgress { task: first.task, epoch: first.epoch, phase: Phase::Uploading, units: 0 }];
    farm.handle(femc_schedule::Event::Heartbeat { worker: WorkerId(1), tasks });
    assert_eq!(farm.tasks_of(1).len(), 3);
}

#[test]
fn finished_frame_merges_at_once_while_two_owners_keep_all_busy() {
    (0..=2).for_each(check_images_at_once);
}

fn check_images_at_once(prefetch: u32) {
    let mut farm = TestFarm::with_config(Config { prefetch, ..farm().scheduler.config().clone() });
    let ann = farm.submit(JobSpec { owner: "ann".into(), ..job(&[1, 2, 3, 4], 2, &[4]) });
    farm.submit(JobSpec { owner: "bob".into(), ..job(&[1, 2, 3, 4], 40, &[4]) });
    (1..=2).for_each(|worker| drop(farm.join(worker)));
    let is_image = |(_, held): &&(WorkerId, Assignment)| held.task.stage.kind == StageKind::Image;
    let mut images = 0;
    while farm.state(ann) != JobState::Done {
        // The workers compute in parallel; no join task starts before it is leased.
        farm.wait(8_000);
        for worker in 1..=2 {
            let of_worker = |(holder, held): &&(WorkerId, Assignment)| {
                holder.0 == worker && held.task.stage.kind == StageKind::Render
            };
            if let Some((_, held)) = farm.leases.iter().find(of_worker).cloned() {
                farm.complete_with(worker, &held, result_in(&held, Done, 8.0));
            }
        }
        let table = farm.scheduler.tasks(ann, TaskFilter::default(), 0, 1000, farm.now).unwrap();
        let done = |frame: u32| {
            let tiles = table.tasks.iter().filter(|it| it.task.stage.frame == frame && it.task.stage.number == 0);
            tiles.clone().count() == 2 && tiles.into_iter().all(|it| it.state == TaskState::Done)
        };
        for frame in (1..=4).filter(|&frame| done(frame)) {
            let image =
                table.tasks.iter().find(|it| it.task.stage.frame == frame && it.task.stage.number == 1).unwrap();
            assert_ne!(image.state, TaskState::Waiting, "frame {frame} waits to be put together");
        }
        while let Some((holder, held)) = farm.leases.iter().find(is_image).cloned() {
            images += 1;
            farm.complete_with(holder.0, &held, result_in(&held, Done, 0.01));
        }
    }
    assert!(images >= 4);
}

#[test]
fn lone_failing_worker_gets_few_tasks_and_shows_as_quarantined() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 600, &[8]));
    farm.join(1);
    let mut attempts = 0;
    for _ in 0..600 {
        while !farm.leases.is_empty() {
            let held = farm.first_lease_of(1);
            farm.fail(1, &held, panic_failure());
            attempts += 1;
        }
        let waits = farm.status(id).waits;
        assert!(
            waits.iter().any(|wait| matches!(wait, WaitReason::WorkersQuarantined { workers: 1, .. })),
            "{waits:?}"
        );
        farm.wait(100);
        farm.heartbeat(1, Phase::Waiting, 0);
    }
    println!("{attempts} attempts in a minute");
    assert!((5..=12).contains(&attempts), "{attempts} attempts in a minute");
    assert_eq!(farm.state(id), JobState::Running);
    // The repaired worker gets one task as a probe, and then more.
    while farm.leases.is_empty() {
        farm.wait(1_000);
        farm.heartbeat(1, Phase::Waiting, 0);
    }
    assert_eq!(farm.leases.len(), 1);
    complete_first_after(&mut farm, 1, 3_000);
    assert_eq!(farm.leases.len(), 2);
    assert_eq!(
        farm.status(id).waits.iter().filter(|it| matches!(it, WaitReason::WorkersQuarantined { .. })).count(),
        0
    );
}

#[test]
fn lost_inputs_count_among_the_failures_that_quarantine() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 600, &[8]));
    farm.join(1);
    let lost = Failure::LostInputs { digests: vec![Digest::compute(b"input")], message: "gone".into() };
    let mut quarantined = Vec::new();
    for failure in [panic_failure(), lost, panic_failure()] {
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, failure);
        let waits = farm.status(id).waits;
        quarantined.push(waits.iter().any(|wait| matches!(wait, WaitReason::WorkersQuarantined { workers: 1, .. })));
    }
    assert_eq!(quarantined, [false, false, true]);
}

#[test]
fn drained_worker_gets_nothing_and_returns_tasks_uncounted() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 9, &[4]));
    farm.join(1);
    let queued: Vec<Assignment> = farm.leases.iter().skip(1).map(|(_, held)| held.clone()).collect();
    assert_eq!(queued.len(), 2);
    farm.handle(femc_schedule::Event::Drained { worker: WorkerId(1), drain: Drain::Begin });
    assert_eq!(farm.scheduler.intake(WorkerId(1)), Intake::Drained, "which the next heartbeat's answer says");
    farm.join_as(2, Registration { instance: 2, ..registration() });
    for held in &queued {
        farm.fail(1, held, Failure::Cancelled);
    }
    assert_eq!(farm.tasks_of(1).len(), 1);
    let elsewhere = |task: TaskKey| farm.leases.iter().any(|(holder, held)| holder.0 == 2 && held.task == task);
    let table = farm.scheduler.tasks(id, TaskFilter::default(), 0, 1000, farm.now).unwrap();
    for held in &queued {
        let status = table.tasks.iter().find(|it| it.task == held.task).unwrap();
        let attempts = u32::from(elsewhere(held.task));
        assert_eq!((status.attempts, &status.failure), (attempts, &None), "{}", held.task);
    }
}
