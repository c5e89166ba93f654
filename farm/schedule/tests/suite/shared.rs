//! Tests of shared jobs, which are done once for all frames and jobs with one content.

use crate::common::{TestFarm, config, job_with_graph, panic_failure, registration};
use femc_model::*;
use femc_schedule::*;

use StageKind::{Drill, Image};

/// Creates a job with two blocks and the field that reads them, shared by content, and an image per frame.
fn shared_job(owner: &str, frames: &[u32], content: u8) -> Box<JobSpec> {
    let drill = |tasks, makes| StageTemplate::new(Drill, Scope::Content, TaskSizes::even(tasks, 1), &[makes]);
    let image = StageTemplate::new(Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image]);
    let stages = vec![
        drill(2, Role::Numbers),
        drill(1, Role::Answer).with_input(0, Role::Numbers, Reach::All),
        image.with_input(1, Role::Answer, Reach::All).with_loop(2, 1),
    ];
    let contents = vec![(frames.len() as u32, Digest::compute(&[content]))];
    Box::new(JobSpec { owner: owner.into(), contents, ..job_with_graph(frames, 1, Graph { stages }) })
}

/// Completes the worker's oldest task after these milliseconds.
fn complete_first(farm: &mut TestFarm, worker: u64, milliseconds: u64) -> TaskKey {
    let held = farm.first_lease_of(worker);
    let (roles, decision): (&[Role], _) = match (held.task.stage.kind, held.task.stage.number) {
        (Image, _) => (&[Role::Image], Some(Decision::Done)),
        (StageKind::Reduce, _) => (&[Role::Sums], None),
        (_, 1) => (&[Role::Answer], None),
        _ => (&[Role::Numbers], None),
    };
    let output = |&role: &Role| Output {
        role,
        artifact: Artifact::from_bytes(format!("{} {}", role.name(), held.task).as_bytes()),
    };
    farm.wait(milliseconds);
    let seconds = milliseconds as f64 / 1000.0;
    let outputs = roles.iter().map(output).collect();
    farm.complete_with(worker, &held, TaskResult { outputs, decision, seconds, ..TaskResult::default() });
    held.task
}

fn farm(config: Config) -> TestFarm {
    TestFarm::with_config(Config { prefetch: 0, lease: 1 << 40, late: 1 << 40, ..config })
}

fn submit(farm: &mut TestFarm, spec: Box<JobSpec>) -> JobId {
    farm.submit(*spec)
}

fn task_of(farm: &TestFarm, worker: u64) -> Option<TaskKey> {
    farm.leases.iter().find(|(holder, _)| holder.0 == worker).map(|(_, held)| held.task)
}

fn charged(farm: &TestFarm) -> Vec<(String, u64)> {
    farm.scheduler.used_times().map(|(owner, used)| (owner.to_owned(), used.charged)).collect()
}

#[test]
fn it_is_done_once_for_two_jobs_and_again_for_another_content() {
    let mut farm = farm(config());
    let jobs =
        [("ann", 1), ("bob", 1), ("eve", 2)].map(|(owner, key)| submit(&mut farm, shared_job(owner, &[1, 2], key)));
    farm.join(1);
    let mut done = Vec::new();
    while task_of(&farm, 1).is_some() {
        done.push(complete_first(&mut farm, 1, 10));
    }
    assert!(jobs.iter().all(|&job| farm.state(job) == JobState::Done));
    let shared: Vec<JobId> = done.iter().map(|task| task.job).filter(|job| job.is_shared()).collect();
    assert_eq!((shared.len(), shared.iter().collect::<std::collections::BTreeSet<_>>().len()), (6, 2));
}

