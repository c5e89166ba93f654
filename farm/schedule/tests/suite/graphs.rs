//! Tests of graphs of stages.

use crate::common;
use crate::common::{TestFarm, config, job_with_graph, panic_failure};
use femc_model::*;
use femc_schedule::*;

use Decision::{Continue, Done};
use StageKind::{Image, Reduce, Render};

fn need(stage: u16, role: Role, reach: Reach, round: Round) -> Need {
    Need { stage, role, reach, round, gaps: false }
}

fn render_stage(tiles: u32, rounds: &[u32]) -> StageTemplate {
    StageTemplate::new(Render, Scope::Frame, TaskSizes::even(tiles, 64), &[Role::Tile]).with_steps(rounds)
}

fn image_stage(scope: Scope, makes: &[Role]) -> StageTemplate {
    StageTemplate::new(Image, scope, TaskSizes::even(1, 1), makes)
}

/// Creates a job with frames of two tiles, sums of pairs of tiles over all frames, and one result of the job.
fn job_with_job_stages(frames: &[u32], gaps: bool) -> JobSpec {
    let pairs = StageTemplate::new(Reduce, Scope::Job, TaskSizes::even(frames.len() as u32, 1), &[Role::Sums]);
    let graph = Graph {
        stages: vec![
            render_stage(2, &[4]),
            image_stage(Scope::Frame, &[Role::Image]).with_input(0, Role::Tile, Reach::All).with_loop(0, 1),
            pairs.with_need(Need { gaps, ..need(0, Role::Tile, Reach::Fan(2), Round::Every) }),
            image_stage(Scope::Job, &[Role::Preview]).with_input(2, Role::Sums, Reach::All),
        ],
    };
    job_with_graph(frames, 2, graph)
}

/// Returns the result of a task of such a graph.
fn result_with(held: &Assignment, roles: &[Role]) -> TaskResult {
    let output = |&role: &Role| Output {
        role,
        artifact: Artifact::from_bytes(format!("{} {}", role.name(), held.task).as_bytes()),
    };
    let decides = held.task.stage.kind == Image && held.task.stage.frame != Stage::JOB_FRAME;
    TaskResult {
        outputs: roles.iter().map(output).collect(),
        units: if held.task.stage.kind == Render { 64 * held.spec.steps.len() as u64 } else { 0 },
        decision: decides.then_some(Done),
        ..TaskResult::default()
    }
}

/// Completes the worker's oldest task, whatever its kind.
fn complete_first(farm: &mut TestFarm, worker: u64) -> TaskKey {
    let held = farm.first_lease_of(worker);
    let roles: &[Role] = match (held.task.stage.kind, held.task.stage.frame) {
        (Render, _) => &[Role::Tile],
        (Image, Stage::JOB_FRAME) => &[],
        (Image, _) => &[Role::Image],
        _ => &[Role::Sums],
    };
    farm.complete_with(worker, &held, result_with(&held, roles));
    held.task
}

#[test]
fn stages_of_the_job_take_no_frames_place() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    farm.submit(job_with_job_stages(&[1, 2, 3], false));
    for worker in 1..=2 {
        farm.join(worker);
    }
    while farm.tasks_of(2) != [(3, 0, Render, 0)] {
        complete_first(&mut farm, 2);
    }
    assert_eq!(farm.tasks_of(1)[0], (1, 0, Render, 0));
    farm.restart();
    farm.join(3);
    farm.join(4);
    farm.join(5);
    assert!((3..=5).all(|worker| !farm.tasks_of(worker).is_empty()));
}

#[test]
fn job_scope_stages_run_as_frames_finish_and_end_the_job() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job_with_job_stages(&[3, 5, 9], false));
    farm.join(1);
    let mut done = Vec::new();
    while farm.state(id) != JobState::Done {
        done.push(complete_first(&mut farm, 1));
    }
    let own: Vec<(StageKind, u32)> =
        done.iter().filter(|task| task.stage.frame == Stage::JOB_FRAME).map(|it| (it.stage.kind, it.index)).collect();
    assert_eq!(own, [(Reduce, 0), (Reduce, 1), (Reduce, 2), (Image, 0)]);
    let first = done.iter().position(|task| task.stage.kind == Reduce).unwrap();
    assert!(done[first..].iter().any(|task| task.stage.kind == Render), "frames go on meanwhile");
    let status = farm.status(id);
    assert_eq!((status.frames_done, status.frames_total, status.samples_done), (3, 3, 3 * 2 * 4 * 64));
    let records: Vec<u32> = farm.scheduler.frames(id).unwrap().iter().map(|record| record.frame).collect();
    assert_eq!(records, [Stage::JOB_FRAME, 3, 5, 9]);
}

