//! Tests of retries of single frames, which must not affect other frames.

use crate::common;
use crate::common::{TestFarm, job, panic_failure};
use femc_model::*;
use femc_schedule::*;

use Decision::Done;
use StageKind::Render;

/// Creates a job of four frames of which the first three have failed.
fn farm_with_failed_frames() -> (TestFarm, JobId) {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2, 3, 4], 1, &[4]));
    farm.join(1);
    run_to_end(&mut farm, id, &[1, 2, 3]);
    assert_eq!((farm.state(id), farm.status(id).frames_failed), (JobState::Failed, 3));
    (farm, id)
}

/// Works until the job has ended; tasks of these frames fail.
fn run_to_end(farm: &mut TestFarm, id: JobId, bad: &[u32]) {
    while !farm.state(id).has_ended() {
        let held = farm.first_lease_of(1);
        if bad.contains(&held.task.stage.frame) {
            farm.fail(1, &held, panic_failure());
        } else {
            farm.complete(1, &held, Done);
        }
    }
}

fn find_refusal(commands: &[Command]) -> Option<&Refusal> {
    commands.iter().find_map(|command| match command {
        Command::Answer { answer: Err(refusal), .. } => Some(refusal),
        _ => None,
    })
}

fn retry_frames(frames: &[u32]) -> Control {
    Control::RetryFrames(frames.to_vec())
}

#[test]
fn only_the_frames_that_are_named_are_tried_again() {
    let (mut farm, id) = farm_with_failed_frames();
    farm.control(id, retry_frames(&[3, 1, 3, 4]));
    let status = farm.status(id);
    assert_eq!((status.state, status.frames_failed, status.quarantined.len()), (JobState::Running, 1, 1));
    let mut given: Vec<u32> = farm.tasks_of(1).iter().map(|task| task.0).collect();
    given.sort_unstable();
    assert_eq!(given, [1, 3], "of what is finished and what is not named nothing is given out");
    run_to_end(&mut farm, id, &[]);
    let status = farm.status(id);
    assert_eq!((status.state, status.frames_done, status.frames_failed), (JobState::Failed, 3, 1));
    assert_eq!(status.waits, [WaitReason::Quarantined { frame: 2, tasks: 1 }]);
    // The same holds after a restart from a snapshot.
    farm.restart();
    let ledger = farm.scheduler.ledger();
    assert_eq!(Ledger::decode(&ledger.encode().unwrap()).as_ref(), Ok(ledger));
    farm.join(1);
    farm.control(id, retry_frames(&[2]));
    assert_eq!(farm.tasks_of(1), [(2, 0, Render, 0)]);
    run_to_end(&mut farm, id, &[]);
    assert_eq!((farm.state(id), farm.status(id).frames_done), (JobState::Done, 4));
}

#[test]
fn retried_frame_gets_as_many_attempts_as_first_time() {
    let (mut farm, id) = farm_with_failed_frames();
    farm.control(id, retry_frames(&[2]));
    run_to_end(&mut farm, id, &[2]);
    assert_eq!((farm.state(id), farm.status(id).frames_failed), (JobState::Failed, 3));
    let attempts = |frame| {
        let all = farm.status(id).quarantined;
        all.iter().find(|one| one.task.stage.frame == frame).expect("it is quarantined").attempts
    };
    assert_eq!([1, 2, 3].map(attempts), [3, 3, 3]);
}

#[test]
fn retry_of_unknown_frames_is_refused_and_changes_nothing() {
    let (mut farm, id) = farm_with_failed_frames();
    let before = farm.scheduler.ledger().clone();
    for (named, word) in [(&[][..], "at least one"), (&[1, 9], "frame 9"), (&[0], "frame 0")] {
        let commands = farm.control(id, retry_frames(named));
        let Some(Refusal::Invalid { field, message }) = find_refusal(&commands) else { panic!("{commands:?}") };
        assert!(field == "frames" && message.contains(word), "{message}");
    }
    assert_eq!(farm.scheduler.ledger(), &before);
    // A finished frame stays finished; this is not reported as an error.
    assert_eq!(find_refusal(&farm.control(id, retry_frames(&[4]))), None);
    assert_eq!(farm.scheduler.ledger(), &before);
}

#[test]
fn cancelled_or_done_job_refuses_retry_of_single_frames() {
    let (mut farm, id) = farm_with_failed_frames();
    farm.control(id, Control::Retry);
    farm.control(id, Control::Cancel);
    let commands = farm.control(id, retry_frames(&[1]));
    assert!(matches!(find_refusal(&commands), Some(Refusal::Invalid { message, .. }) if message.contains("cancelled")));
    assert_eq!(farm.state(id), JobState::Cancelled);
    farm.control(id, Control::Retry);
    run_to_end(&mut farm, id, &[]);
    assert_eq!(find_refusal(&farm.control(id, retry_frames(&[1]))), Some(&Refusal::Ended { job: id }));
}

#[test]
fn a_pause_stays_when_a_frame_is_tried_again() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..common::config() });
    let id = farm.submit(job(&[1, 2], 1, &[4]));
    farm.join(1);
    while farm.status(id).frames_failed == 0 {
        let held = farm.first_lease_of(1);
        match held.task.stage.frame {
            1 => drop(farm.fail(1, &held, panic_failure())),
            _ => break,
        }
    }
    assert_eq!(farm.status(id).frames_failed, 1);
    farm.control(id, Control::Pause);
    farm.control(id, retry_frames(&[1]));
    assert_eq!((farm.state(id), farm.status(id).frames_failed), (JobState::Paused, 0));
    farm.control(id, Control::Resume);
    run_to_end(&mut farm, id, &[]);
    assert_eq!(farm.state(id), JobState::Done);
}