#[test]
fn last_waiting_job_stops_shared_work_and_results_remain() {
    let mut farm = farm(config());
    let (ann, bob) = (submit(&mut farm, shared_job("ann", &[1], 1)), submit(&mut farm, shared_job("bob", &[1], 1)));
    farm.join(1);
    assert!(task_of(&farm, 1).is_some_and(|task| task.job.is_shared()));
    complete_first(&mut farm, 1, 10);
    farm.control(ann, Control::Cancel);
    assert!(task_of(&farm, 1).is_some(), "bob waits for it");
    farm.control(bob, Control::Pause);
    assert_eq!(task_of(&farm, 1), None);
    let eve = submit(&mut farm, shared_job("eve", &[1], 1));
    let second = complete_first(&mut farm, 1, 10);
    assert_eq!((second.stage.number, second.index), (0, 1), "the first block is there");
    complete_first(&mut farm, 1, 10);
    complete_first(&mut farm, 1, 10);
    assert_eq!(farm.state(eve), JobState::Done);
}

#[test]
fn shared_time_is_split_by_weight_with_remainder_to_first_owner() {
    let mut farm = farm(Config { weights: [("bob".to_owned(), 3)].into(), ..config() });
    for (owner, frames) in [("ann", &[1][..]), ("bob", &[1]), ("bob", &[1, 2]), ("eve", &[1])] {
        submit(&mut farm, shared_job(owner, frames, 1));
    }
    farm.join(1);
    complete_first(&mut farm, 1, 13);
    // 13 ms with weights 1, 3, 1 give 2, 7, 2, and a remainder of 2 ms.
    assert_eq!(charged(&farm), [("ann".to_owned(), 4), ("bob".to_owned(), 7), ("eve".to_owned(), 2)]);
}

#[test]
fn failed_shared_task_blocks_all_dependents_until_one_retries() {
    for retry in [Control::Retry, Control::RetryFrames(vec![1])] {
        check_blocked_until(retry);
    }
}

fn check_blocked_until(retry: Control) {
    let mut farm = farm(config());
    let jobs =
        [("ann", &[1][..]), ("bob", &[1, 2])].map(|(owner, frames)| submit(&mut farm, shared_job(owner, frames, 1)));
    farm.join(1);
    let shared = task_of(&farm, 1).unwrap().job;
    while let Some(task) = task_of(&farm, 1) {
        assert_eq!(task.job, shared);
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, panic_failure());
    }
    for (job, frames) in jobs.into_iter().zip([1, 2]) {
        let status = farm.status(job);
        assert_eq!((status.state, status.frames_failed), (JobState::Failed, frames));
        assert_eq!(status.waits, [WaitReason::SharedQuarantined { shared, frames, tasks: 2 }]);
        assert!(status.quarantined.iter().all(|one| one.task.job == shared));
    }
    farm.control(jobs[0], retry);
    while task_of(&farm, 1).is_some() {
        complete_first(&mut farm, 1, 10);
    }
    assert!(jobs.iter().all(|&job| farm.state(job) == JobState::Done));
}

#[test]
fn each_build_makes_shared_results_for_its_own_frames_only() {
    let mut farm = farm(config());
    let id = submit(&mut farm, shared_job("ann", &[1, 2], 1));
    let join = |farm: &mut TestFarm, worker: u64, engine: &str| {
        farm.join_as(worker, Registration { instance: worker, engine: engine.into(), ..registration() })
    };
    join(&mut farm, 1, "old");
    let old = task_of(&farm, 1).unwrap().job;
    for _ in 0..3 {
        complete_first(&mut farm, 1, 10);
    }
    assert_eq!(task_of(&farm, 1).map(|task| (task.job, task.stage.frame)), Some((id, 1)));
    join(&mut farm, 2, "new");
    let new = task_of(&farm, 2).unwrap().job;
    assert!(new.is_shared() && new != old);
    for _ in 0..3 {
        complete_first(&mut farm, 2, 10);
    }
    let inputs: Vec<Digest> =
        [1, 2].map(|worker| farm.first_lease_of(worker).spec.inputs[0].output.artifact.digest).to_vec();
    assert_ne!(inputs[0], inputs[1]);
}