#[test]
fn unfinishable_frame_is_a_gap_if_allowed_and_retry_fills_it() {
    let retries = [Control::Retry, Control::RetryFrames(vec![1])];
    for (gaps, retry) in [true, false].into_iter().flat_map(|gaps| retries.clone().map(|retry| (gaps, retry))) {
        let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
        let id = farm.submit(job_with_job_stages(&[1, 2], gaps));
        let mut worker = 1;
        farm.join(worker);
        while farm.state(id) == JobState::Running || farm.state(id) == JobState::Queued {
            let held = farm.first_lease_of(worker);
            if held.task.stage == (Stage { frame: 1, round: 0, number: 0, kind: Render }) && held.task.index == 0 {
                farm.fail(worker, &held, panic_failure());
                farm.leave(worker);
                worker += 1;
                farm.join(worker);
            } else {
                complete_first(&mut farm, worker);
            }
        }
        assert_eq!(farm.state(id), JobState::Failed);
        let of_job = |farm: &TestFarm| farm.scheduler.frames(id).unwrap().iter().any(|it| it.frame == Stage::JOB_FRAME);
        assert_eq!(of_job(&farm), gaps, "gaps allowed: {gaps}");
        let mut waits = vec![WaitReason::Quarantined { frame: 1, tasks: 1 }];
        if !gaps {
            waits.insert(0, WaitReason::Quarantined { frame: Stage::JOB_FRAME, tasks: 0 });
        }
        assert_eq!(farm.status(id).waits, waits);
        farm.control(id, retry);
        assert!(!of_job(&farm), "it was made without a frame");
        while farm.state(id) != JobState::Done {
            complete_first(&mut farm, worker);
        }
        assert!(of_job(&farm));
    }
}

#[test]
fn a_stage_behind_the_loop_reads_all_its_rounds() {
    let mut farm = TestFarm::new();
    let graph = Graph {
        stages: vec![
            render_stage(2, &[4, 8, 16]),
            image_stage(Scope::Frame, &[]).with_input(0, Role::Tile, Reach::All).with_loop(0, 3),
            image_stage(Scope::Frame, &[Role::Image]).with_need(need(0, Role::Tile, Reach::All, Round::Every)),
        ],
    };
    let id = farm.submit(job_with_graph(&[1], 2, graph));
    farm.join(1);
    loop {
        let held = farm.first_lease_of(1);
        let made = match held.task.stage.number {
            0 => result_with(&held, &[Role::Tile]),
            1 => TaskResult {
                decision: Some(if held.task.stage.round == 0 { Continue } else { Done }),
                ..result_with(&held, &[])
            },
            _ => break,
        };
        farm.complete_with(1, &held, made);
    }
    let held = farm.first_lease_of(1);
    assert_eq!(held.spec.inputs.iter().map(|input| input.item).collect::<Vec<_>>(), [0, 1, 0, 1]);
    farm.complete_with(1, &held, TaskResult { decision: None, ..result_with(&held, &[Role::Image]) });
    assert_eq!((farm.state(id), farm.scheduler.frames(id).unwrap()[0].spp), (JobState::Done, 8));
}

/// Returns the rounds and items that the first task of a stage reads when every loop runs all its rounds.
fn inputs_of_first_task(graph: &Graph, reader: u16) -> Vec<(u32, u32)> {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let contents = if graph.has_content_stages() { vec![(1, Digest::compute(b"world"))] } else { vec![] };
    farm.submit(JobSpec { contents, ..job_with_graph(&[1], 2, graph.clone()) });
    farm.join(1);
    let mut made = std::collections::BTreeMap::new();
    loop {
        let held = farm.first_lease_of(1);
        let Stage { round, number, .. } = held.task.stage;
        if number == reader {
            return held.spec.inputs.iter().map(|input| made[&input.output.artifact.digest]).collect();
        }
        let template = &graph.stages[usize::from(number)];
        let decision =
            template.closes.map(|_| if held.spec.next_round == NextRound::Possible { Continue } else { Done });
        let roles: &[Role] = if decision == Some(Continue) { &[] } else { &template.outputs };
        let made_now = TaskResult { decision, ..result_with(&held, roles) };
        made.extend(made_now.outputs.iter().map(|output| (output.artifact.digest, (round, held.task.index))));
        farm.complete_with(1, &held, made_now);
    }
}

