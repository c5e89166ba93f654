//! Tests of the merge as a tree: frames of 5 tiles in groups of 2.

use crate::common;
use crate::common::{TestFarm, config, grouped_job, panic_failure};
use femc_model::*;
use femc_schedule::*;

use Decision::{Continue, Done};
use StageKind::{Image, Reduce, Render};

fn farm(rounds: &[u32]) -> (TestFarm, JobId) {
    let mut farm = TestFarm::new();
    let id = farm.submit(grouped_job(&[1], 5, rounds, 2));
    farm.join(1);
    (farm, id)
}

fn roles(parts: &FrameParts) -> Vec<Role> {
    parts.outputs.iter().map(|output| output.role).collect()
}

/// Completes tasks until the worker's oldest one has this kind.
fn complete_until_kind(farm: &mut TestFarm, kind: StageKind) -> Assignment {
    complete_until(farm, |task| task.stage.kind == kind)
}

fn complete_until(farm: &mut TestFarm, wanted: impl Fn(&TaskKey) -> bool) -> Assignment {
    for _ in 0..100 {
        let held = farm.first_lease_of(1);
        if wanted(&held.task) {
            return held;
        }
        farm.complete(1, &held, Continue);
    }
    panic!("there is no such task")
}

fn lost_inputs(artifact: Artifact) -> Failure {
    Failure::LostInputs { digests: vec![artifact.digest], message: "gone".into() }
}

/// Completes a task. Returns the number of released artifacts without any reference.
fn complete_and_count_released(farm: &mut TestFarm, held: &Assignment, decision: Decision) -> usize {
    let commands = farm.complete(1, held, decision);
    let all = commands.into_iter().flat_map(|command| match command {
        Command::Discard(digests) => digests,
        _ => Vec::new(),
    });
    farm.scheduler.unreferenced(all.collect()).len()
}

#[test]
fn group_is_reduced_when_its_tiles_exist_and_merge_reads_groups() {
    let (mut farm, id) = farm(&[4]);
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 1), (1, 0, Render, 2)], "half a group is none");
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 2), (1, 0, Reduce, 0)], "before more tiles");
    let reduce = farm.leases[1].1.clone();
    let read: Vec<u32> = reduce.spec.inputs.iter().map(|input| input.item).collect();
    assert_eq!((reduce.spec.next_round, reduce.spec.item, read), (NextRound::Impossible, 0, vec![0, 1]));
    assert_eq!(complete_and_count_released(&mut farm, &reduce, Done), 2, "the tiles' artifacts are released");
    assert_eq!(farm.status(id).active[0].tiles_done, 2, "gathered tiles are done");
    let merge = complete_until_kind(&mut farm, Image);
    assert_eq!(merge.spec.inputs_of_role(Role::Pixels).count(), 3);
    assert_eq!(
        complete_and_count_released(&mut farm, &merge, Done),
        3,
        "the groups' pixels; the last round keeps no sums"
    );
    let frame = farm.scheduler.frames(id).unwrap()[0].clone();
    assert_eq!(farm.state(id), JobState::Done);
    assert_eq!(frame.busy_seconds, 5.0 * 0.5 + 3.0 * 0.125 + 0.25);
    assert_eq!(farm.status(id).samples_done, 5 * 64 * 4);
}

#[test]
fn the_next_round_gathers_with_the_sums_of_the_round_before() {
    let (mut farm, id) = farm(&[4, 8]);
    let merge = complete_until_kind(&mut farm, Image);
    assert_eq!(complete_and_count_released(&mut farm, &merge, Continue), 3, "the pixels go, the sums stay");
    let parts = farm.scheduler.partial_frames(id).unwrap();
    assert_eq!(roles(&parts[0]), [Role::Sums; 3]);
    let reduce = complete_until_kind(&mut farm, Reduce);
    assert_eq!((reduce.spec.next_round, reduce.spec.inputs_of_role(Role::Sums).count()), (NextRound::Impossible, 1));
    farm.complete(1, &reduce, Done);
    let parts = farm.scheduler.partial_frames(id).unwrap();
    assert_eq!(roles(&parts[0]), [Role::Sums, Role::Sums, Role::Tile, Role::Pixels], "a preview counts nothing twice");
    let producer = |digest| farm.scheduler.producer(id, digest).unwrap();
    assert_eq!(producer(&parts[0].outputs[3].artifact.digest), Some(reduce.task));
    assert_eq!(producer(&parts[0].outputs[2].artifact.digest).map(|task| task.stage.kind), Some(Render));
    assert_eq!(producer(&Digest::compute(b"nothing")), None);
    let merge = complete_until_kind(&mut farm, Image);
    assert_eq!(merge.task.stage.round, 1);
    farm.complete(1, &merge, Done);
    assert_eq!((farm.state(id), farm.scheduler.frames(id).unwrap()[0].spp), (JobState::Done, 8));
}

#[test]
fn lost_tile_or_group_is_rendered_again_and_others_are_not() {
    let (mut farm, id) = farm(&[4]);
    let reduce = complete_until_kind(&mut farm, Reduce);
    let first = reduce.spec.artifacts().next().unwrap();
    farm.fail(1, &reduce, lost_inputs(first));
    let again = complete_until(&mut farm, |task| task.stage.kind == Render && task.index == 0);
    farm.complete(1, &again, Done);
    let merge = complete_until_kind(&mut farm, Image);
    let group = merge.spec.artifacts().nth(1).unwrap();
    farm.fail(1, &merge, lost_inputs(group));
    assert_eq!(farm.tasks_of(1), [(1, 0, Render, 2), (1, 0, Render, 3)], "the tiles of group 1");
    assert_eq!(farm.status(id).samples_done, 3 * 64 * 4);
    let merge = complete_until_kind(&mut farm, Image);
    farm.complete(1, &merge, Done);
    assert_eq!((farm.state(id), farm.status(id).samples_done), (JobState::Done, 5 * 64 * 4));
}