#[test]
fn restarted_frame_is_blocked_by_shared_failure_of_new_build() {
    let mut farm = farm(config());
    let mut spec = shared_job("ann", &[1, 2], 1);
    let pair = StageTemplate::new(Drill, Scope::Frame, TaskSizes::even(2, 1), &[Role::Numbers]).with_input(
        1,
        Role::Answer,
        Reach::All,
    );
    let image = StageTemplate::new(Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image]);
    spec.graph.stages.splice(2.., [pair, image.with_input(2, Role::Numbers, Reach::All).with_loop(3, 1)]);
    let id = submit(&mut farm, spec);
    let join = |farm: &mut TestFarm, worker: u64, engine: &str| {
        farm.join_as(worker, Registration { instance: worker, engine: engine.into(), ..registration() })
    };
    join(&mut farm, 1, "old");
    for _ in 0..4 {
        complete_first(&mut farm, 1, 10);
    }
    join(&mut farm, 2, "new");
    while task_of(&farm, 2).is_some() {
        let held = farm.first_lease_of(2);
        assert!(held.task.job.is_shared());
        farm.fail(2, &held, panic_failure());
    }
    assert_eq!(farm.status(id).frames_failed, 1, "frame 1 is of the old build, which has done it");
    farm.leave(1);
    for _ in 0..2 * config().orphaned_after / 1_000 {
        farm.wait(1_000);
        farm.heartbeat(2, Phase::Working, 0);
    }
    assert_eq!(farm.state(id), JobState::Failed);
}

#[test]
fn what_a_drained_build_has_begun_is_begun_again_by_another() {
    let mut farm = farm(config());
    submit(&mut farm, shared_job("ann", &[1], 1));
    let join = |farm: &mut TestFarm, worker: u64, engine: &str| {
        farm.join_as(worker, Registration { instance: worker, engine: engine.into(), ..registration() })
    };
    join(&mut farm, 1, "old");
    let old = task_of(&farm, 1).unwrap().job;
    complete_first(&mut farm, 1, 10);
    join(&mut farm, 2, "new");
    assert_eq!(task_of(&farm, 2), None, "the old build is at it");
    farm.handle(Event::Drained { worker: WorkerId(1), drain: Drain::Begin });
    complete_first(&mut farm, 1, 10);
    assert!(task_of(&farm, 2).is_some_and(|task| task.job.is_shared() && task.job != old));
}

#[test]
fn frame_keeps_its_build_though_another_began_shared_work() {
    let mut farm = farm(Config { shared_bytes: 0, ..config() });
    let spec = |owner: &str| {
        let mut spec = shared_job(owner, &[1], 1);
        let pair = StageTemplate::new(Drill, Scope::Frame, TaskSizes::even(2, 1), &[Role::Numbers]).with_input(
            1,
            Role::Answer,
            Reach::All,
        );
        let image = StageTemplate::new(Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image]);
        spec.graph.stages.splice(2.., [pair, image.with_input(2, Role::Numbers, Reach::All).with_loop(3, 1)]);
        spec
    };
    let join = |farm: &mut TestFarm, worker: u64, engine: &str| {
        farm.join_as(worker, Registration { instance: worker, engine: engine.into(), ..registration() })
    };
    let ann = submit(&mut farm, spec("ann"));
    join(&mut farm, 1, "old");
    for _ in 0..4 {
        complete_first(&mut farm, 1, 10);
    }
    while task_of(&farm, 1).is_some() {
        let held = farm.first_lease_of(1);
        farm.fail(1, &held, panic_failure());
    }
    assert_eq!(farm.state(ann), JobState::Failed, "half of the frame is done");
    // A shared job that no job needs any more is removed.
    for _ in 0..3 {
        farm.wait(1_000);
        farm.heartbeat(1, Phase::Working, 0);
    }
    farm.handle(Event::Drained { worker: WorkerId(1), drain: Drain::Begin });
    let bob = submit(&mut farm, spec("bob"));
    join(&mut farm, 2, "new");
    complete_first(&mut farm, 2, 10);
    assert!(task_of(&farm, 2).is_some_and(|task| task.job.is_shared()));
    farm.control(bob, Control::Cancel);
    farm.handle(Event::Drained { worker: WorkerId(1), drain: Drain::Undo });
    farm.control(ann, Control::Retry);
    assert_eq!(task_of(&farm, 2), None, "the frame is of the old build");
    assert!(task_of(&farm, 1).is_some_and(|task| task.job.is_shared()), "{:?}", farm.status(ann).waits);
    for _ in 0..5 {
        complete_first(&mut farm, 1, 10);
    }
    assert_eq!(farm.state(ann), JobState::Done);
}

