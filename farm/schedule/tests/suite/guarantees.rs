//! Tests of the scheduler's guarantees, one statement per test.

use crate::common;
use crate::common::{TestFarm, find_answer, job, panic_failure, registration, result_of};
use femc_model::*;
use femc_schedule::*;

use Decision::{Continue, Done};
use StageKind::{Image, Render};

fn is_refused(commands: &[Command]) -> bool {
    commands.iter().any(|command| matches!(command, Command::Refuse { .. }))
}

fn is_accepted(commands: &[Command]) -> bool {
    commands.iter().any(|command| matches!(command, Command::Accept { .. }))
}

fn lost_inputs(artifacts: &[Artifact]) -> Failure {
    let digests = artifacts.iter().map(|artifact| artifact.digest).collect();
    Failure::LostInputs { digests, message: "gone".into() }
}

fn is_recorded(commands: &[Command]) -> bool {
    commands.iter().any(|command| matches!(command, Command::Record(_)))
}

#[test]
fn silent_worker_loses_lease_and_its_late_result_is_refused() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    let late = farm.first_lease_of(1);
    farm.wait(4_999);
    assert_eq!(farm.tasks_of(1).len(), 1);
    farm.wait(1);
    assert_eq!(farm.tasks_of(1), [], "revoked, and not given back to the silent one");
    farm.join(2);
    assert_eq!(farm.tasks_of(2), [(1, 0, Render, 0)]);
    assert!(farm.first_lease_of(2).epoch > late.epoch);
    let answer = farm.complete(1, &late, Done);
    assert!(is_refused(&answer) && !is_recorded(&answer) && !is_accepted(&answer));
    assert_eq!(farm.status(id).stale_messages, 1);
}

#[test]
fn heartbeats_with_progress_keep_lease_and_stall_loses_it() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    for step in 1..=100 {
        farm.wait(4_000);
        farm.heartbeat(1, Phase::Working, step);
    }
    assert_eq!(farm.tasks_of(1).len(), 1);
    let stall = |farm: &mut TestFarm| {
        (1..100).find(|_| {
            farm.heartbeat(1, Phase::Working, 100);
            farm.wait(4_000).iter().any(|command| matches!(command, Command::Record(Fact::Failed { .. })))
        })
    };
    assert_eq!(stall(&mut farm), Some(31), "after the stall limit of 120 s and what was left of the lease");
    assert_eq!(stall(&mut farm), Some(31));
    assert_eq!(stall(&mut farm), Some(31));
    assert_eq!(farm.state(id), JobState::Failed, "a task that stands still everywhere ends like one that panics");
}

#[test]
fn inputs_of_long_merge_keep_its_lease_and_count_no_samples() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    farm.complete_first(1, Done);
    for inputs in 1..=100 {
        farm.wait(4_000);
        farm.heartbeat(1, Phase::Working, inputs);
    }
    assert_eq!(farm.tasks_of(1), [(1, 0, Image, 0)]);
    assert_eq!((farm.status(id).samples_done, farm.status(id).active[0].samples_done), (4 * 64, 4 * 64));
}

#[test]
fn a_worker_that_leaves_frees_its_tasks_at_once() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    assert_eq!(farm.tasks_of(1).len(), 2, "one that runs and one ahead");
    farm.join(2);
    assert_eq!(farm.tasks_of(2), []);
    farm.leave(1);
    assert_eq!(farm.tasks_of(2), [(1, 0, Render, 0), (1, 0, Render, 1)]);
}

#[test]
fn nobody_fetches_ahead_what_another_could_begin() {
    let mut farm = TestFarm::new();
    farm.join(1);
    farm.join(2);
    farm.submit(job(&[1], 3, &[4]));
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 0), (1, 0, Render, 2)]);
    assert_eq!(farm.tasks_of(2), [(1, 0, Render, 1)]);
}

#[test]
fn frame_merges_after_last_tile_while_next_frame_renders() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2], 2, &[4]));
    farm.join(1);
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 1), (2, 0, Render, 0)]);
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1), [(2, 0, Render, 0), (1, 0, Image, 0)]);
    let merge = farm.leases[1].1.clone();
    assert_eq!(
        (merge.spec.next_round, merge.spec.inputs_of_role(Role::Tile).count(), merge.spec.inputs.len()),
        (NextRound::Impossible, 2, 2)
    );
    farm.complete(1, &merge, Done);
    assert_eq!(farm.status(id).frames_done, 1);
    while farm.state(id) == JobState::Running {
        farm.complete_first(1, Done);
    }
    assert_eq!(farm.state(id), JobState::Done);
    let frames: Vec<u32> = farm.scheduler.frames(id).unwrap().iter().map(|frame| frame.frame).collect();
    assert_eq!(frames, [1, 2]);
}