#[test]
fn stage_of_another_scope_reads_the_last_or_all_loop_rounds() {
    let (last, all) = (vec![(2, 0), (2, 1)], vec![(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)]);
    for (round, expected) in [(Round::Same, last), (Round::Every, all)] {
        for (made_by, read_by) in [(Scope::Frame, Scope::Job), (Scope::Content, Scope::Frame)] {
            // Results of every round are kept for people; other outputs are not.
            for role in [Role::Sums, Role::Image] {
                let blocks = StageTemplate::new(Reduce, made_by, TaskSizes::even(2, 1), &[role]);
                let close = image_stage(made_by, &[]).with_input(0, role, Reach::All).with_loop(0, 3);
                let reader = image_stage(read_by, &[Role::Preview]).with_need(need(0, role, Reach::All, round));
                let graph = Graph { stages: vec![blocks, close, reader] };
                assert_eq!(inputs_of_first_task(&graph, 2), expected, "{round:?} {read_by:?} {role:?}");
            }
        }
    }
}

#[test]
fn decision_output_for_next_round_and_image_exists_every_round() {
    let graph = || {
        let close = image_stage(Scope::Frame, &[Role::Stops]).with_input(0, Role::Tile, Reach::All).with_loop(0, 3);
        let stages = vec![
            render_stage(1, &[4, 8, 12]),
            close.with_need(need(1, Role::Stops, Reach::All, Round::Previous)),
            image_stage(Scope::Frame, &[Role::Image]).with_input(1, Role::Stops, Reach::All),
        ];
        Graph { stages }
    };
    let refused = |commands: &[Command]| commands.iter().any(|command| matches!(command, Command::Refuse { .. }));
    for end in 0..3 {
        let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
        let id = farm.submit(job_with_graph(&[1], 1, graph()));
        farm.join(1);
        let mut read = Vec::new();
        while farm.state(id) != JobState::Done {
            let held = farm.first_lease_of(1);
            let Stage { round, number, .. } = held.task.stage;
            let roles: &[Role] = [&[Role::Tile], &[Role::Stops], &[Role::Image]][usize::from(number)];
            if number == 2 {
                read = held.spec.inputs.iter().map(|input| input.output.artifact).collect();
            }
            let decision = (number == 1).then_some(if round < end { Continue } else { Done });
            let made = TaskResult { decision, ..result_with(&held, roles) };
            assert!(!refused(&farm.complete_with(1, &held, made)), "{}", held.task);
        }
        let close = Stage { frame: 1, round: end, number: 1, kind: Image };
        let last = Artifact::from_bytes(format!("stops {}", TaskKey { job: id, stage: close, index: 0 }).as_bytes());
        assert_eq!(read, [last], "of the last round alone");
    }
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    farm.submit(job_with_graph(&[1], 1, graph()));
    farm.join(1);
    complete_first(&mut farm, 1);
    let held = farm.first_lease_of(1);
    assert!(
        refused(&farm.complete_with(1, &held, result_with(&held, &[]))),
        "it is done, and does not say what counts"
    );
}