#[test]
fn unneeded_shared_results_are_dropped_only_over_byte_limit() {
    for (shared_bytes, is_kept) in [(1 << 20, true), (0, false)] {
        let mut farm = farm(Config { shared_bytes, ..config() });
        submit(&mut farm, shared_job("ann", &[1], 1));
        farm.join(1);
        for _ in 0..4 {
            complete_first(&mut farm, 1, 10);
        }
        farm.wait(10_000);
        let later = submit(&mut farm, shared_job("bob", &[1], 1));
        assert_eq!(task_of(&farm, 1).map(|task| task.job) == Some(later), is_kept);
    }
}

#[test]
fn workers_that_fit_one_of_those_who_wait_do_it() {
    let mut farm = farm(config());
    let tagged = |owner: &str, tag: &str| Box::new(JobSpec { tags: vec![tag.into()], ..*shared_job(owner, &[1], 1) });
    submit(&mut farm, tagged("ann", "large"));
    farm.join(1);
    assert_eq!(task_of(&farm, 1), None);
    submit(&mut farm, tagged("bob", "small"));
    farm.join_with(2, vec!["small".into()]);
    assert!(task_of(&farm, 2).is_some_and(|task| task.job.is_shared()));
    assert_eq!(task_of(&farm, 1), None);
}

#[test]
fn fatal_shared_failure_revokes_leases_of_dependents() {
    let mut farm = farm(config());
    let id = submit(&mut farm, shared_job("ann", &[1, 2], 1));
    farm.join(1);
    for _ in 0..3 {
        complete_first(&mut farm, 1, 10);
    }
    farm.join(2);
    assert_eq!([1, 2].map(|worker| task_of(&farm, worker).map(|task| task.stage.frame)), [Some(1), Some(2)]);
    let first = farm.first_lease_of(1);
    let digests = vec![first.spec.inputs[0].output.artifact.digest];
    farm.fail(1, &first, Failure::LostInputs { digests, message: "gone".into() });
    let again = farm.first_lease_of(1);
    assert!(again.task.job.is_shared());
    farm.fail(1, &again, Failure::Scene { message: "no camera".into() });
    assert_eq!((farm.state(id), task_of(&farm, 1), task_of(&farm, 2)), (JobState::Failed, None, None));
    assert_eq!(farm.scheduler.affected_jobs(again.task.job), [id, again.task.job], "who watches the job hears of it");
    assert_eq!(farm.scheduler.affected_jobs(id), [id]);
}

