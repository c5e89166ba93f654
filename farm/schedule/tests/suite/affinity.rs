//! Tests of scene affinity.

use crate::common;
use crate::common::{TestFarm, config, job, registration};
use femc_model::*;
use femc_schedule::*;

use Decision::{Continue, Done};

/// Creates a farm whose workers hold one task at a time.
fn farm() -> TestFarm {
    TestFarm::with_config(Config { prefetch: 0, ..config() })
}

/// Completes worker 1's task after half a second; returns the job and the frame of the task.
fn complete_first(farm: &mut TestFarm) -> (u64, u32) {
    let held = farm.first_lease_of(1);
    farm.wait(500);
    farm.complete(1, &held, Done);
    (held.task.job.0, held.task.stage.frame)
}

/// Counts how often a worker that keeps the latest two frames must prepare a frame.
fn count_preparations(frames: &[(u64, u32)]) -> usize {
    let (mut kept, mut count) = (Vec::new(), 0);
    for frame in frames {
        count += usize::from(!kept.contains(frame));
        kept.retain(|other| other != frame);
        kept.push(*frame);
        let surplus = kept.len().saturating_sub(2);
        kept.drain(..surplus);
    }
    count
}

#[test]
fn worker_keeps_ready_frames_for_30_s_and_owners_get_shares() {
    let mut farm = farm();
    for owner in ["ann", "bob", "cyd"] {
        farm.submit(JobSpec { owner: owner.into(), ..job(&[1], 500, &[4]) });
    }
    farm.join(1);
    let done: Vec<(u64, u32)> = (0..600).map(|_| complete_first(&mut farm)).collect();
    // 300 s in all; the worker changes the job at the earliest after 32 s out of turn.
    assert!((3..=20).contains(&count_preparations(&done)), "{} preparations", count_preparations(&done));
    for job in 1..=3 {
        let share = done.iter().filter(|(other, _)| *other == job).count() as f64 / 600.0;
        assert!((share - 1.0 / 3.0).abs() < 0.08, "job {job} has {share}");
    }
}

#[test]
fn worker_with_a_finished_frame_continues_with_a_loaded_scene() {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..Config::default() });
    for owner in ["ann", "bob", "cyd"] {
        farm.submit(JobSpec { owner: owner.into(), ..job(&(1..=200).collect::<Vec<_>>(), 1, &[4]) });
    }
    farm.join(1);
    let mut scenes = Vec::new();
    while scenes.len() < 120 {
        let held = farm.first_lease_of(1);
        if held.task.stage.kind == StageKind::Render {
            scenes.push((held.task.job.0, 0));
        }
        farm.wait(500);
        farm.complete(1, &held, Done);
    }
    // In turn, there would be 120 preparations.
    assert!(count_preparations(&scenes) <= 40, "{} of {scenes:?}", count_preparations(&scenes));
}

#[test]
fn scene_that_is_paused_or_failed_here_is_not_at_hand() {
    for is_paused in [true, false] {
        let mut farm = farm();
        let first = farm.submit(JobSpec { owner: "ann".into(), ..job(&[1], 12, &[4]) });
        farm.join(1);
        farm.join(2);
        assert_eq!(complete_first(&mut farm), (1, 1));
        farm.submit(JobSpec { owner: "bob".into(), ..job(&[1], 9, &[4]) });
        match is_paused {
            true => {
                farm.control(first, Control::Pause);
                assert_eq!(complete_first(&mut farm), (1, 1), "what it has it may end");
            }
            false => (0..3).for_each(|_| {
                let held = farm.first_lease_of(1);
                if held.task.job == first {
                    farm.fail(1, &held, common::panic_failure());
                }
            }),
        }
        assert_eq!((0..4).map(|_| complete_first(&mut farm).0).collect::<Vec<_>>(), [2; 4], "paused: {is_paused}");
    }
}

#[test]
fn two_frames_that_are_both_ready_are_served_in_turn() {
    let mut farm = farm();
    for owner in ["ann", "bob"] {
        farm.submit(JobSpec { owner: owner.into(), ..job(&[1], 200, &[4]) });
    }
    farm.join(1);
    let done: Vec<(u64, u32)> = (0..220).map(|_| complete_first(&mut farm)).collect();
    let late = &done[200..];
    assert_eq!(late.iter().filter(|(job, _)| *job == 1).count(), 10, "{late:?}");
    assert_eq!(count_preparations(&done), 2);
}

#[test]
fn a_job_of_more_priority_goes_first_whatever_is_ready() {
    let mut farm = farm();
    farm.submit(job(&[1], 100, &[4]));
    farm.join(1);
    complete_first(&mut farm);
    complete_first(&mut farm);
    farm.submit(JobSpec { priority: 60, ..job(&[1], 100, &[4]) });
    complete_first(&mut farm);
    assert_eq!((0..5).map(|_| complete_first(&mut farm).0).collect::<Vec<_>>(), [2; 5]);
}

#[test]
fn new_round_does_not_call_a_worker_away_from_its_frame() {
    let mut farm = farm();
    farm.submit(job(&(1..=12).collect::<Vec<_>>(), 6, &[4, 8, 12, 16]));
    (1..=4).for_each(|worker| drop(farm.join(worker)));
    // While a frame is merged, the workers begin the next frame; then there are tiles of the first one's next round.
    let mut frames = Vec::new();
    while let Some((worker, held)) = farm.leases.first().cloned() {
        farm.wait(500);
        if held.task.stage.kind == StageKind::Render {
            frames.push((worker.0, held.task.stage.frame));
        }
        farm.complete(worker.0, &held, Continue);
    }
    assert_eq!(frames.len(), 12 * 6 * 4, "{frames:?}");
    let frames_of = |worker| frames.iter().filter(|(other, _)| *other == worker).copied().collect::<Vec<_>>();
    let sum: usize = (1..=4).map(|worker| count_preparations(&frames_of(worker))).sum();
    // In the order of frames alone, there would be 92 preparations.
    assert!(sum <= 70, "{sum} preparations: {frames:?}");
}

#[test]
fn what_a_worker_may_not_take_is_not_at_hand() {
    let mut farm = farm();
    farm.submit(JobSpec { owner: "ann".into(), tags: vec!["lab".into()], ..job(&[1], 9, &[4]) });
    farm.submit(JobSpec { owner: "bob".into(), ..job(&[1], 9, &[4]) });
    farm.join_as(1, Registration { instance: 1, ..registration() });
    assert_eq!((0..9).map(|_| complete_first(&mut farm).0).collect::<Vec<_>>(), [2; 9]);
    farm.control(JobId(2), Control::Pause);
    assert_eq!(farm.tasks_of(1).len(), 1, "the merge that it has");
    complete_first(&mut farm);
    assert_eq!(farm.tasks_of(1), []);
}