#[test]
fn merge_that_continues_opens_next_round_before_later_frames() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2, 3], 1, &[4, 8, 16]));
    farm.join_as(1, Registration { slots: 1, ..registration() });
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1), [(2, 0, Render, 0), (1, 0, Image, 0)]);
    let merge = farm.leases[1].1.clone();
    let commands = farm.complete(1, &merge, Continue);
    assert!(commands.iter().any(|c| matches!(c, Command::Discard(digests) if digests.len() == 1)), "the merged tile");
    assert_eq!(farm.tasks_of(1), [(2, 0, Render, 0), (1, 1, Render, 0)]);
    assert_eq!(farm.leases[1].1.spec.steps, 4..8);
    let tile = farm.leases[1].1.clone();
    farm.complete(1, &tile, Done);
    let merge = farm.leases[1].1.clone();
    assert_eq!(merge.spec.next_round, NextRound::Possible);
    assert_eq!(merge.spec.inputs.len(), 2, "the sums of the round before and the tile");
    farm.complete(1, &merge, Done);
    assert_eq!(farm.scheduler.frames(id).unwrap()[0].spp, 8);
}

#[test]
fn a_repeated_completion_gets_the_recorded_answer() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    assert!(is_recorded(&farm.complete(1, &held, Done)));
    let again = farm.complete(1, &held, Done);
    assert!(is_accepted(&again) && !is_recorded(&again) && !is_refused(&again));
}

#[test]
fn task_failing_three_times_is_quarantined_and_retried_alone() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2], 2, &[4]));
    farm.join(1);
    for _ in 0..3 {
        let bad =
            farm.leases.iter().find(|(_, held)| held.task.stage.frame == 1 && held.task.index == 0).unwrap().1.clone();
        farm.fail(1, &bad, panic_failure());
    }
    while farm.state(id) == JobState::Running {
        farm.complete_first(1, Done);
    }
    let status = farm.status(id);
    assert_eq!((status.state, status.frames_done, status.frames_failed), (JobState::Failed, 1, 1));
    assert_eq!(status.quarantined[0].attempts, 3);
    assert_eq!(status.waits, [WaitReason::Quarantined { frame: 1, tasks: 1 }]);
    farm.control(id, Control::Retry);
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 0)], "the other tile is kept");
    farm.complete_first(1, Done);
    farm.complete_first(1, Done);
    assert_eq!(farm.state(id), JobState::Done);
}

#[test]
fn a_failed_task_goes_to_another_worker_if_there_is_one() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    farm.join(2);
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, panic_failure());
    assert_eq!((farm.tasks_of(1).len(), farm.tasks_of(2).len()), (0, 1));
    farm.leave(2);
    assert_eq!(farm.tasks_of(1).len(), 1, "alone, it may try again");
}

#[test]
fn result_without_artifact_is_refused_and_task_is_done_again() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    let (worker, task, epoch) = (WorkerId(1), held.task, held.epoch);
    let artifact = Digest::compute(b"gone");
    let commands =
        farm.handle(Event::ArtifactMissing { worker, task, epoch, artifact, message: "it did not arrive".into() });
    let answers: Vec<_> =
        commands.iter().filter(|said| matches!(said, Command::Accept { .. } | Command::Refuse { .. })).collect();
    let refusal = Refusal::NoSuchArtifact { digest: artifact };
    assert_eq!(answers, [&Command::Refuse { worker, task, epoch, refusal }]);
    farm.drop_lease(task, epoch);
    // As after any failure of the store, the worker rests for a second.
    farm.now = farm.now.after(999);
    farm.heartbeat(1, Phase::Waiting, 0);
    farm.wait(1);
    assert_eq!(farm.first_lease_of(1).task, task);
    assert_eq!(farm.status(id).quarantined, []);
}

#[test]
fn a_full_disk_uses_up_no_attempt_and_gives_the_worker_a_rest() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    for pause in [1_000, 2_000, 4_000, 8_000] {
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, Failure::Store { message: "disk full".into() });
        assert_eq!(farm.tasks_of(1), []);
        let mishap = WaitReason::InfrastructureFailures { tasks: 1, message: "store: disk full".into() };
        let failure = Failure::Store { message: "disk full".into() };
        let trouble = WaitReason::WorkersBackingOff { workers: 1, seconds: pause / 1000, failure };
        assert_eq!(farm.status(id).waits, [mishap, WaitReason::AllWorkersBackingOff, trouble]);
        farm.now = farm.now.after(pause - 1);
        farm.heartbeat(1, Phase::Waiting, 0);
        assert_eq!(farm.tasks_of(1), []);
        farm.wait(1);
        assert_eq!(farm.tasks_of(1).len(), 1);
    }
    assert_eq!(farm.status(id).quarantined, []);
}