#[test]
fn job_result_with_gaps_is_remade_after_another_jobs_retry() {
    for is_made in [true, false] {
        let mut farm = farm(config());
        let spec = |owner: &str, frames: &[u32]| {
            let mut spec = shared_job(owner, frames, 1);
            let sheet = StageTemplate::new(StageKind::Reduce, Scope::Job, TaskSizes::even(1, 1), &[Role::Sums]);
            let images = Need { stage: 2, role: Role::Image, reach: Reach::All, round: Round::Same, gaps: true };
            spec.graph.stages.push(sheet.with_need(images));
            spec.contents = (1..).zip(frames).map(|(end, &frame)| (end, Digest::compute(&[frame as u8]))).collect();
            spec
        };
        let ann = submit(&mut farm, spec("ann", &[1, 2]));
        farm.join(1);
        while task_of(&farm, 1).is_some_and(|task| task.stage.frame != Stage::JOB_FRAME || task.job.is_shared()) {
            let held = farm.first_lease_of(1);
            let is_of_second = farm.scheduler.spec(held.task.job).unwrap().frames == [2];
            if is_of_second {
                farm.fail(1, &held, panic_failure());
            } else {
                complete_first(&mut farm, 1, 10);
            }
        }
        let sheet = farm.first_lease_of(1);
        assert_eq!((sheet.task.job, sheet.spec.inputs.len()), (ann, 1), "frame 2 is blocked");
        if is_made {
            complete_first(&mut farm, 1, 10);
            assert_eq!(farm.state(ann), JobState::Failed);
        }
        submit(&mut farm, spec("bob", &[2]));
        assert_eq!(farm.revoked.len(), usize::from(!is_made), "what is made with a gap is of no use");
        let mut inputs = Vec::new();
        while let Some(task) = task_of(&farm, 1) {
            if (task.job, task.stage.frame) == (ann, Stage::JOB_FRAME) {
                inputs.push(farm.first_lease_of(1).spec.inputs.len());
            }
            complete_first(&mut farm, 1, 10);
        }
        assert_eq!((farm.state(ann), inputs), (JobState::Done, vec![2]));
        assert_eq!(&farm.replay(), farm.scheduler.ledger());
    }
}

#[test]
fn failed_task_avoids_worker_only_if_another_fits_waiting_job() {
    for tags_of_frames in [false, true] {
        let mut farm = farm(config());
        let tagged = |owner: &str, tag: &str| {
            let mut spec = shared_job(owner, &[1], 1);
            let tags = if tags_of_frames { &mut spec.graph.stages[2].tags } else { &mut spec.tags };
            tags.push(tag.into());
            spec
        };
        let ann = submit(&mut farm, tagged("ann", "a"));
        farm.join_with(2, vec!["a".into()]);
        assert!(task_of(&farm, 2).is_some_and(|task| task.job.is_shared()));
        farm.control(ann, Control::Cancel);
        let bob = submit(&mut farm, tagged("bob", "b"));
        farm.join_with(1, vec!["b".into()]);
        let first = farm.first_lease_of(1);
        farm.fail(1, &first, panic_failure());
        assert_eq!(task_of(&farm, 1), Some(first.task), "nobody else is dealt what bob waits for");
        while task_of(&farm, 1).is_some() {
            complete_first(&mut farm, 1, 10);
        }
        assert_eq!((farm.state(bob), task_of(&farm, 2)), (JobState::Done, None));
    }
}

fn join_as(farm: &mut TestFarm, worker: u64, engine: &str, tags: &[&str]) {
    let tags = tags.iter().map(|&tag| tag.to_owned()).collect();
    farm.join_as(worker, Registration { instance: worker, engine: engine.into(), tags, ..registration() });
}

fn is_forgotten(farm: &TestFarm, shared: JobId) -> bool {
    farm.log.iter().any(|(_, fact)| *fact == Fact::JobRemoved { job: shared })
}

/// Lets time pass while these workers send heartbeats once a second.
fn wait_with_heartbeats(farm: &mut TestFarm, workers: &[u64], milliseconds: u64) {
    for _ in 0..milliseconds / 1_000 {
        workers.iter().for_each(|&worker| drop(farm.heartbeat(worker, Phase::Working, 0)));
        farm.wait(1_000);
    }
}

