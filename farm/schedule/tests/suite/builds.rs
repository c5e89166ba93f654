//! Tests of frames and builds: one build of the engine renders a whole frame.

use crate::common;
use crate::common::{TestFarm, config, job, registration, result_of};
use femc_model::*;
use femc_schedule::*;

use Decision::Done;
use StageKind::{Image, Render};

fn join(farm: &mut TestFarm, worker: u64, engine: &str) -> Vec<Command> {
    farm.join_as(worker, Registration { instance: worker, engine: engine.into(), ..registration() })
}

fn farm() -> TestFarm {
    TestFarm::with_config(Config { prefetch: 0, ..config() })
}

#[test]
fn a_worker_of_another_build_does_another_frame() {
    let mut farm = farm();
    farm.submit(job(&[1, 2], 2, &[4]));
    join(&mut farm, 1, "old");
    join(&mut farm, 2, "new");
    assert_eq!((farm.tasks_of(1), farm.tasks_of(2)), (vec![(1, 0, Render, 0)], vec![(2, 0, Render, 0)]));
    farm.complete_first(1, Done);
    farm.complete_first(2, Done);
    assert_eq!((farm.tasks_of(1), farm.tasks_of(2)), (vec![(1, 0, Render, 1)], vec![(2, 0, Render, 1)]));
    farm.complete_first(2, Done);
    farm.complete_first(2, Done);
    assert_eq!(farm.tasks_of(2), [], "frame 1 is the other's, also its merge");
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1), [(1, 0, Image, 0)]);
    farm.complete_first(1, Done);
    assert_eq!(farm.state(JobId(1)), JobState::Done);
}

#[test]
fn frames_that_wait_for_another_build_keep_no_worker_idle() {
    let mut farm = farm();
    farm.submit(job(&[1, 2, 3, 4, 5, 6], 1, &[4]));
    for worker in 1..=3 {
        join(&mut farm, worker, "old");
    }
    for worker in 1..=3 {
        farm.complete_first(worker, Done);
    }
    for worker in 1..=3 {
        farm.leave(worker);
    }
    for worker in 4..=6 {
        join(&mut farm, worker, "new");
    }
    let frames = (4..=6).map(|worker| farm.tasks_of(worker)[0].0);
    assert_eq!(frames.collect::<Vec<_>>(), [4, 5, 6]);
}

#[test]
fn frame_is_bound_to_a_build_by_a_result_not_by_a_lost_lease() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 2, &[4]));
    join(&mut farm, 1, "old");
    farm.leave(1);
    join(&mut farm, 2, "new");
    assert_eq!(farm.tasks_of(2), [(1, 0, Render, 0)]);
    farm.complete_first(2, Done);
    farm.leave(2);
    farm.restart();
    join(&mut farm, 3, "old");
    assert_eq!(farm.tasks_of(3), [], "over a restart, too");
    assert_eq!(farm.status(id).waits, [WaitReason::OtherBuild { frames: 1 }]);
    join(&mut farm, 4, "new");
    assert_eq!(farm.tasks_of(4), [(1, 0, Render, 1)]);
}

#[test]
fn frame_of_a_gone_build_restarts_after_a_while_if_others_exist() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 2, &[4]));
    join(&mut farm, 1, "old");
    farm.wait(1_000);
    farm.complete_first(1, Done);
    farm.leave(1);
    for _ in 0..200 {
        farm.wait(1_000);
    }
    assert!(farm.status(id).samples_done > 0, "nobody could do it anew");
    join(&mut farm, 2, "new");
    farm.wait(1_000);
    assert_eq!((farm.status(id).samples_done, farm.tasks_of(2)), (0, vec![(1, 0, Render, 0)]));
    farm.complete_first(2, Done);
    farm.complete_first(2, Done);
    farm.complete_first(2, Done);
    assert_eq!(farm.state(id), JobState::Done);
    assert_eq!(&farm.replay(), farm.scheduler.ledger());
}

#[test]
fn a_frame_whose_build_is_there_waits_for_it() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 3, &[4]));
    join(&mut farm, 1, "old");
    farm.wait(1_000);
    farm.complete_first(1, Done);
    join(&mut farm, 2, "new");
    for step in 1..100 {
        farm.heartbeat(1, Phase::Working, step);
        farm.heartbeat(2, Phase::Waiting, 0);
        farm.wait(1_000);
    }
    assert_eq!((farm.tasks_of(1).len(), farm.tasks_of(2).len()), (1, 0), "not even as a second one");
    assert!(farm.status(id).samples_done > 0);
}

#[test]
fn a_lease_is_not_taken_over_by_another_build() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 2, &[4]));
    join(&mut farm, 1, "old");
    farm.complete_first(1, Done);
    let held = farm.first_lease_of(1);
    farm.restart();
    let key = farm.scheduler.spec(id).expect("the job is there").key();
    let lease = HeldLease { task: held.task, epoch: held.epoch, steps: held.spec.steps.clone(), job: key };
    let upgraded = Registration { instance: 1, engine: "new".into(), held: vec![lease], ..registration() };
    let commands = farm.join_as(1, upgraded);
    let is_revoked = |command: &Command| matches!(command, Command::Revoke { .. });
    assert!(commands.iter().any(is_revoked), "{commands:?}");
    let late = farm.complete_with(1, &held, result_of(&held, Done));
    assert!(late.iter().any(|command| matches!(command, Command::Refuse { .. })));
}