#[test]
fn silent_worker_is_reported_as_silent_not_as_resting() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 6, &[4]));
    farm.join(1);
    farm.wait(5_000);
    assert_eq!(farm.status(id).waits, [WaitReason::WorkersSilent { workers: 1, seconds: 5 }]);
    // Another working worker changes nothing for the first one.
    farm.join(2);
    let silent = WaitReason::WorkersSilent { workers: 1, seconds: 5 };
    assert_eq!(farm.status(id).waits, [WaitReason::WorkersBusy { workers: 1 }, silent]);
    farm.heartbeat(1, Phase::Waiting, 0);
    assert!(!farm.status(id).waits.iter().any(|wait| matches!(wait, WaitReason::WorkersSilent { .. })));
}

#[test]
fn unreadable_scene_fails_job_at_once_and_revokes_leases() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2], 4, &[4]));
    farm.join(1);
    farm.join(2);
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, Failure::Scene { message: "no camera".into() });
    assert_eq!(farm.leases.len(), 0);
    let status = farm.status(id);
    assert_eq!(status.state, JobState::Failed);
    assert_eq!(status.failure, Some(Failure::Scene { message: "no camera".into() }));
}

#[test]
fn a_merge_that_misses_tiles_has_just_those_rendered_again() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 3, &[4]));
    farm.join(1);
    (0..3).for_each(|_| drop(farm.complete_first(1, Done)));
    let merge = farm.first_lease_of(1);
    let tiles: Vec<Artifact> = merge.spec.artifacts().collect();
    farm.fail(1, &merge, lost_inputs(&[tiles[1], tiles[2]]));
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 1), (1, 0, Render, 2)]);
    (0..3).for_each(|_| drop(farm.complete_first(1, Done)));
    assert_eq!(farm.state(id), JobState::Done);
}

#[test]
fn a_store_that_loses_every_tile_ends_the_job() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 2, &[4, 8]));
    farm.join(1);
    let mut steps = 0;
    while farm.state(id) == JobState::Running {
        let held = farm.first_lease_of(1);
        match held.spec.artifacts().next() {
            None => farm.complete(1, &held, Continue),
            Some(tile) => farm.fail(1, &held, lost_inputs(&[tile])),
        };
        steps += 1;
        assert!(steps < 20);
    }
    assert_eq!(farm.state(id), JobState::Failed);
}

#[test]
fn cancel_recalls_and_pause_lets_finish() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 9, &[4]));
    farm.join(1);
    farm.control(id, Control::Pause);
    farm.complete_first(1, Done);
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1), []);
    assert_eq!((farm.state(id), farm.status(id).waits), (JobState::Paused, vec![WaitReason::Paused]));
    farm.control(id, Control::Resume);
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 2), (1, 0, Render, 3)]);
    farm.control(id, Control::Cancel);
    assert_eq!((farm.leases.len(), farm.state(id)), (0, JobState::Cancelled));
    assert!(find_answer(&farm.control(id, Control::Resume)).is_none(), "it has ended");
    farm.control(id, Control::Retry);
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 2), (1, 0, Render, 3)], "what was finished stays");
}

#[test]
fn the_job_with_more_priority_goes_first_and_says_so() {
    let mut farm = TestFarm::new();
    let slow = farm.submit(job(&[1], 9, &[4]));
    let fast = farm.submit(JobSpec { priority: 60, ..job(&[7], 9, &[4]) });
    farm.join(1);
    assert_eq!(farm.tasks_of(1), [(7, 0, Render, 0), (7, 0, Render, 1)]);
    assert_eq!(farm.status(slow).waits, [WaitReason::BehindJob(fast)]);
    assert_eq!(farm.status(fast).waits, [WaitReason::WorkersBusy { workers: 1 }]);
    farm.control(slow, Control::Priority(70));
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1)[1], (1, 0, Render, 0));
}

