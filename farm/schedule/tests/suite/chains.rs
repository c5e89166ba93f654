//! Tests of chains: tasks that each continue the previous one.

use crate::common::{TestFarm, config, job_with_graph};
use femc_model::*;
use femc_schedule::*;

/// Creates a job with one drill task per frame and a chain of as many tasks of the job. Each link reads its frame and the previous
/// link.
fn chain_job(frames: &[u32]) -> JobSpec {
    let drill =
        |scope, tasks, makes: &[Role]| StageTemplate::new(StageKind::Drill, scope, TaskSizes::even(tasks, 1), makes);
    let chain = drill(Scope::Job, frames.len() as u32, &[Role::Answer])
        .with_input(0, Role::Answer, Reach::Fan(1))
        .with_input(1, Role::Answer, Reach::Previous);
    let spec = job_with_graph(frames, 1, Graph { stages: vec![drill(Scope::Frame, 1, &[Role::Answer]), chain] });
    assert_eq!((check_graph(&spec.graph), check_graph_frames(&spec.graph, frames.len() as u64)), (Ok(()), Ok(())));
    spec
}

fn artifact_of(task: &TaskKey) -> Artifact {
    Artifact::from_bytes(task.to_string().as_bytes())
}

/// Completes the worker's oldest task and returns its key.
fn complete_first(farm: &mut TestFarm, worker: u64) -> TaskKey {
    let held = farm.first_lease_of(worker);
    let outputs = vec![Output { role: Role::Answer, artifact: artifact_of(&held.task) }];
    farm.complete_with(worker, &held, TaskResult { outputs, ..TaskResult::default() });
    held.task
}

#[test]
fn a_link_waits_for_the_one_before_and_reads_it() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let id = farm.submit(chain_job(&[3, 5, 7]));
    farm.join(1);
    farm.join(2);
    let (mut frames, mut links) = (Vec::new(), Vec::<TaskKey>::new());
    while farm.state(id) != JobState::Done {
        let held: Vec<Assignment> =
            [1, 2].into_iter().filter(|&it| !farm.tasks_of(it).is_empty()).map(|it| farm.first_lease_of(it)).collect();
        let of_chain: Vec<&Assignment> = held.iter().filter(|held| held.task.stage.number == 1).collect();
        assert!(of_chain.len() < 2, "two links of one chain are never done side by side");
        if let [link] = of_chain[..] {
            assert_eq!(link.task.index as usize, links.len());
            let frame: &TaskKey = &frames[links.len()];
            let wanted: Vec<Artifact> = [artifact_of(frame)].into_iter().chain(links.last().map(artifact_of)).collect();
            assert_eq!(link.spec.artifacts().collect::<Vec<_>>(), wanted, "link {}", links.len());
        }
        let worker = [2, 1].into_iter().find(|&it| !farm.tasks_of(it).is_empty()).expect("there is work");
        let done = complete_first(&mut farm, worker);
        if done.stage.number == 1 {
            links.push(done);
        } else {
            frames.push(done);
        }
        frames.sort_by_key(|task| task.stage.frame);
    }
    assert_eq!((frames.len(), links.len()), (3, 3));
    farm.restart();
    assert_eq!(farm.state(id), JobState::Done);
}

#[test]
fn link_lost_after_job_end_is_remade_with_chain_and_no_frame() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let id = farm.submit(chain_job(&[1, 2, 3]));
    farm.join(1);
    let tasks = [(); 6].map(|()| complete_first(&mut farm, 1));
    assert_eq!(farm.state(id), JobState::Done);
    let second = *tasks.iter().find(|task| (task.stage.number, task.index) == (1, 1)).expect("a link");
    farm.handle(Event::ArtifactLost { digest: artifact_of(&second).digest });
    let again = [(); 3].map(|()| complete_first(&mut farm, 1));
    assert!(again.iter().zip(0..).all(|(task, index)| (task.stage.number, task.index) == (1, index)), "{again:?}");
    assert_eq!(farm.state(id), JobState::Done);
}

#[test]
fn a_chain_of_a_frame_s_cut_tasks_or_over_frames_is_refused() {
    let drill = |scope, tasks| StageTemplate::new(StageKind::Drill, scope, TaskSizes::even(tasks, 1), &[Role::Answer]);
    let refused = |stages: Vec<StageTemplate>| check_graph(&Graph { stages }).is_err();
    let over = drill(Scope::Job, 3).with_input(0, Role::Answer, Reach::Previous);
    assert!(refused(vec![drill(Scope::Frame, 1), over]));
    let other = drill(Scope::Frame, 2).with_input(0, Role::Answer, Reach::Previous);
    assert!(refused(vec![drill(Scope::Frame, 3), other]), "of another length");
    let looped = drill(Scope::Frame, 1).with_input(0, Role::Answer, Reach::Previous).with_loop(0, 2);
    assert!(refused(vec![looped]));
    assert!(!refused(vec![drill(Scope::Frame, 3).with_input(0, Role::Answer, Reach::Previous)]));
}