#[test]
fn quarantined_frame_does_not_restart_with_another_build() {
    let mut farm = farm();
    let id = farm.submit(job(&[1, 2], 1, &[4]));
    join(&mut farm, 1, "old");
    farm.complete_first(1, Done);
    while farm.tasks_of(1)[0].0 == 1 {
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, common::panic_failure());
    }
    farm.leave(1);
    join(&mut farm, 2, "new");
    assert_eq!(farm.tasks_of(2), [(2, 0, Render, 0)]);
    for _ in 0..2 * config().orphaned_after / 1_000 {
        farm.wait(1_000);
        farm.heartbeat(2, Phase::Working, 0);
    }
    farm.complete_first(2, Done);
    farm.complete_first(2, Done);
    assert_eq!((farm.tasks_of(2), farm.state(id)), (vec![], JobState::Failed));
}

/// Creates a job with one frame whose image only workers with the tag `big` may make.
fn tagged_job() -> JobSpec {
    let mut spec = job(&[1], 2, &[4]);
    spec.graph.stages.last_mut().unwrap().tags = vec!["big".into()];
    spec
}

fn join_big(farm: &mut TestFarm, worker: u64, engine: &str) -> Vec<Command> {
    let tags = vec!["big".into()];
    farm.join_as(worker, Registration { instance: worker, engine: engine.into(), tags, ..registration() })
}

#[test]
fn a_frame_is_begun_by_a_build_whose_workers_can_do_all_of_it() {
    let mut farm = farm();
    join(&mut farm, 1, "old");
    join_big(&mut farm, 2, "new");
    let id = farm.submit(tagged_job());
    assert_eq!((farm.tasks_of(1), farm.tasks_of(2)), (vec![], vec![(1, 0, Render, 0)]));
    assert_eq!(farm.status(id).waits, [WaitReason::OtherBuild { frames: 1 }]);
    (0..3).for_each(|_| drop(farm.complete_first(2, Done)));
    assert_eq!(farm.state(id), JobState::Done);
}

#[test]
fn frame_stuck_on_its_build_reports_so_and_restarts_on_another() {
    let mut farm = farm();
    let id = farm.submit(tagged_job());
    join(&mut farm, 1, "old");
    (0..2).for_each(|_| drop(farm.complete_first(1, Done)));
    assert_eq!(farm.status(id).waits, [WaitReason::NoWorkerWithTags(vec!["big".into()])]);
    join_big(&mut farm, 2, "new");
    assert_eq!(farm.status(id).waits, [WaitReason::OtherBuild { frames: 1 }]);
    for _ in 0..config().orphaned_after / 1_000 + 1 {
        assert!(farm.leases.is_empty() && farm.status(id).samples_done > 0);
        farm.wait(1_000);
        farm.heartbeat(1, Phase::Waiting, 0);
        farm.heartbeat(2, Phase::Waiting, 0);
    }
    assert_eq!((farm.tasks_of(1), farm.tasks_of(2)), (vec![], vec![(1, 0, Render, 0)]));
    (0..3).for_each(|_| drop(farm.complete_first(2, Done)));
    assert_eq!(farm.state(id), JobState::Done);
    assert_eq!(&farm.replay(), farm.scheduler.ledger());
}

#[test]
fn worker_with_only_stage_tags_does_not_bind_frame_to_its_build() {
    let mut farm = farm();
    let id = farm.submit(JobSpec { tags: vec!["lab".into()], ..tagged_job() });
    let join = |farm: &mut TestFarm, worker: u64, engine: &str, tags: &[&str]| {
        let tags = tags.iter().map(|&tag| tag.to_owned()).collect();
        farm.join_as(worker, Registration { instance: worker, engine: engine.into(), tags, ..registration() })
    };
    join(&mut farm, 1, "old", &["lab"]);
    join(&mut farm, 2, "old", &["big"]);
    (0..2).for_each(|_| drop(farm.complete_first(1, Done)));
    join(&mut farm, 3, "new", &["lab", "big"]);
    for _ in 0..config().orphaned_after / 1_000 + 1 {
        assert!(farm.leases.is_empty(), "{:?}", farm.leases);
        farm.wait(1_000);
        (1..=3).for_each(|worker| drop(farm.heartbeat(worker, Phase::Waiting, 0)));
    }
    assert_eq!((farm.tasks_of(2), farm.tasks_of(3)), (vec![], vec![(1, 0, Render, 0)]));
    (0..3).for_each(|_| drop(farm.complete_first(3, Done)));
    assert_eq!(farm.state(id), JobState::Done);
}