#[test]
fn another_build_begins_what_no_worker_left_has_the_tags_for() {
    let lab = || vec!["lab".to_owned()];
    let of_job = Box::new(JobSpec { tags: lab(), ..*shared_job("ann", &[1], 1) });
    let [mut of_frames, mut of_content] = [shared_job("ann", &[1], 1), shared_job("ann", &[1], 1)];
    of_frames.graph.stages[2].tags = lab();
    of_content.graph.stages[1].tags = lab();
    for (spec, tags) in [(of_job, &["lab"][..]), (of_frames, &["lab"]), (of_content, &[])] {
        let mut farm = farm(config());
        let id = submit(&mut farm, spec);
        join_as(&mut farm, 1, "old", tags);
        let old = task_of(&farm, 1).unwrap().job;
        for _ in 0..2 {
            complete_first(&mut farm, 1, 10);
        }
        join_as(&mut farm, 2, "old", &[]);
        farm.leave(1);
        assert_eq!(task_of(&farm, 2), None, "it lacks the tag for what comes next");
        join_as(&mut farm, 3, "new", &["lab"]);
        assert!(task_of(&farm, 3).is_some_and(|task| task.job.is_shared() && task.job != old));
        while task_of(&farm, 3).is_some() {
            complete_first(&mut farm, 3, 10);
        }
        assert_eq!(farm.state(id), JobState::Done);
    }
}

#[test]
fn shared_work_expires_when_no_fitting_worker_of_build_is_left() {
    let orphaned = config().orphaned_after;
    let mut farm = farm(config());
    submit(&mut farm, Box::new(JobSpec { tags: vec!["lab".into()], ..*shared_job("ann", &[1], 1) }));
    join_as(&mut farm, 1, "e", &["lab"]);
    join_as(&mut farm, 2, "e", &[]);
    complete_first(&mut farm, 1, 10);
    let shared = task_of(&farm, 1).unwrap().job;
    wait_with_heartbeats(&mut farm, &[1, 2], 2 * orphaned);
    // A short loss of the connection does no harm.
    farm.leave(1);
    wait_with_heartbeats(&mut farm, &[2], orphaned / 2);
    join_as(&mut farm, 3, "e", &["lab"]);
    assert_eq!(task_of(&farm, 3).map(|task| (task.job, task.index)), Some((shared, 1)));
    farm.leave(3);
    wait_with_heartbeats(&mut farm, &[2], orphaned / 2);
    assert!(!is_forgotten(&farm, shared));
    wait_with_heartbeats(&mut farm, &[2], orphaned);
    assert!(is_forgotten(&farm, shared));
}

#[test]
fn unneeded_shared_work_is_evicted_oldest_first_even_if_begun() {
    // There is room for two contents.
    let mut farm = farm(Config { shared_bytes: Config::SHARED_OVERHEAD * 5 / 2, ..config() });
    farm.join(1);
    let begin = |farm: &mut TestFarm, content: u8| {
        let id = submit(farm, shared_job("ann", &[1], content));
        farm.wait(1_000);
        (id, task_of(farm, 1).expect("a lease").job)
    };
    let (needed, first) = begin(&mut farm, 1);
    let mut begun = vec![first];
    farm.control(needed, Control::Pause);
    for content in 2..=5 {
        let (id, shared) = begin(&mut farm, content);
        if content == 3 {
            for _ in 0..4 {
                complete_first(&mut farm, 1, 10);
            }
        } else {
            complete_first(&mut farm, 1, 10);
            farm.control(id, Control::Cancel);
        }
        begun.push(shared);
        wait_with_heartbeats(&mut farm, &[1], 2_000);
    }
    let forgotten: Vec<bool> = begun.iter().map(|&shared| is_forgotten(&farm, shared)).collect();
    assert_eq!(forgotten, [false, true, true, false, false], "the first is needed by a job that is held");
    farm.control(needed, Control::Resume);
    while task_of(&farm, 1).is_some() {
        complete_first(&mut farm, 1, 10);
    }
    assert_eq!(farm.state(needed), JobState::Done);
    wait_with_heartbeats(&mut farm, &[1], 2_000);
    let forgotten: Vec<bool> = begun.iter().map(|&shared| is_forgotten(&farm, shared)).collect();
    assert_eq!(forgotten, [false, true, true, true, false], "what was done last is the latest");
}
