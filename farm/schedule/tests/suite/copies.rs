//! Tests of copies: tasks that take too long are leased twice.

use crate::common;
use crate::common::{TestFarm, job, panic_failure, result_in};
use femc_model::*;
use femc_schedule::*;

use Decision::Done;

/// Creates a farm with two workers and a job of two tiles and an image. The first tile is done in a second, the second one hangs at
/// worker 1, and worker 2 is idle.
fn farm_with_late_task() -> (TestFarm, JobId, Assignment) {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    wait_with_heartbeats(&mut farm, 1_000);
    farm.complete_with(1, &held, result_in(&held, Done, 1.0));
    farm.join(2);
    let late = farm.first_lease_of(1);
    assert_eq!((late.copy_of, farm.tasks_of(2)), (None, vec![]));
    (farm, id, late)
}

/// Lets time pass while all workers send heartbeats.
fn wait_with_heartbeats(farm: &mut TestFarm, milliseconds: u64) -> Vec<Command> {
    let (mut commands, mut left) = (vec![], milliseconds);
    while left > 0 {
        let step = left.min(500);
        left -= step;
        for worker in farm.scheduler.workers(farm.now) {
            commands.extend(farm.heartbeat(worker.worker.0, Phase::Working, farm.now.0));
        }
        commands.extend(farm.wait(step));
    }
    commands
}

/// Returns the copy that worker 2 gets.
fn copy_of_late_task(farm: &mut TestFarm) -> Assignment {
    wait_with_heartbeats(farm, 2_500);
    farm.first_lease_of(2)
}

fn is_recorded(commands: &[Command]) -> bool {
    commands.iter().any(|command| matches!(command, Command::Record(_)))
}

fn is_revoked(commands: &[Command], lease: &Assignment) -> bool {
    commands
        .iter()
        .any(|c| matches!(c, Command::Revoke { epoch, reason: RevokeReason::Done, .. } if *epoch == lease.epoch))
}

#[test]
fn late_task_gets_one_copy_and_only_the_first_result_counts() {
    for the_copy_wins in [false, true] {
        let (mut farm, id, late) = farm_with_late_task();
        wait_with_heartbeats(&mut farm, 1_000);
        assert_eq!(farm.tasks_of(2), [], "twice the expected time is not late yet");
        let copy = copy_of_late_task(&mut farm);
        assert_eq!((copy.task, copy.copy_of, &copy.spec), (late.task, Some(late.epoch), &late.spec));
        farm.join(3);
        wait_with_heartbeats(&mut farm, 5_000);
        assert_eq!(farm.tasks_of(3), [], "there is one copy, no more");
        let (first, second) = if the_copy_wins { ((2, &copy), (1, &late)) } else { ((1, &late), (2, &copy)) };
        let commands = farm.complete(first.0, first.1, Done);
        assert!(is_recorded(&commands) && is_revoked(&commands, second.1), "{commands:?}");
        let commands = farm.complete(second.0, second.1, Done);
        assert!(!is_recorded(&commands), "{commands:?}");
        let status = farm.status(id);
        assert_eq!((status.active[0].tiles_done, status.copies), (2, 1));
    }
}

#[test]
fn copies_wait_for_other_work_and_a_known_duration() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 1, &[4]));
    (1..=2).for_each(|worker| drop(farm.join(worker)));
    wait_with_heartbeats(&mut farm, 60_000);
    assert_eq!(farm.tasks_of(2), [], "nobody knows");

    let (mut farm, _, late) = farm_with_late_task();
    farm.submit(job(&[1], 1, &[4]));
    wait_with_heartbeats(&mut farm, 60_000);
    assert!(farm.leases.iter().all(|(_, held)| held.copy_of.is_none()), "worker 2 has the other job's task");
    let other = farm.first_lease_of(2);
    assert_ne!(other.task.job, late.task.job);
    farm.complete(2, &other, Done);
    // The join task runs beside the late task, or on the idle worker.
    let (holder, merge) = farm.leases.iter().find(|(_, held)| held.task.job == other.task.job).cloned().unwrap();
    farm.complete(holder.0, &merge, Done);
    wait_with_heartbeats(&mut farm, 500);
    assert_eq!(farm.first_lease_of(2).copy_of, Some(late.epoch));
}

