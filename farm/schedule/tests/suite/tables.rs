//! Tests of the tables of a job's frames and tasks.

use crate::common;
use crate::common::{TestFarm, job, panic_failure};
use femc_model::*;
use femc_schedule::{Answer, Config, Event, RequestId, Scheduler};

use Decision::Done;

fn page(farm: &TestFarm, id: JobId, filter: TaskFilter, from: u64, count: usize) -> TaskPage {
    farm.scheduler.tasks(id, filter, from, count, farm.now).expect("the job is there")
}

fn task_states(farm: &TestFarm, id: JobId) -> Vec<TaskState> {
    let all = page(farm, id, TaskFilter::default(), 0, 1000);
    assert_eq!(all.total, all.tasks.len() as u64);
    all.tasks.iter().map(|task| task.state).collect()
}

fn frame_states(farm: &TestFarm, id: JobId) -> Vec<TaskState> {
    farm.scheduler.frame_table(id).expect("the job is there").iter().map(|frame| frame.state).collect()
}

#[test]
fn tasks_wait_run_and_are_done_and_so_are_their_frames() {
    use TaskState::{Done as Finished, Queued, Running, Waiting};
    let mut farm = TestFarm::new();
    // Each frame has two tiles and an image.
    let id = farm.submit(job(&[1, 2], 2, &[4]));
    assert_eq!((task_states(&farm, id), frame_states(&farm, id)), (vec![Waiting; 6], vec![Waiting; 2]));
    farm.join(1);
    let held = farm.tasks_of(1).len();
    farm.wait(700);
    for state in [Queued, Running] {
        let now = page(&farm, id, TaskFilter { state: Some(state), ..TaskFilter::default() }, 0, 1000);
        assert_eq!((now.total, now.tasks.len()), (held as u64, held));
        assert!(now.tasks.iter().all(|task| task.workers == ["w"] && task.attempts == 1 && task.seconds == Some(0.7)));
        farm.heartbeat(1, Phase::Preparing, 0);
    }
    assert_eq!(frame_states(&farm, id)[0], Running);
    farm.complete_first(1, Done);
    assert_eq!(task_states(&farm, id)[0], Finished);
    while farm.state(id) != JobState::Done {
        farm.complete_first(1, Done);
    }
    assert_eq!((task_states(&farm, id), frame_states(&farm, id)), (vec![Finished; 6], vec![Finished; 2]));
    let table = farm.scheduler.frame_table(id).unwrap();
    assert!(table.iter().all(|frame| frame.progress.is_none() && frame.record.as_ref().unwrap().image().is_some()));
    farm.restart();
    assert_eq!(task_states(&farm, id), vec![Finished; 6], "after a restart, too");
}

#[test]
fn failed_task_reports_reason_and_last_attempt_fails_frame() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, panic_failure());
    let first = page(&farm, id, TaskFilter::default(), 0, 1).tasks.remove(0);
    assert_eq!((first.failure.clone(), first.task.stage.kind), (Some(panic_failure()), StageKind::Render));
    while farm.state(id) != JobState::Failed {
        if farm.tasks_of(1).is_empty() {
            farm.wait(60_000);
            farm.heartbeat(1, Phase::Waiting, 0);
        } else {
            let held = farm.first_lease_of(1);
            farm.fail(1, &held, panic_failure());
        }
    }
    assert_eq!((task_states(&farm, id)[0], frame_states(&farm, id)), (TaskState::Failed, vec![TaskState::Failed]));
    farm.control(id, Control::Retry);
    assert_eq!(page(&farm, id, TaskFilter { state: Some(TaskState::Failed), ..TaskFilter::default() }, 0, 9).total, 0);
}

#[test]
fn task_windows_are_slices_and_filters_count_their_matches() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2, 3, 4, 5], 7, &[4]));
    farm.join(1);
    (0..9).for_each(|_| drop(farm.complete_first(1, Done)));
    let all = page(&farm, id, TaskFilter::default(), 0, 1000);
    assert_eq!(all.total, 5 * (7 + 1));
    for from in [0, 1, 7, 8, 9, 31, 39, 40, 41, u64::MAX] {
        for count in [0, 1, 3, 8, 1000] {
            let window = page(&farm, id, TaskFilter::default(), from, count);
            let wanted: Vec<_> = all.tasks.iter().skip(from.min(1000) as usize).take(count).cloned().collect();
            assert_eq!((window.total, window.tasks), (all.total, wanted), "{count} from {from}");
        }
    }
    for frame in [None, Some(1), Some(4), Some(6)] {
        for stage in [None, Some(0), Some(1), Some(2)] {
            for state in [None, Some(TaskState::Done), Some(TaskState::Waiting)] {
                let fits = |task: &&TaskStatus| {
                    let task_stage = &task.task.stage;
                    frame.is_none_or(|only| only == task_stage.frame)
                        && stage.is_none_or(|only| only == task_stage.number)
                        && state.is_none_or(|only| only == task.state)
                };
                let wanted: Vec<_> = all.tasks.iter().filter(fits).cloned().collect();
                let found = page(&farm, id, TaskFilter { frame, stage, state }, 0, 1000);
                assert_eq!((found.total, found.tasks), (wanted.len() as u64, wanted), "{frame:?} {stage:?} {state:?}");
            }
        }
    }
    let nobody = farm.scheduler.tasks(JobId(99), TaskFilter::default(), 0, 1, farm.now);
    assert_eq!(nobody, Err(Refusal::NoSuchJob { job: JobId(99) }));
}