#[test]
fn round_is_counted_once_even_if_its_closing_task_is_redone() {
    let mut farm = TestFarm::new();
    let before = |stage, role| need(stage, role, Reach::All, Round::Previous);
    let blocks = StageTemplate::new(Reduce, Scope::Frame, TaskSizes::even(2, 1), &[Role::Sums]);
    let graph = Graph {
        stages: vec![
            blocks.with_need(before(0, Role::Sums)).with_need(before(1, Role::Numbers)),
            image_stage(Scope::Frame, &[Role::Numbers]).with_input(0, Role::Sums, Reach::All).with_loop(0, 3),
            image_stage(Scope::Frame, &[Role::Image]).with_input(0, Role::Sums, Reach::All),
        ],
    };
    let id = farm.submit(job_with_graph(&[1], 2, graph));
    farm.join(1);
    let (mut done, mut is_lost) = (Vec::new(), false);
    while farm.state(id) != JobState::Done {
        let held = farm.first_lease_of(1);
        let Stage { round, number, .. } = held.task.stage;
        let end = held.spec.inputs.iter().find(|input| input.output.role == Role::Numbers);
        if let (1, Some(end), false) = (round, end, is_lost) {
            is_lost = true;
            let digests = vec![end.output.artifact.digest];
            farm.fail(1, &held, Failure::LostInputs { digests, message: "gone".into() });
            continue;
        }
        let decision =
            (number == 1).then_some(if held.spec.next_round == NextRound::Possible { Continue } else { Done });
        let roles: &[Role] = [&[Role::Sums], &[Role::Numbers], &[Role::Image]][usize::from(number)];
        farm.complete_with(1, &held, TaskResult { decision, ..result_with(&held, roles) });
        done.push((round, number, held.task.index));
    }
    let rounds = |stage_number: u16| {
        done.iter().filter(|(_, number, _)| *number == stage_number).map(|it| it.0).collect::<Vec<_>>()
    };
    assert_eq!((rounds(0), rounds(1)), (vec![0, 0, 1, 1, 2, 2], vec![0, 0, 1, 2]), "{done:?}");
}

#[test]
fn a_task_that_was_put_aside_in_another_round_gets_no_copy() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, late: 1, lease: 1 << 40, stall: 1 << 40, ..config() });
    let before = |stage, role| need(stage, role, Reach::All, Round::Previous);
    let blocks =
        StageTemplate::new(Reduce, Scope::Frame, TaskSizes::even(3, 1), &[Role::Sums]).with_need(before(0, Role::Sums));
    let close = image_stage(Scope::Frame, &[]).with_input(0, Role::Sums, Reach::All).with_loop(0, 2);
    let end = image_stage(Scope::Frame, &[Role::Image]).with_input(0, Role::Sums, Reach::All);
    farm.submit(job_with_graph(&[1], 2, Graph { stages: vec![blocks, close, end] }));
    (1..=5).for_each(|worker| drop(farm.join(worker)));
    let find = |farm: &TestFarm, round: u32, index: u32| {
        let is_it = |held: &Assignment| (held.task.stage.round, held.task.index) == (round, index);
        let found = farm.leases.iter().find(|(_, held)| is_it(held)).expect("a lease");
        (found.0.0, found.1.clone())
    };
    for index in 0..3 {
        let (worker, held) = find(&farm, 0, index);
        farm.complete_with(worker, &held, TaskResult { seconds: 0.01, ..result_with(&held, &[Role::Sums]) });
    }
    let (worker, held) = find(&farm, 0, 0);
    farm.complete_with(worker, &held, TaskResult { decision: Some(Continue), ..result_with(&held, &[]) });
    let ((reader, first), (other, second)) = (find(&farm, 1, 0), find(&farm, 1, 1));
    let digests = [1, 2].map(|item: usize| second.spec.inputs[item].output.artifact.digest).to_vec();
    farm.fail(reader, &first, Failure::LostInputs { digests, message: "gone".into() });
    for _ in 0..2 {
        let (worker, held) = find(&farm, 0, 1);
        farm.fail(worker, &held, panic_failure());
    }
    let leases = |farm: &TestFarm| farm.leases.iter().filter(|(_, held)| held.task.index == 1).count();
    assert_eq!(leases(&farm), 2, "of both rounds");
    farm.fail(other, &second, panic_failure());
    assert_eq!(leases(&farm), 1, "it is quarantined, and earlier leases continue");
    farm.wait(60_000);
    let of_other = farm.leases.iter().filter(|(_, held)| (held.task.stage.round, held.task.index) == (0, 2)).count();
    assert_eq!((leases(&farm), of_other), (1, 2), "a late task that is not quarantined gets one");
}