#[test]
fn task_is_late_after_two_seconds_and_twice_the_expected_time() {
    for (expected, not_yet, late) in [(5_000, 10_000, 10_500), (100, 2_000, 2_500)] {
        let mut farm = TestFarm::with_config(Config { prefetch: 0, ..common::config() });
        farm.submit(job(&[1], 2, &[4]));
        farm.join(1);
        let held = farm.first_lease_of(1);
        wait_with_heartbeats(&mut farm, expected);
        farm.complete_with(1, &held, result_in(&held, Done, expected as f64 / 1000.0));
        farm.join(2);
        let granted = farm.now;
        wait_with_heartbeats(&mut farm, not_yet);
        assert_eq!(farm.tasks_of(2), [], "{expected} ms were expected, {} went by", farm.now.since(granted));
        wait_with_heartbeats(&mut farm, late - not_yet);
        assert_eq!(farm.tasks_of(2).len(), 1, "{expected} ms were expected, {} went by", farm.now.since(granted));
    }
}

#[test]
fn a_group_that_takes_too_long_to_gather_is_gathered_twice() {
    let mut farm = TestFarm::new();
    farm.submit(common::grouped_job(&[1], 4, &[4], 2));
    farm.join(1);
    let is_reduce = |held: &Assignment| held.task.stage.kind == StageKind::Reduce;
    let mut reduced = 0;
    while reduced == 0 || !is_reduce(&farm.first_lease_of(1)) {
        let held = farm.first_lease_of(1);
        reduced += usize::from(is_reduce(&held));
        wait_with_heartbeats(&mut farm, 500);
        farm.complete(1, &held, Done);
    }
    farm.join(2);
    let late = farm.first_lease_of(1);
    wait_with_heartbeats(&mut farm, 5_000);
    assert_eq!(farm.first_lease_of(2).copy_of, Some(late.epoch), "{:?}", farm.leases);
}

#[test]
fn copies_wait_while_workers_return_to_a_restarted_coordinator() {
    let mut farm = TestFarm::with_config(Config { regroup: 60_000, ..common::config() });
    farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    let held = farm.leases.iter().map(|(_, held)| held.clone()).collect::<Vec<_>>();
    farm.restart();
    farm.rejoin(2, &held);
    wait_with_heartbeats(&mut farm, 1_000);
    farm.complete(2, &held[0], Done);
    farm.join(3);
    wait_with_heartbeats(&mut farm, 10_000);
    assert_eq!(farm.tasks_of(3), [], "others may still come back");
    wait_with_heartbeats(&mut farm, 60_000);
    assert!(!farm.tasks_of(3).is_empty());
}

#[test]
fn a_failure_of_one_of_two_is_no_attempt_and_the_other_goes_on() {
    for the_copy_fails in [false, true] {
        let (mut farm, id, late) = farm_with_late_task();
        let copy = copy_of_late_task(&mut farm);
        let (bad, good) = if the_copy_fails { ((2, &copy), (1, &late)) } else { ((1, &late), (2, &copy)) };
        assert!(!is_recorded(&farm.fail(bad.0, bad.1, panic_failure())));
        assert!(farm.leases.iter().all(|(_, held)| held.task != late.task || held.epoch == good.1.epoch));
        assert!(is_recorded(&farm.fail(good.0, good.1, panic_failure())), "the last one counts");
        assert_eq!(farm.status(id).quarantined, []);
    }
}

#[test]
fn a_worker_that_leaves_leaves_the_task_to_the_other() {
    for the_copy_leaves in [false, true] {
        let (mut farm, _, late) = farm_with_late_task();
        let copy = copy_of_late_task(&mut farm);
        let (gone, stays) = if the_copy_leaves { (2, (1, &late)) } else { (1, (2, &copy)) };
        farm.leave(gone);
        farm.join(4);
        assert_eq!(farm.tasks_of(4), [], "it is not ready");
        assert!(is_recorded(&farm.complete(stays.0, stays.1, Done)));
    }
}