#[test]
fn lost_sums_are_remade_with_only_their_tiles_until_a_limit() {
    let (mut farm, id) = farm(&[4, 8]);
    let merge = complete_until_kind(&mut farm, Image);
    farm.complete(1, &merge, Continue);
    for attempt in 1..=3 {
        let reduce =
            complete_until(&mut farm, |task| task.stage.kind == Reduce && task.index == 0 && task.stage.round == 1);
        let sums = reduce.spec.inputs_of_role(Role::Sums).next().unwrap().output.artifact;
        let before = farm.status(id).samples_done;
        farm.fail(1, &reduce, lost_inputs(sums));
        let again = if attempt < 3 { 2 * 64 * 4 } else { 0 };
        assert_eq!(farm.status(id).samples_done, before - again, "attempt {attempt}: of two tiles of the first round");
        let rounds: Vec<u32> = farm.leases.iter().map(|(_, held)| held.task.stage.round).collect();
        assert!(rounds.iter().all(|&round| round == 0) || attempt < 3, "{rounds:?}");
    }
    while farm.state(id) == JobState::Running {
        farm.complete_first(1, Continue);
    }
    assert_eq!(farm.state(id), JobState::Failed);
    assert_eq!(farm.status(id).quarantined[0].task.stage.kind, Reduce);
    farm.control(id, Control::Retry);
    while farm.state(id) == JobState::Running {
        farm.complete_first(1, Continue);
    }
    assert_eq!((farm.state(id), farm.status(id).samples_done), (JobState::Done, 5 * 64 * 8));
}

#[test]
fn reduce_out_of_attempts_blocks_last_and_is_retried_alone() {
    let (mut farm, id) = farm(&[4]);
    for _ in 0..3 {
        let reduce = complete_until(&mut farm, |task| task.stage.kind == Reduce && task.index == 0);
        farm.fail(1, &reduce, panic_failure());
    }
    assert_eq!(farm.state(id), JobState::Running, "there are more tiles");
    while farm.state(id) == JobState::Running {
        farm.complete_first(1, Done);
    }
    let status = farm.status(id);
    assert_eq!((status.state, status.quarantined.len(), status.waits.len()), (JobState::Failed, 1, 1));
    farm.control(id, Control::Retry);
    assert_eq!(farm.tasks_of(1), [(1, 0, Reduce, 0)]);
    farm.complete_first(1, Done);
    farm.complete_first(1, Done);
    assert_eq!(farm.state(id), JobState::Done);
}

#[test]
fn restarted_coordinator_resumes_reduced_groups_from_snapshot() {
    let (mut farm, id) = farm(&[4, 8]);
    let merge = complete_until_kind(&mut farm, Image);
    farm.complete(1, &merge, Continue);
    let reduce = complete_until_kind(&mut farm, Reduce);
    farm.complete(1, &reduce, Done);
    let ledger = farm.scheduler.ledger();
    assert_eq!(Ledger::decode(&ledger.encode().unwrap()).as_ref(), Ok(ledger));
    let held = farm.leases.clone();
    let (mut next, _) = Scheduler::new(config(), ledger.clone());
    assert_eq!(next.partial_frames(id).unwrap(), farm.scheduler.partial_frames(id).unwrap());
    farm.restart();
    farm.rejoin(2, &held.iter().map(|(_, held)| held.clone()).collect::<Vec<_>>());
    while farm.state(id) == JobState::Running {
        farm.complete_first(2, Done);
    }
    assert_eq!(farm.state(id), JobState::Done);
    let registration = Registration { instance: 3, ..common::registration() };
    let commands = next.handle(Event::Joined { worker: WorkerId(3), registration }, farm.now);
    let assigned = commands.iter().filter_map(|command| match command {
        Command::Assign { assignment, .. } => Some((assignment.task.stage.kind, assignment.task.index)),
        _ => None,
    });
    assert_eq!(assigned.collect::<Vec<_>>(), [(Render, 3), (Render, 4)], "group 0 is gathered, tile 2 is done");
}

#[test]
fn a_merge_says_what_it_waits_for() {
    let (mut farm, id) = farm(&[4]);
    farm.join(2);
    let waits =
        |farm: &TestFarm| farm.status(id).waits.into_iter().find(|wait| matches!(wait, WaitReason::StageWaits { .. }));
    while farm.leases.iter().any(|(_, held)| held.task.stage.kind == Render) {
        let (worker, held) = farm.leases.iter().find(|(_, h)| h.task.stage.kind == Render).cloned().unwrap();
        if farm.status(id).active.first().is_some_and(|frame| frame.tiles_done == 4) {
            assert_eq!(waits(&farm), Some(WaitReason::StageWaits { frame: 1, stage: Reduce, needs: Render, tasks: 1 }));
        }
        farm.complete(worker.0, &held, Done);
    }
    assert_eq!(farm.status(id).active[0].stage, Reduce);
    assert_eq!(waits(&farm), Some(WaitReason::StageWaits { frame: 1, stage: Image, needs: Reduce, tasks: 3 }));
}

#[test]
fn reduce_without_sums_for_next_round_counts_as_failed() {
    let (mut farm, _) = farm(&[4, 8]);
    let reduce = complete_until_kind(&mut farm, Reduce);
    let mut result = common::result_of(&reduce, Continue);
    result.outputs.retain(|output| output.role != Role::Sums);
    let commands = farm.complete_with(1, &reduce, result);
    assert!(commands.iter().any(|c| matches!(c, Command::Record(Fact::Failed { .. }))), "{commands:?}");
}
