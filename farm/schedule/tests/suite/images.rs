//! Tests of lost images, of results that do not fit the store, and of a store that keeps failing.

use crate::common;
use crate::common::{TestFarm, job, registration, result_of};
use femc_model::*;
use femc_schedule::*;

use Decision::{Continue, Done};
use StageKind::{Image, Render};

/// Creates a farm with a worker, and a finished job of two frames.
fn finished_farm() -> (TestFarm, JobId) {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2], 1, &[4]));
    farm.join(1);
    while farm.state(id) != JobState::Done {
        farm.complete_first(1, Done);
    }
    (farm, id)
}

fn image_digest(farm: &TestFarm, id: JobId, frame: u32) -> Digest {
    let frames = farm.scheduler.frames(id).unwrap();
    frames.iter().find(|record| record.frame == frame).expect("it is finished").image().expect("an image").digest
}

fn restarted_frames(commands: &[Command]) -> Vec<(JobId, u32)> {
    let restarted = |command: &Command| match command {
        Command::Record(Fact::Restarted { job, frame }) => Some((*job, *frame)),
        _ => None,
    };
    commands.iter().filter_map(restarted).collect()
}

#[test]
fn finished_frame_with_lost_image_is_rendered_again_with_reason() {
    let (mut farm, id) = finished_farm();
    let (lost, before) = (image_digest(&farm, id, 2), farm.scheduler.frames(id).unwrap());
    farm.leave(1);
    let commands = farm.handle(Event::ArtifactLost { digest: lost });
    assert_eq!(restarted_frames(&commands), [(id, 2)]);
    assert!(commands.contains(&Command::JobChanged(id)), "watchers are notified");
    let status = farm.status(id);
    assert_eq!((status.state, status.frames_done, status.frames_failed), (JobState::Running, 1, 0));
    assert!(status.waits.contains(&WaitReason::ImageLost { frame: 2 }), "{:?}", status.waits);
    assert_eq!(farm.scheduler.frames(id).unwrap(), before[..1], "nobody is sent for it again");
    // A second report of the same loss changes nothing.
    assert_eq!(restarted_frames(&farm.handle(Event::ArtifactLost { digest: lost })), []);

    farm.restart();
    let snapshot = Ledger::decode(&farm.scheduler.ledger().encode().unwrap());
    assert_eq!(snapshot.as_ref(), Ok(farm.scheduler.ledger()));
    assert!(farm.status(id).waits.contains(&WaitReason::ImageLost { frame: 2 }), "after a restart, too");
    farm.join(2);
    assert_eq!(farm.tasks_of(2), [(2, 0, Render, 0)], "and only that");
    while farm.state(id) != JobState::Done {
        farm.complete_first(2, Done);
    }
    let after = farm.scheduler.frames(id).unwrap();
    assert_eq!(
        after.iter().map(|record| record.image()).collect::<Vec<_>>(),
        before.iter().map(|r| r.image()).collect::<Vec<_>>()
    );
    assert_eq!(farm.status(id).waits, []);
    assert_eq!(after[1].busy_seconds, 2.0 * before[1].busy_seconds, "what it took before was taken");
    let samples = farm.status(id).samples_done;
    assert_eq!(samples, 2 * 4 * 64, "no sample counts twice");
}

#[test]
fn loss_of_anything_but_finished_images_changes_nothing() {
    let (mut farm, id) = finished_farm();
    let open = farm.submit(job(&[1], 2, &[4]));
    let held = farm.first_lease_of(1);
    farm.complete(1, &held, Done);
    let tile = result_of(&held, Done).output(Role::Tile).unwrap();
    for digest in [Digest::compute(b"nobody's"), Digest::compute(b"bundle"), tile.digest] {
        assert_eq!(
            restarted_frames(&farm.handle(Event::ArtifactLost { digest })),
            [],
            "an input is the business of the task that misses it"
        );
    }
    assert_eq!((farm.state(id), farm.state(open)), (JobState::Done, JobState::Running));
}