#[test]
fn restarted_worker_keeps_its_lease_despite_a_copy() {
    for the_copy_returns in [false, true] {
        let (mut farm, _, late) = farm_with_late_task();
        let copy = copy_of_late_task(&mut farm);
        let lease = if the_copy_returns { &copy } else { &late };
        let commands = farm.rejoin(5, std::slice::from_ref(lease));
        assert!(!commands.iter().any(|c| matches!(c, Command::Revoke { .. })), "{commands:?}");
        assert!(is_recorded(&farm.complete(5, lease, Done)));
    }
}

#[test]
fn a_cancelled_job_recalls_both() {
    let (mut farm, id, late) = farm_with_late_task();
    let copy = copy_of_late_task(&mut farm);
    let commands = farm.control(id, Control::Cancel);
    let is_revoked = |lease: &Assignment| {
        commands.iter().any(|c| matches!(c, Command::Revoke { epoch, .. } if *epoch == lease.epoch))
    };
    assert!(is_revoked(&late) && is_revoked(&copy));
}

#[test]
fn a_merge_that_misses_a_tile_ends_its_copy_too() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1, 2], 1, &[4]));
    farm.join(1);
    while farm.scheduler.frames(JobId(1)).unwrap().is_empty() {
        let held = farm.first_lease_of(1);
        farm.complete_with(1, &held, result_in(&held, Done, 0.1));
    }
    let merge = farm.first_lease_of(1);
    farm.join(2);
    wait_with_heartbeats(&mut farm, 3_000);
    let copy = farm.first_lease_of(2);
    assert_eq!(copy.copy_of, Some(merge.epoch));
    let first = merge.spec.artifacts().next().unwrap();
    let lost = Failure::LostInputs { digests: vec![first.digest], message: "gone".into() };
    farm.fail(1, &merge, lost);
    assert!(farm.leases.iter().all(|(_, held)| held.epoch != copy.epoch), "it would miss the same");
    assert!(!is_recorded(&farm.complete(2, &copy, Done)));
    let again: Vec<StageKind> = farm.leases.iter().map(|(_, held)| held.task.stage.kind).collect();
    assert_eq!(again, [StageKind::Render]);
}

#[test]
fn returning_copy_is_still_the_second_and_no_third_is_made() {
    let (mut farm, _, late) = farm_with_late_task();
    let copy = copy_of_late_task(&mut farm);
    farm.rejoin(5, std::slice::from_ref(&copy));
    farm.leave(2);
    farm.join(6);
    wait_with_heartbeats(&mut farm, 20_000);
    assert_eq!(farm.tasks_of(6), []);
    let commands = farm.complete(1, &late, Done);
    assert!(is_recorded(&commands));
    let is_revoked = |command: &Command| matches!(command, Command::Revoke { worker: WorkerId(5), epoch, .. } if *epoch == copy.epoch);
    assert!(commands.iter().any(is_revoked), "in the same breath: {commands:?}");
}

#[test]
fn what_one_of_two_took_is_not_noted_of_the_other() {
    let (mut farm, _, late) = farm_with_late_task();
    let copy = copy_of_late_task(&mut farm);
    let usage =
        TaskUsage { task: late.task, epoch: late.epoch, usage: ResourceUsage { cpu: 3.0, ..ResourceUsage::default() } };
    farm.handle(Event::Usage { worker: WorkerId(1), usage });
    let noted = farm.complete(2, &copy, Done).into_iter().filter_map(|command| match command {
        Command::RecordAttempt(note) => Some((note.epoch, note.usage.map(|usage| usage.cpu))),
        _ => None,
    });
    assert_eq!(noted.collect::<Vec<_>>(), [(copy.epoch, None), (late.epoch, Some(3.0))]);
}