#[test]
fn frame_fails_if_lost_output_is_of_a_task_quarantined_later() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let before = |stage, role| need(stage, role, Reach::All, Round::Previous);
    let blocks =
        StageTemplate::new(Reduce, Scope::Frame, TaskSizes::even(3, 1), &[Role::Sums]).with_need(before(0, Role::Sums));
    let close = image_stage(Scope::Frame, &[]).with_input(0, Role::Sums, Reach::All).with_loop(0, 2);
    let end = image_stage(Scope::Frame, &[Role::Image]).with_input(0, Role::Sums, Reach::All);
    let id = farm.submit(job_with_graph(&[1], 2, Graph { stages: vec![blocks, close, end] }));
    (1..=6).for_each(|worker| drop(farm.join(worker)));
    let find = |farm: &TestFarm, round: u32, index: u32| {
        let is_it = |held: &Assignment| (held.task.stage.round, held.task.index) == (round, index);
        farm.leases.iter().find(|(_, held)| is_it(held)).map(|(key, held)| (key.0, held.clone()))
    };
    for index in 0..3 {
        let (worker, held) = find(&farm, 0, index).expect("a lease");
        farm.complete_with(worker, &held, result_with(&held, &[Role::Sums]));
    }
    let (worker, held) = find(&farm, 0, 0).expect("a lease");
    farm.complete_with(worker, &held, TaskResult { decision: Some(Continue), ..result_with(&held, &[]) });
    for _ in 0..3 {
        let (worker, held) = find(&farm, 1, 0).expect("a lease");
        farm.fail(worker, &held, panic_failure());
    }
    let (worker, held) = find(&farm, 1, 1).expect("a lease");
    assert!(find(&farm, 1, 2).is_some() && !farm.state(id).has_ended());
    let lost = held.spec.inputs[0].output.artifact.digest;
    farm.fail(worker, &held, Failure::LostInputs { digests: vec![lost], message: "gone".into() });
    assert_eq!((farm.state(id), farm.leases.len()), (JobState::Failed, 0), "nothing makes what is lost");
}

#[test]
fn tiles_take_decided_steps_and_one_that_needs_none_is_skipped() {
    let mut farm = TestFarm::new();
    let id = farm.submit(common::job(&[1], 3, &[4, 8, 16]));
    farm.join(1);
    let mut rendered = Vec::new();
    while farm.state(id) != JobState::Done {
        let held = farm.first_lease_of(1);
        if held.task.stage.kind == Render {
            rendered.push((held.task.stage.round, held.spec.item, held.spec.steps.clone()));
        }
        let decision = match held.task.stage.round {
            0 => Decision::Steps(vec![4, 6, 9]),
            _ => Continue,
        };
        farm.complete(1, &held, decision);
    }
    let expected = [
        (0, 0, 0..4),
        (0, 1, 0..4),
        (0, 2, 0..4),
        (1, 1, 4..6),
        (1, 2, 4..9),
        (2, 0, 4..16),
        (2, 1, 6..16),
        (2, 2, 9..16),
    ];
    assert_eq!(rendered, expected);
    assert_eq!(farm.status(id).samples_done, 3 * 16 * 64);
}

#[test]
fn failed_image_after_the_loop_is_named_as_it_was_leased() {
    let mut farm = TestFarm::new();
    let graph = Graph {
        stages: vec![
            render_stage(2, &[4, 8]),
            image_stage(Scope::Frame, &[]).with_input(0, Role::Tile, Reach::All).with_loop(0, 2),
            image_stage(Scope::Frame, &[Role::Image]).with_input(0, Role::Tile, Reach::All),
        ],
    };
    let id = farm.submit(job_with_graph(&[1], 2, graph));
    farm.join(1);
    while farm.first_lease_of(1).task.stage.number < 2 {
        let held = farm.first_lease_of(1);
        let made = match held.task.stage {
            Stage { number: 0, .. } => result_with(&held, &[Role::Tile]),
            Stage { round: 0, .. } => TaskResult { decision: Some(Continue), ..result_with(&held, &[]) },
            _ => result_with(&held, &[]),
        };
        farm.complete_with(1, &held, made);
    }
    let image = farm.first_lease_of(1).task;
    while farm.status(id).quarantined.is_empty() {
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, panic_failure());
    }
    assert_eq!(farm.status(id).quarantined[0].task, image);
    assert_eq!(image.stage.round, 0, "it is made once");
}

