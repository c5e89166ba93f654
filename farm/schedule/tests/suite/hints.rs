//! Tests of hints: outputs of the previous frame that tasks may read.

use crate::common::{TestFarm, config, job_with_graph, registration};
use femc_model::*;
use femc_schedule::*;

/// Creates a job with three drill tasks per frame, each of which has the drill of its number in the previous frame as a hint, and
/// an answer made from all of them.
fn hint_job(frames: &[u32]) -> JobSpec {
    let drill =
        |tasks, makes: &[Role]| StageTemplate::new(StageKind::Drill, Scope::Frame, TaskSizes::even(tasks, 1), makes);
    let blocks = drill(3, &[Role::Numbers]).with_hint(0, Role::Numbers, Reach::Same);
    job_with_graph(
        frames,
        3,
        Graph { stages: vec![blocks, drill(1, &[Role::Answer]).with_input(0, Role::Numbers, Reach::All)] },
    )
}

fn farm() -> TestFarm {
    TestFarm::with_config(Config { prefetch: 0, ..config() })
}

fn artifact_of(task: &TaskKey) -> Artifact {
    Artifact::from_bytes(format!("{} {task}", task.stage.number).as_bytes())
}

/// Completes the worker's oldest task and returns its key.
fn complete_first(farm: &mut TestFarm, worker: u64) -> TaskKey {
    let held = farm.first_lease_of(worker);
    let role = if held.task.stage.number == 0 { Role::Numbers } else { Role::Answer };
    let outputs = vec![Output { role, artifact: artifact_of(&held.task) }];
    farm.complete_with(worker, &held, TaskResult { outputs, ..TaskResult::default() });
    held.task
}

/// Returns the hints of the worker's oldest task: frame, task and artifact.
fn hints_of(farm: &TestFarm, worker: u64) -> Vec<(u32, u32, Artifact)> {
    let hints = farm.first_lease_of(worker).spec.hints;
    hints.iter().map(|hint| (hint.frame, hint.item, hint.output.artifact)).collect()
}

#[test]
fn tasks_read_existing_hints_of_previous_frame_without_waiting() {
    let mut farm = farm();
    farm.submit(hint_job(&[3, 7]));
    for worker in 1..=4 {
        farm.join(worker);
    }
    assert_eq!(farm.first_lease_of(4).task.stage.frame, 7, "nothing of frame 3 is done");
    assert_eq!(hints_of(&farm, 4), []);
    let second = farm.first_lease_of(2).task;
    assert_eq!(complete_first(&mut farm, 2), second);
    assert_eq!(farm.first_lease_of(2).task.stage.frame, 7);
    assert_eq!(farm.first_lease_of(2).task.index, second.index, "the worker has it at hand");
    assert_eq!(hints_of(&farm, 2), [(3, second.index, artifact_of(&second))]);
}

#[test]
fn hints_are_kept_until_next_frame_is_finished() {
    let mut farm = farm();
    let id = farm.submit(hint_job(&[1, 2]));
    farm.join(1);
    let left = [(); 3].map(|()| artifact_of(&complete_first(&mut farm, 1)).digest);
    complete_first(&mut farm, 1);
    let kept =
        |farm: &TestFarm| left.iter().filter(|digest| farm.scheduler.ledger().references().contains(digest)).count();
    assert_eq!((farm.status(id).frames_done, kept(&farm)), (1, 3));
    farm.restart();
    farm.join(1);
    assert_eq!(hints_of(&farm, 1).len(), 1, "over a restart, too");
    for _ in 0..3 {
        complete_first(&mut farm, 1);
    }
    assert_eq!(kept(&farm), 3);
    complete_first(&mut farm, 1);
    assert_eq!((farm.state(id), kept(&farm)), (JobState::Done, 0));
    let own: Vec<Digest> = farm.scheduler.ledger().references().into_iter().collect();
    assert_eq!(own.len(), 3, "the scene and an answer of each frame: {own:?}");
    assert_eq!(&farm.replay(), farm.scheduler.ledger());
}

#[test]
fn hints_of_other_builds_and_restarted_frames_are_ignored() {
    let mut farm = farm();
    farm.submit(hint_job(&[1, 2]));
    let join = |farm: &mut TestFarm, worker: u64, engine: &str| {
        farm.join_as(worker, Registration { instance: worker, engine: engine.into(), ..registration() })
    };
    join(&mut farm, 1, "old");
    let first = complete_first(&mut farm, 1);
    join(&mut farm, 2, "new");
    assert_eq!((farm.first_lease_of(2).task.stage.frame, hints_of(&farm, 2)), (2, vec![]));
    assert!(farm.scheduler.ledger().references().contains(&artifact_of(&first).digest));
    farm.leave(1);
    for _ in 0..2 * config().orphaned_after / 1_000 {
        farm.wait(1_000);
        farm.heartbeat(2, Phase::Working, 0);
    }
    assert!(!farm.scheduler.ledger().references().contains(&artifact_of(&first).digest), "frame 1 begins anew");
}