#[test]
fn worker_with_three_failed_tasks_is_quarantined_until_success() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 400, &[8]));
    farm.join(1);
    farm.join(2);
    for _ in 0..3 {
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, panic_failure());
    }
    // It still holds one more task; when that fails too, nothing changes.
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, panic_failure());
    assert!(farm.tasks_of(1).is_empty());
    assert!(farm.status(id).waits.contains(&WaitReason::WorkersQuarantined { workers: 1, seconds: 60 }));
    farm.complete_first(2, Done);
    assert!(farm.tasks_of(1).is_empty() && farm.tasks_of(2).len() == 2);

    // A minute later it gets one task, not two.
    (0..61).for_each(|_| {
        farm.wait(1000);
        farm.heartbeat(1, Phase::Waiting, 0);
        farm.heartbeat(2, Phase::Working, farm.now.0);
    });
    assert_eq!(farm.tasks_of(1).len(), 1, "{:?}", farm.status(id).waits);
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, panic_failure());
    assert!(farm.tasks_of(1).is_empty());
    assert!(
        farm.status(id).waits.contains(&WaitReason::WorkersQuarantined { workers: 1, seconds: 120 }),
        "twice as long"
    );

    // Without another worker it gets tasks after a pause of seconds, one at a time.
    farm.leave(2);
    assert_eq!(farm.tasks_of(1), []);
    farm.wait(2_000);
    assert_eq!(farm.tasks_of(1).len(), 1);
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1).len(), 2, "a success forgives");
    farm.join(3);
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1).len(), 2);
}

#[test]
fn worker_keeps_tasks_and_results_over_coordinator_restart() {
    let mut farm = TestFarm::with_config(Config { regroup: 500, ..common::config() });
    let id = farm.submit(job(&[1], 6, &[8]));
    farm.join(1);
    farm.join(2);
    let own = |farm: &TestFarm, worker: u64| -> Vec<Assignment> {
        farm.leases.iter().filter(|(holder, _)| holder.0 == worker).map(|(_, held)| held.clone()).collect()
    };
    let (first, second) = (own(&farm, 1), own(&farm, 2));
    farm.restart();
    // The first worker is back before the second, and gets no task of the second.
    farm.rejoin(11, &first);
    assert_eq!(own(&farm, 11), first);
    assert_eq!(farm.status(id).waits, [WaitReason::Regrouping { milliseconds: 500 }]);
    farm.wait(200);
    farm.rejoin(12, &second);
    farm.wait(400);
    assert_eq!((own(&farm, 11), own(&farm, 12)), (first.clone(), second));
    assert!(is_recorded(&farm.complete(11, &first[0], Done)), "done once, under the lease of before");
    assert_eq!(farm.status(id).stale_messages, 0);
}

#[test]
fn stalled_coordinator_reads_heartbeats_before_leases_expire() {
    let mut farm = TestFarm::with_config(Config { regroup: 500, ..common::config() });
    farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    farm.join(2);
    let held = farm.first_lease_of(1);
    farm.now = farm.now.after(60_000);
    farm.handle(Event::CoordinatorStalled);
    let revoked = |commands: Vec<Command>| commands.iter().any(|command| matches!(command, Command::Revoke { .. }));
    assert!(!revoked(farm.wait(100)), "its lease is long over, and stays");
    farm.heartbeat(1, Phase::Working, 9);
    farm.wait(400);
    assert_eq!((farm.first_lease_of(1).epoch, farm.tasks_of(2).len()), (held.epoch, 0));
    // Leases expire even if the coordinator stalls all the time.
    for _ in 0..100 {
        farm.handle(Event::CoordinatorStalled);
        farm.heartbeat(2, Phase::Waiting, 0);
        farm.wait(100);
    }
    assert_eq!((farm.tasks_of(1).len(), farm.tasks_of(2).len()), (0, 1));
}

#[test]
fn registered_lease_held_elsewhere_or_of_other_job_is_revoked() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 2, &[8]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    farm.leave(1);
    farm.join(2);
    let commands = farm.rejoin(3, std::slice::from_ref(&held));
    assert!(commands.iter().any(|c| matches!(c, Command::Revoke { task, .. } if *task == held.task)), "{commands:?}");
    assert!(is_refused(&farm.complete(3, &held, Done)), "the other worker's lease counts");

    // A job of another farm with the same number; only its key differs.
    for (spec, is_taken_back) in [(job(&[1], 3, &[8]), false), (job(&[1], 2, &[8]), true)] {
        let mut farm = TestFarm::new();
        assert_eq!(farm.submit(job(&[1], 3, &[8])), id);
        let reported = HeldLease { job: spec.key(), ..HeldLease { steps: 0..8, ..farm.held_lease(&held) } };
        let commands = farm.join_as(1, Registration { held: vec![reported], ..registration() });
        assert_eq!(commands.iter().any(|c| matches!(c, Command::Revoke { .. })), is_taken_back, "{commands:?}");
    }
}