#[test]
fn lost_image_of_cancelled_job_is_unfinished_until_retried() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1, 2], 1, &[4]));
    farm.join(1);
    while farm.status(id).frames_done == 0 {
        farm.complete_first(1, Done);
    }
    farm.control(id, Control::Cancel);
    let lost = farm.scheduler.frames(id).unwrap()[0].image().unwrap().digest;
    farm.handle(Event::ArtifactLost { digest: lost });
    assert_eq!((farm.state(id), farm.status(id).frames_done), (JobState::Cancelled, 0));
    assert_eq!(farm.tasks_of(1), [], "it stays as it was");
    farm.control(id, Control::Retry);
    while farm.state(id) != JobState::Done {
        farm.complete_first(1, Done);
    }
    assert_eq!(farm.scheduler.frames(id).unwrap().len(), 2);
}

#[test]
fn job_done_again_is_kept_as_long_as_newly_ended_job() {
    let mut farm = TestFarm::with_config(Config { keep_ended: Some(60_000), ..common::config() });
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    farm.complete_first(1, Done);
    farm.complete_first(1, Done);
    farm.wait(50_000);
    let lost = image_digest(&farm, id, 1);
    farm.leave(1);
    farm.handle(Event::ArtifactLost { digest: lost });
    farm.wait(50_000);
    assert_eq!(farm.state(id), JobState::Running, "it is not forgotten while it runs");
    farm.join(2);
    farm.complete_first(2, Done);
    farm.complete_first(2, Done);
    farm.wait(50_000);
    assert_eq!(farm.state(id), JobState::Done);
    farm.wait(50_000);
    assert!(farm.scheduler.status(id, farm.now).is_err());
}

#[test]
fn a_time_budget_begins_again_with_the_frame() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4, 8]));
    farm.join(1);
    farm.complete_first(1, Done);
    farm.complete_first(1, Done);
    let lost = image_digest(&farm, id, 1);
    farm.leave(1);
    farm.handle(Event::ArtifactLost { digest: lost });
    farm.wait(1_000_000);
    farm.join(2);
    farm.wait(300);
    farm.complete_first(2, Continue);
    let merge = farm.first_lease_of(2);
    assert_eq!((merge.task.stage.kind, merge.spec.elapsed), (Image, 300), "from its first lease");
}

#[test]
fn result_too_large_for_store_fails_job_with_reason() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    farm.complete_first(1, Done);
    assert_eq!(farm.tasks_of(1), [(1, 0, Image, 0)]);
    let failure = Failure::TooLarge { limit: 1 << 30 };
    farm.fail(1, &farm.first_lease_of(1), failure.clone());
    let status = farm.status(id);
    assert_eq!((status.state, status.failure.clone()), (JobState::Failed, Some(failure)));
    assert!(status.failure.unwrap().to_string().contains("1073741824 bytes"));
    for _ in 0..100 {
        farm.wait(10_000);
        farm.heartbeat(1, Phase::Waiting, 0);
    }
    assert_eq!(farm.tasks_of(1), [], "it is not tried for ever");
    farm.control(id, Control::Retry);
    farm.complete_first(1, Done);
    assert_eq!(farm.state(id), JobState::Done, "on a store that takes more");
}

#[test]
fn a_store_that_keeps_failing_is_the_reason_that_a_task_waits() {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 2, &[4]));
    farm.join_as(1, registration());
    let message = |farm: &TestFarm| {
        let failure_wait = |wait: &WaitReason| match wait {
            WaitReason::InfrastructureFailures { tasks, message } => Some((*tasks, message.clone())),
            _ => None,
        };
        farm.status(id).waits.iter().find_map(failure_wait)
    };
    assert_eq!(message(&farm), None);
    for attempt in 0..10 {
        let held = farm.first_lease_of(1);
        farm.drop_lease(held.task, held.epoch);
        farm.handle(Event::ArtifactMissing {
            worker: WorkerId(1),
            task: held.task,
            epoch: held.epoch,
            artifact: Digest::compute(b"tile"),
            message: "artifact 12ab is damaged in the store".into(),
        });
        let (_, text) = message(&farm).expect("it says why");
        assert!(text.contains("artifact 12ab is damaged"), "{text}");
        for _ in 0..60 {
            farm.wait(2_000);
            farm.heartbeat(1, Phase::Working, attempt);
        }
        assert!(message(&farm).is_some(), "also while it is tried again");
    }
    while farm.state(id) != JobState::Done {
        farm.complete_first(1, Done);
    }
    assert_eq!(message(&farm), None);
}