#[test]
fn direct_and_indirect_tile_readers_get_step_counts_per_tile() {
    let mut farm = TestFarm::new();
    let graph = Graph {
        stages: vec![
            render_stage(4, &[4, 8, 16]),
            StageTemplate::new(Reduce, Scope::Frame, TaskSizes::even(2, 1), &[Role::Pixels, Role::Errors, Role::Sums])
                .with_input(0, Role::Tile, Reach::Fan(2))
                .with_need(need(1, Role::Sums, Reach::Same, Round::Previous)),
            StageTemplate::new(StageKind::Decide, Scope::Frame, TaskSizes::even(1, 1), &[])
                .with_input(1, Role::Errors, Reach::All)
                .with_loop(0, 3),
            image_stage(Scope::Frame, &[Role::Image]).with_input(1, Role::Pixels, Reach::All),
        ],
    };
    let id = farm.submit(job_with_graph(&[1], 4, graph));
    farm.join(1);
    let mut assigned = Vec::new();
    while farm.state(id) != JobState::Done {
        let held = farm.first_lease_of(1);
        let Stage { round, kind, .. } = held.task.stage;
        if kind != Render {
            assigned.push((round, kind, held.spec.item, held.spec.steps_taken.numbers().to_vec()));
        }
        let made = match kind {
            Render => result_with(&held, &[Role::Tile]),
            Reduce if held.spec.next_round == NextRound::Possible => {
                result_with(&held, &[Role::Pixels, Role::Errors, Role::Sums])
            }
            Reduce => result_with(&held, &[Role::Pixels, Role::Errors]),
            StageKind::Decide => {
                let steps = [Decision::Steps(vec![4, 8, 8, 8]), Decision::Steps(vec![4, 16, 8, 8]), Done];
                TaskResult { decision: Some(steps[round as usize].clone()), ..result_with(&held, &[]) }
            }
            _ => TaskResult { decision: None, ..result_with(&held, &[Role::Image]) },
        };
        assert!(kind != Render || held.spec.steps_taken == StepsTaken::default(), "{held:?}");
        farm.complete_with(1, &held, made);
    }
    assigned.sort();
    let decide = StageKind::Decide;
    let expected = [
        (0, Reduce, 0, vec![4]),
        (0, Reduce, 1, vec![4]),
        (0, Image, 0, vec![4, 16, 8, 8]),
        (0, decide, 0, vec![4]),
        (1, Reduce, 0, vec![4, 8]),
        (1, Reduce, 1, vec![8]),
        (1, decide, 0, vec![4, 8, 8, 8]),
        (2, Reduce, 0, vec![4, 16]),
        (2, Reduce, 1, vec![8]),
        (2, decide, 0, vec![4, 16, 8, 8]),
    ];
    assert_eq!(assigned, expected);
}

#[test]
fn a_decision_beyond_the_plan_is_a_failure_of_the_task() {
    for steps in [vec![4, 6], vec![4, 6, 17], vec![4, 6, 9, 9]] {
        let mut farm = TestFarm::new();
        farm.submit(common::job(&[1], 3, &[4, 8, 16]));
        farm.join(1);
        while farm.first_lease_of(1).task.stage.kind == Render {
            farm.complete_first(1, Done);
        }
        let held = farm.first_lease_of(1);
        let commands = farm.complete(1, &held, Decision::Steps(steps));
        assert!(commands.iter().any(|c| matches!(c, Command::Record(Fact::Failed { .. }))), "{commands:?}");
    }
}

#[test]
fn an_output_goes_when_all_that_read_it_are_done() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let graph = Graph {
        stages: vec![
            render_stage(2, &[4]),
            StageTemplate::new(Reduce, Scope::Frame, TaskSizes::even(1, 1), &[Role::Pixels]).with_input(
                0,
                Role::Tile,
                Reach::Fan(2),
            ),
            StageTemplate::new(Reduce, Scope::Frame, TaskSizes::even(2, 1), &[Role::Sums]).with_input(
                0,
                Role::Tile,
                Reach::Same,
            ),
            image_stage(Scope::Frame, &[Role::Image])
                .with_input(1, Role::Pixels, Reach::All)
                .with_input(2, Role::Sums, Reach::All)
                .with_loop(0, 1),
        ],
    };
    farm.submit(job_with_graph(&[1], 2, graph));
    farm.join(1);
    let mut released = Vec::new();
    for _ in 0..6 {
        let held = farm.first_lease_of(1);
        let roles: &[Role] = match held.task.stage.number {
            0 => &[Role::Tile],
            1 => &[Role::Pixels],
            2 => &[Role::Sums],
            _ => &[Role::Image],
        };
        let commands = farm.complete_with(1, &held, result_with(&held, roles));
        let all =
            commands.into_iter().filter_map(|c| if let Command::Discard(all) = c { Some(all.len()) } else { None });
        released.push((held.task.stage.number, held.task.index, all.sum::<usize>()));
    }
    // The second reduction has a ready task after each tile, the first one after both.
    assert_eq!(released, [(0, 0, 0), (2, 0, 0), (0, 1, 0), (2, 1, 0), (1, 0, 2), (3, 0, 3)]);
}