#[test]
fn submission_date_follows_farm_clock_if_its_date_is_known() {
    for (clock_zero, submitted) in [(None, None), (Some(1_000_000), Some(1_002_000))] {
        let mut farm = TestFarm::with_config(Config { clock_zero, ..common::config() });
        let begun = farm.now.0;
        farm.wait(2_000 - begun);
        let id = farm.submit(job(&[1], 1, &[4]));
        farm.wait(500);
        assert_eq!(farm.status(id).submitted, submitted);
        farm.restart();
        assert_eq!(farm.status(id).submitted, submitted, "a restart does not change it");
    }
}

#[test]
fn an_outage_does_not_move_the_calendar_date_of_a_submission() {
    let mut farm = TestFarm::new();
    let date = Some(1_795_680_000_000);
    let spec = Box::new(job(&[1], 1, &[4]));
    let commands = farm.handle(Event::Submitted { request: RequestId(7), key: None, spec, date });
    let Some(Answer::Submitted(id)) = common::find_answer(&commands) else { panic!("{commands:?}") };
    assert_eq!(farm.status(id).submitted_date, date);
    // The clock of the next coordinator begins an hour later.
    farm.restart();
    let ledger = farm.replay();
    let (scheduler, _) = Scheduler::new(Config { clock_zero: Some(3_600_000), ..common::config() }, ledger);
    farm.scheduler = scheduler;
    assert_eq!(farm.status(id).submitted_date, date);
    assert_ne!(farm.status(id).submitted, date);
}

/// Completes worker 1's tasks of frame `frame`, the image with this error, until it holds a task of another frame.
fn complete_frame_with_error(farm: &mut TestFarm, frame: u32, error: f64, decision: &Decision) {
    while farm.leases.iter().any(|(_, held)| held.task.stage.frame == frame) {
        let (_, held) =
            farm.leases.iter().find(|(_, held)| held.task.stage.frame == frame).cloned().expect("one is there");
        let result = common::result_of(&held, decision.clone());
        let is_measured = result.relative_error.is_some();
        let result = TaskResult { relative_error: is_measured.then_some(error), ..result };
        farm.complete_with(1, &held, result);
        if is_measured {
            return;
        }
    }
}

#[test]
fn job_error_is_of_worst_frame_not_of_last_measured() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2, 3], 1, &[4, 8]));
    farm.join(1);
    let worst_error = |farm: &TestFarm| {
        let status = farm.status(id);
        (status.relative_error, status.worst_frame.map(|worst| (worst.frame, worst.stop)))
    };
    assert_eq!(worst_error(&farm), (None, None));
    complete_frame_with_error(&mut farm, 1, 0.3, &Decision::Continue);
    assert_eq!(worst_error(&farm), (Some(0.3), Some((1, FrameStop::Rendering))), "after its first round");
    // Its second round is the last one.
    complete_frame_with_error(&mut farm, 1, 0.2, &Done);
    assert_eq!(worst_error(&farm), (Some(0.2), Some((1, FrameStop::Limit))));
    complete_frame_with_error(&mut farm, 2, 0.1, &Done);
    assert_eq!(worst_error(&farm), (Some(0.2), Some((1, FrameStop::Limit))), "a better frame was measured last");
    complete_frame_with_error(&mut farm, 3, 0.25, &Done);
    assert_eq!(
        worst_error(&farm),
        (Some(0.25), Some((3, FrameStop::Estimate))),
        "it ended after the first of two rounds"
    );
    assert_eq!(farm.state(id), JobState::Done);
    let rounds: Vec<_> = farm.scheduler.frames(id).expect("it is there").iter().map(|record| record.rounds).collect();
    assert_eq!(rounds, [Some(2), Some(1), Some(1)]);
    farm.restart();
    assert_eq!(worst_error(&farm).1, Some((3, FrameStop::Estimate)), "after a restart, too");
    let (ledger, now) = (farm.scheduler.ledger().encode().expect("a snapshot"), farm.now);
    let read = femc_schedule::Ledger::decode(&ledger).expect("the same version");
    assert_eq!(&read, farm.scheduler.ledger(), "at {now:?}");
}