#[test]
fn restarted_worker_takes_lease_from_its_unended_session() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[8]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    // Another process: only the lease shows that it is the same worker.
    let commands = farm.rejoin(2, std::slice::from_ref(&held));
    assert!(!commands.iter().any(|c| matches!(c, Command::Revoke { .. })), "{commands:?}");
    assert!(is_refused(&farm.complete(1, &held, Done)), "the old session has lost the lease");
    assert!(is_recorded(&farm.complete(2, &held, Done)), "the new session holds the lease");
    assert_eq!(farm.status(id).stale_messages, 1);
    // A later process with the same lease changes nothing.
    let commands = farm.rejoin(3, std::slice::from_ref(&held));
    assert!(commands.iter().any(|c| matches!(c, Command::Revoke { .. })), "{commands:?}");
}

#[test]
fn counted_failure_is_not_counted_again_for_rejoining_worker() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[8]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, panic_failure());
    // The coordinator dies before it acknowledges the failure.
    farm.restart();
    let commands = farm.rejoin(2, std::slice::from_ref(&held));
    let is_over = |c: &Command| matches!(c, Command::Revoke { epoch, .. } if *epoch == held.epoch);
    assert!(commands.iter().any(is_over), "{commands:?}");
    assert!(is_refused(&farm.fail(2, &held, panic_failure())));
    // A lease that was granted later is adopted.
    let later = farm.first_lease_of(2);
    assert!(later.epoch > held.epoch);
    farm.restart();
    let commands = farm.rejoin(3, std::slice::from_ref(&later));
    assert!(!commands.iter().any(|c| matches!(c, Command::Revoke { .. })), "{commands:?}");
    assert!(is_recorded(&farm.complete(3, &later, Done)));
    assert_eq!(farm.status(id).stale_messages, 0, "of this life");
}

#[test]
fn drained_worker_finishes_tasks_and_gets_none_until_undrained() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2], 2, &[8]));
    farm.join(1);
    assert_eq!(farm.tasks_of(1).len(), 2);
    let named = |farm: &TestFarm, name: &str| farm.scheduler.select_workers(&WorkerSelector::Name(name.into()));
    assert_eq!((named(&farm, "w"), named(&farm, "x")), (vec![WorkerId(1)], vec![]));
    assert_eq!(farm.scheduler.select_workers(&WorkerSelector::Number(WorkerId(1))), [WorkerId(1)]);
    farm.handle(Event::Drained { worker: WorkerId(1), drain: Drain::Begin });
    assert!(is_recorded(&farm.complete_first(1, Done)) && is_recorded(&farm.complete_first(1, Done)));
    assert_eq!(farm.tasks_of(1), []);
    assert!(farm.status(id).waits.contains(&WaitReason::WorkersDraining { workers: 1 }), "{:?}", farm.status(id).waits);
    // The worker's own wish does not end the drain, nor does a new session or a new coordinator.
    farm.handle(Event::Available { worker: WorkerId(1) });
    assert_eq!(farm.tasks_of(1), []);
    farm.restart();
    farm.join_as(2, Registration { instance: 1, ..registration() });
    assert_eq!(farm.tasks_of(2), []);
    assert_eq!(farm.scheduler.workers(farm.now)[0].intake, Intake::Drained);
    farm.handle(Event::Drained { worker: WorkerId(2), drain: Drain::Undo });
    assert_eq!(farm.tasks_of(2).len(), 2);
    // The worker itself may stop accepting tasks, too.
    farm.handle(Event::Draining { worker: WorkerId(2) });
    assert!(is_recorded(&farm.complete_first(2, Done)) && is_recorded(&farm.complete_first(2, Done)));
    assert_eq!((farm.tasks_of(2), farm.scheduler.workers(farm.now)[0].intake), (vec![], Intake::Off));
    farm.handle(Event::Available { worker: WorkerId(2) });
    assert!(!farm.tasks_of(2).is_empty());
}