#[test]
fn a_job_with_gaps_goes_on_when_its_last_frame_fails() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let id = farm.submit(job_with_job_stages(&[1], true));
    farm.join(1);
    while farm.first_lease_of(1).task.stage.kind == Render {
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, panic_failure());
    }
    assert_eq!(farm.tasks_of(1), [(Stage::JOB_FRAME, 0, Reduce, 0)]);
    complete_first(&mut farm, 1);
    complete_first(&mut farm, 1);
    assert_eq!(farm.state(id), JobState::Failed);
}

#[test]
fn failed_job_revokes_readers_of_a_frame_lost_since() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let id = farm.submit(job_with_job_stages(&[1], false));
    farm.join(1);
    while farm.first_lease_of(1).task.stage.kind != Reduce {
        complete_first(&mut farm, 1);
    }
    let image = farm.scheduler.frames(id).unwrap()[0].outputs[0].artifact.digest;
    farm.handle(Event::ArtifactLost { digest: image });
    farm.join(2);
    farm.join(3);
    while let Some((worker, held)) = farm.leases.iter().find(|(worker, _)| worker.0 != 1).cloned() {
        farm.fail(worker.0, &held, panic_failure());
    }
    assert_eq!((farm.state(id), farm.tasks_of(1)), (JobState::Failed, vec![]));
}

/// Creates a job with one frame of two tiles whose image only workers with the tag `big` may make.
fn tagged_job() -> JobSpec {
    let image = image_stage(Scope::Frame, &[Role::Image]).with_input(0, Role::Tile, Reach::All).with_loop(0, 1);
    job_with_graph(&[1], 2, Graph { stages: vec![render_stage(2, &[4]), image.with_tags(&["big"])] })
}

#[test]
fn tagged_stage_waits_for_a_worker_and_names_missing_tags() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let id = farm.submit(JobSpec { tags: vec!["lab".into()], ..tagged_job() });
    farm.join_with(1, vec!["lab".into()]);
    farm.join_with(2, vec!["big".into()]);
    complete_first(&mut farm, 1);
    assert!(
        !farm.status(id).waits.iter().any(|wait| matches!(wait, WaitReason::NoWorkerWithTags(_))),
        "a tile is under way"
    );
    complete_first(&mut farm, 1);
    assert!(farm.leases.is_empty(), "{:?}", farm.leases);
    assert_eq!(farm.status(id).waits, [WaitReason::NoWorkerWithTags(vec!["lab".into(), "big".into()])]);
    farm.join_with(3, vec!["big".into(), "lab".into()]);
    assert_eq!((farm.tasks_of(1).len(), farm.tasks_of(2).len(), farm.tasks_of(3)), (0, 0, vec![(1, 0, Image, 0)]));
    assert_eq!(farm.status(id).waits, []);
    complete_first(&mut farm, 3);
    assert_eq!(farm.state(id), JobState::Done);
}

#[test]
fn failed_task_is_retried_on_its_only_tagged_worker_not_copied() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, late: 100, ..config() });
    let id = farm.submit(JobSpec { frames: vec![1, 2], ..tagged_job() });
    farm.join_with(1, vec!["big".into()]);
    // The image of the first frame shows how long an image takes.
    while farm.tasks_of(1) != [(2, 0, Image, 0)] {
        let held = farm.first_lease_of(1);
        let seconds = 0.1;
        farm.wait(100);
        let made = if held.task.stage.kind == Render { Role::Tile } else { Role::Image };
        farm.complete_with(1, &held, TaskResult { seconds, ..result_with(&held, &[made]) });
    }
    farm.join(2);
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, panic_failure());
    assert_eq!(farm.tasks_of(1), [(2, 0, Image, 0)], "no other may take it");
    for _ in 0..8 {
        farm.wait(500);
        farm.heartbeat(1, Phase::Working, 0);
        farm.heartbeat(2, Phase::Working, 0);
        assert_eq!(farm.tasks_of(2), []);
    }
    complete_first(&mut farm, 1);
    assert_eq!(farm.state(id), JobState::Done);
}
