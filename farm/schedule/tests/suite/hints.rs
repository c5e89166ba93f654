//! Tests of hints: outputs of the previous frame that tasks may read.

use crate::common::{Farm, config, of, registration};
use femc_model::*;
use femc_schedule::*;

/// Creates a job with three drill tasks per frame, each of which has the drill of its number in the previous frame as a hint, and
/// an answer made from all of them.
fn job(frames: &[u32]) -> JobSpec {
    let drill = |tasks, makes: &[Role]| Template::new(StageKind::Drill, Scope::Frame, Sizes::even(tasks, 1), makes);
    let blocks = drill(3, &[Role::Numbers]).looks_at(0, Role::Numbers, Reach::Same);
    of(frames, 3, Graph { stages: vec![blocks, drill(1, &[Role::Answer]).reads(0, Role::Numbers, Reach::All)] })
}

fn farm() -> Farm {
    Farm::with(Config { prefetch: 0, ..config() })
}

fn made(task: &TaskKey) -> Artifact {
    Artifact::of(format!("{} {task}", task.stage.number).as_bytes())
}

/// Completes the worker's oldest task and returns its key.
fn work(farm: &mut Farm, worker: u64) -> TaskKey {
    let held = farm.first_of(worker);
    let role = if held.task.stage.number == 0 { Role::Numbers } else { Role::Answer };
    let outputs = vec![Output { role, artifact: made(&held.task) }];
    farm.complete_with(worker, &held, TaskResult { outputs, ..TaskResult::default() });
    held.task
}

/// Returns the hints of the worker's oldest task: frame, task and artifact.
fn hints(farm: &Farm, worker: u64) -> Vec<(u32, u32, Artifact)> {
    let hints = farm.first_of(worker).work.hints;
    hints.iter().map(|hint| (hint.frame, hint.item, hint.output.artifact)).collect()
}

#[test]
fn tasks_read_existing_hints_of_previous_frame_without_waiting() {
    let mut farm = farm();
    farm.submit(job(&[3, 7]));
    for worker in 1..=4 {
        farm.join(worker);
    }
    assert_eq!(farm.first_of(4).task.stage.frame, 7, "nothing of frame 3 is done");
    assert_eq!(hints(&farm, 4), []);
    let second = farm.first_of(2).task;
    assert_eq!(work(&mut farm, 2), second);
    assert_eq!(farm.first_of(2).task.stage.frame, 7);
    assert_eq!(farm.first_of(2).task.index, second.index, "the worker has it at hand");
    assert_eq!(hints(&farm, 2), [(3, second.index, made(&second))]);
}

#[test]
fn hints_are_kept_until_next_frame_is_finished() {
    let mut farm = farm();
    let id = farm.submit(job(&[1, 2]));
    farm.join(1);
    let left = [(); 3].map(|()| made(&work(&mut farm, 1)).digest);
    work(&mut farm, 1);
    let kept = |farm: &Farm| left.iter().filter(|digest| farm.scheduler.ledger().references().contains(digest)).count();
    assert_eq!((farm.status(id).frames_done, kept(&farm)), (1, 3));
    farm.restart();
    farm.join(1);
    assert_eq!(hints(&farm, 1).len(), 1, "over a restart, too");
    for _ in 0..3 {
        work(&mut farm, 1);
    }
    assert_eq!(kept(&farm), 3);
    work(&mut farm, 1);
    assert_eq!((farm.state(id), kept(&farm)), (JobState::Done, 0));
    let own: Vec<Digest> = farm.scheduler.ledger().references().into_iter().collect();
    assert_eq!(own.len(), 3, "the scene and an answer of each frame: {own:?}");
    assert_eq!(&farm.replay(), farm.scheduler.ledger());
}

#[test]
fn hints_of_other_builds_and_restarted_frames_are_ignored() {
    let mut farm = farm();
    farm.submit(job(&[1, 2]));
    let join = |farm: &mut Farm, worker: u64, engine: &str| {
        farm.join_as(worker, Registration { instance: worker, engine: engine.into(), ..registration() })
    };
    join(&mut farm, 1, "old");
    let first = work(&mut farm, 1);
    join(&mut farm, 2, "new");
    assert_eq!((farm.first_of(2).task.stage.frame, hints(&farm, 2)), (2, vec![]));
    assert!(farm.scheduler.ledger().references().contains(&made(&first).digest));
    farm.leave(1);
    for _ in 0..2 * config().orphaned / 1_000 {
        farm.wait(1_000);
        farm.heartbeat(2, Phase::Working, 0);
    }
    assert!(!farm.scheduler.ledger().references().contains(&made(&first).digest), "frame 1 begins anew");
}