#[test]
fn failure_logs_are_kept_with_job_and_tile_logs_for_a_while() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 2, &[8]));
    farm.join(1);
    let (first, second) = (farm.leases[0].1.clone(), farm.leases[1].1.clone());
    let logged = |held: &Assignment, attempt, text: LogText| Event::Logged {
        worker: WorkerId(1),
        task: held.task,
        epoch: held.epoch,
        log: TaskLog { outcome: attempt, seconds: 1.0, text },
    };
    let stored = |index: usize| LogText::Stored(Artifact::from_bytes(&index.to_le_bytes()));
    farm.handle(logged(&first, AttemptOutcome::Failed, stored(0)));
    farm.fail(1, &first, Failure::Panicked { message: "oh".into() });
    farm.now = farm.now.after(10);
    farm.handle(logged(&second, AttemptOutcome::Done, LogText::Inline("tile".into())));
    assert!(farm.handle(logged(&first, AttemptOutcome::Failed, stored(1))).is_empty(), "that lease is over");
    let logs = |farm: &TestFarm, since| {
        let logs = farm.scheduler.logs(id, Tick(since)).unwrap();
        logs.into_iter().map(|record| (record.task.index, record.worker, record.log.outcome)).collect::<Vec<_>>()
    };
    let both = [(0, "w".to_owned(), AttemptOutcome::Failed), (1, "w".to_owned(), AttemptOutcome::Done)];
    assert_eq!((logs(&farm, 0), logs(&farm, 10)), (both.to_vec(), both[1..].to_vec()));
    assert_eq!(farm.scheduler.unreferenced(vec![Artifact::from_bytes(&0usize.to_le_bytes()).digest]), []);
    // A worker that logs without end: the oldest log is removed, the failure's log stays.
    let mut discarded = 0;
    for index in 2..600 {
        let commands = farm.handle(logged(&second, AttemptOutcome::Done, stored(index)));
        discarded += commands.iter().filter(|c| matches!(c, Command::Discard(_))).count();
    }
    assert_eq!((discarded, farm.scheduler.logs(id, Tick(0)).unwrap().len()), (600 - 2 + 1 - 512, 513));
    farm.restart();
    assert_eq!(logs(&farm, 0)[0], both[0]);
    assert_eq!(farm.scheduler.logs(JobId(9), Tick(0)), Err(Refusal::NoSuchJob { job: JobId(9) }));
}

#[test]
fn of_very_many_failures_the_first_logs_and_the_latest_are_kept() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 2, &[8]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    let log = |farm: &mut TestFarm, number: u32, attempt, text| {
        let log = TaskLog { outcome: attempt, seconds: f64::from(number), text };
        farm.handle(Event::Logged { worker: WorkerId(1), task: held.task, epoch: held.epoch, log });
    };
    for number in 0..2_000_u32 {
        let text = LogText::Stored(Artifact::from_bytes(&number.to_le_bytes()));
        log(&mut farm, number, AttemptOutcome::Failed, text);
    }
    // Logs of tiles do not displace them in an answer, either.
    (0..3_000).for_each(|number| log(&mut farm, number, AttemptOutcome::Done, LogText::Inline("tile".into())));
    let logs = farm.scheduler.logs(id, Tick(0)).unwrap();
    let failures = logs.iter().filter(|record| record.log.outcome == AttemptOutcome::Failed);
    let kept: Vec<u32> = failures.map(|record| record.log.seconds as u32).collect();
    assert_eq!(kept, (0..64).chain(2_000 - 448..2_000).collect::<Vec<u32>>());
    assert_eq!(logs.len(), 2_048);
}

#[test]
fn latest_tile_logs_are_kept_within_count_and_byte_limits() {
    for (length, name, kept) in [(100, "w".repeat(60), 2_048), (64 << 10, "w".into(), 60)] {
        let mut farm = TestFarm::new();
        let id = farm.submit(job(&[1], 1, &[8]));
        farm.join_as(1, Registration { name, ..registration() });
        let held = farm.first_lease_of(1);
        for number in 0..3_000 {
            let text = LogText::Inline("x".repeat(length));
            let log = TaskLog { outcome: AttemptOutcome::Done, seconds: f64::from(number), text };
            farm.handle(Event::Logged { worker: WorkerId(1), task: held.task, epoch: held.epoch, log });
        }
        let logs = farm.scheduler.logs(id, Tick(0)).unwrap();
        assert!((kept..kept + 5).contains(&logs.len()), "{} of {length} bytes", logs.len());
        let latest = (0..logs.len()).map(|place| (3_000 - logs.len() + place) as f64);
        assert!(logs.iter().map(|record| record.log.seconds).eq(latest));
    }
}

#[test]
fn several_heartbeats_fit_into_a_lease_of_any_length() {
    for lease in [100, 4_500, 60_000, 3_600_000] {
        let Config { lease: found, heartbeat, .. } = Config::with_lease(lease);
        assert!(found == lease && (1..=lease / 5).contains(&heartbeat), "{lease}: {found}, {heartbeat}");
    }
}

#[test]
fn failed_task_does_not_wait_for_quarantined_worker() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..common::config() });
    let id = farm.submit(job(&[1], 4, &[8]));
    (1..=2).for_each(|worker| drop(farm.join(worker)));
    for _ in 0..3 {
        let held = farm.first_lease_of(2);
        farm.fail(2, &held, panic_failure());
    }
    assert_eq!(farm.tasks_of(2), [], "three tasks have failed here");
    farm.complete_first(1, Done);
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, panic_failure());
    for _ in 0..4 {
        farm.complete_first(1, Done);
    }
    assert_eq!(farm.state(id), JobState::Done, "{:?}", farm.status(id).waits);
}

#[test]
fn worker_on_probation_gets_new_task_after_blameless_loss() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..common::config() });
    farm.submit(job(&[1], 12, &[8]));
    farm.join(1);
    // Worker 2 is trusted and has enough tasks.
    farm.join(2);
    for _ in 0..3 {
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, panic_failure());
    }
    assert_eq!(farm.tasks_of(1), [], "three tasks have failed here");
    farm.wait(farm.scheduler.config().quarantine);
    (1..=2).for_each(|worker| drop(farm.heartbeat(worker, Phase::Working, 1)));
    assert_eq!(farm.tasks_of(1).len(), 1, "to prove itself");
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, Failure::Cancelled);
    assert_eq!(farm.tasks_of(1).len(), 1, "still to prove itself");
}

#[test]
fn a_job_goes_only_to_workers_with_its_tags() {
    let mut farm = TestFarm::new();
    let id = farm.submit(JobSpec { tags: vec!["lab".into()], ..job(&[1], 1, &[4]) });
    assert_eq!(farm.status(id).waits, [WaitReason::NoWorkers]);
    farm.join(1);
    assert_eq!(farm.tasks_of(1), []);
    assert_eq!(farm.status(id).waits, [WaitReason::NoWorkerWithTags(vec!["lab".into()])]);
    let other = farm.submit(job(&[5], 1, &[4]));
    assert_eq!(farm.tasks_of(1), [(5, 0, Render, 0)], "a job that it may not take is passed over");
    farm.join_as(2, Registration { instance: 2, tags: vec!["lab".into()], ..registration() });
    assert_eq!(farm.tasks_of(2), [(1, 0, Render, 0)]);
    assert_ne!(id, other);
}

#[test]
fn a_second_submission_with_the_same_key_is_the_same_job() {
    let mut farm = TestFarm::new();
    let submit = |farm: &mut TestFarm, key: &str| {
        let spec = Box::new(job(&[1], 1, &[4]));
        find_answer(&farm.handle(Event::Submitted { request: RequestId(9), key: Some(key.into()), spec, date: None }))
    };
    let first = submit(&mut farm, "a");
    assert_eq!(submit(&mut farm, "a"), first);
    farm.restart();
    assert_eq!(submit(&mut farm, "a"), first);
    assert_ne!(submit(&mut farm, "b"), first);
}

#[test]
fn a_restart_keeps_what_is_done_and_voids_every_lease() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 4, &[4]));
    farm.join(1);
    farm.complete_first(1, Done);
    let before = farm.first_lease_of(1);
    farm.restart();
    farm.join(1);
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 1), (1, 0, Render, 2)], "the leased ones, not the finished one");
    assert!(farm.first_lease_of(1).epoch > before.epoch);
    let answer = farm.complete(1, &before, Done);
    assert!(is_refused(&answer) && !is_recorded(&answer));
    assert_eq!(farm.status(id).active[0].tiles_done, 1);
}

#[test]
fn a_worker_that_comes_again_replaces_its_first_session() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 1, &[4]));
    farm.join_as(1, Registration { instance: 7, ..registration() });
    farm.leases.clear();
    let commands = farm.join_as(2, Registration { instance: 7, ..registration() });
    assert!(commands.contains(&Command::Dismiss { worker: WorkerId(1) }));
    assert_eq!(farm.tasks_of(2), [(1, 0, Render, 0)]);
}

#[test]
fn a_leaving_worker_gets_nothing_new_and_finishes_what_it_holds() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 9, &[4]));
    farm.join(1);
    farm.handle(Event::Draining { worker: WorkerId(1) });
    assert!(is_accepted(&farm.complete_first(1, Done)));
    assert_eq!(farm.tasks_of(1).len(), 1);
}

#[test]
fn a_result_of_the_wrong_kind_is_a_failure_of_the_task() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    let merge = TaskKey { stage: Stage { kind: Image, ..held.task.stage }, ..held.task };
    let result = result_of(&Assignment { task: merge, ..held.clone() }, Done);
    let event = Event::Completed { worker: WorkerId(1), task: held.task, epoch: held.epoch, result };
    let commands = farm.handle(event);
    assert!(commands.iter().any(|command| matches!(command, Command::Record(Fact::Failed { .. }))));
}

#[test]
fn samples_are_counted_in_results_and_in_running_tasks() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    farm.complete_first(1, Done);
    farm.heartbeat(1, Phase::Working, 100);
    let status = farm.status(id);
    assert_eq!((status.samples_done, status.samples_planned, status.bad_samples), (4 * 64 + 100, 8 * 64, 1));
    farm.wait(1_000);
    farm.heartbeat(1, Phase::Working, 150);
    farm.wait(1_000);
    assert_eq!(farm.status(id).samples_per_second, 50.0);
}

#[test]
fn a_job_of_a_million_tasks_is_one_fact_and_no_rows() {
    let mut farm = TestFarm::new();
    let frames: Vec<u32> = (1..=1_000).collect();
    farm.submit(job(&frames, 1_000, &[4]));
    let bytes = farm.scheduler.ledger().encode().unwrap();
    assert!(bytes.len() < 3_000, "{} bytes: the frame numbers and no task", bytes.len());
    farm.join(1);
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 0), (1, 0, Render, 1)]);
}

#[test]
fn damaged_snapshot_or_one_of_another_version_is_refused() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 4, &[4]));
    let mut bytes = farm.scheduler.ledger().encode().unwrap();
    assert_eq!(Ledger::decode(&bytes).as_ref(), Ok(farm.scheduler.ledger()));
    bytes.truncate(bytes.len() - 1);
    assert!(matches!(Ledger::decode(&bytes), Err(SnapshotError::Damaged(_))));
    for found in [Ledger::OLDEST_VERSION - 1, Ledger::VERSION + 1] {
        bytes[0] = found;
        assert_eq!(Ledger::decode(&bytes), Err(SnapshotError::Version { found }));
    }
    assert_eq!(Ledger::decode(&[]), Err(SnapshotError::Empty));
}

#[test]
fn a_worker_with_short_tasks_holds_more_of_them() {
    let mut farm = TestFarm::with_config(Config { ahead: 200, lease: 60_000, ..common::config() });
    farm.submit(job(&[1], 1000, &[4]));
    farm.join(1);
    assert_eq!(farm.tasks_of(1).len(), 2, "nothing is known of the tasks yet");
    let mut done = |count, milliseconds: u64| {
        for _ in 0..count {
            farm.wait(milliseconds);
            let held = farm.first_lease_of(1);
            let seconds = milliseconds as f64 / 1000.0;
            farm.complete_with(1, &held, TaskResult { seconds, ..result_of(&held, Done) });
        }
        farm.tasks_of(1).len()
    };
    assert_eq!(done(1, 40), 1 + 5, "200 ms of tasks that take 40 ms wait behind the one that runs");
    assert_eq!(done(60, 1), 2 + 64, "at most so many");
    assert_eq!(done(120, 300), 2, "long ones are fetched one ahead");
}

#[test]
fn job_that_ended_long_ago_expires_and_retried_job_does_not() {
    let mut farm = TestFarm::with_config(Config { keep_ended: Some(60_000), ..common::config() });
    let submit = |farm: &mut TestFarm, key: &str| {
        let spec = Box::new(job(&[1], 1, &[4]));
        match find_answer(&farm.handle(Event::Submitted {
            request: RequestId(9),
            key: Some(key.into()),
            spec,
            date: None,
        })) {
            Some(Answer::Submitted(job)) => job,
            other => panic!("{other:?}"),
        }
    };
    let (done, retried, runs) = (submit(&mut farm, "done"), submit(&mut farm, "retried"), submit(&mut farm, "runs"));
    farm.control(runs, Control::Pause);
    farm.control(retried, Control::Cancel);
    farm.join(1);
    let tile = farm.first_lease_of(1);
    farm.complete_first(1, Done);
    farm.complete_first(1, Done);
    assert_eq!(farm.state(done), JobState::Done);
    farm.leave(1);
    farm.wait(59_000);
    farm.control(retried, Control::Retry);
    assert!(!farm.wait(900).iter().any(|c| matches!(c, Command::Record(Fact::JobRemoved { .. }))), "not yet");
    let commands = farm.wait(1_100);
    let forgotten: Vec<_> =
        commands.iter().filter(|c| matches!(c, Command::Record(Fact::JobRemoved { .. }))).cloned().collect();
    assert_eq!(forgotten, [Command::Record(Fact::JobRemoved { job: done })]);
    let left = |farm: &TestFarm| farm.scheduler.jobs(farm.now).iter().map(|status| status.job).collect::<Vec<_>>();
    assert_eq!(left(&farm), [retried, runs]);
    assert_eq!(farm.scheduler.frames(done), Err(Refusal::NoSuchJob { job: done }));
    assert_eq!(find_answer(&farm.control(done, Control::Retry)), None);
    assert!(is_refused(&farm.complete(2, &tile, Done)), "a late word about it");
    farm.restart();
    assert_eq!(left(&farm), [retried, runs]);
    let again = submit(&mut farm, "done");
    assert!(again > runs, "a number is never used twice, and the key is free: {again}");
}
