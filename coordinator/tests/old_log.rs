//! Logs that earlier versions wrote, read by this one.
//!
//! `data/log-1.sqlite` and `data/log-1-snapshot.sqlite` were written by the real coordinator of version 0.1.0 (tables of
//! version 1, facts and snapshots of version 1), with one worker of one thread, on the foggy box of `cli/tests/common`:
//!
//! ```text
//! femc submit fog.mgf --frames 1..3 --spp 4 --size 48x32
//! femc submit fog.mgf --frames 1 --error 0.02 --size 16x16 --owner bob
//! femc submit fog.mgf --frames 2..4 --spp 8 --tags gpu --priority 70
//! femc submit fog.mgf --frames 5 --spp 8 --tags gpu
//! femc pause 3; femc priority 3 90; femc cancel 4
//! femc worker --threads 1 --name lab      # until jobs 1 and 2 were done
//! ```
//!
//! Then both were stopped with SIGTERM. The second file is from a coordinator that made a snapshot after 12 records instead
//! of 20,000. `data/log-2.sqlite` and `data/log-2-snapshot.sqlite` (`--compact 12`) are of facts and snapshots of version 2,
//! with logs of tasks, a drained worker and a fifth job, of whose four tiles a worker had done one when it was killed:
//!
//! ```text
//! femc submit fog.mgf --frames 6 --spp 4096 --tags slow --owner ann
//! ```
//!
//! A change of the format adds files and leaves these as they are.

use std::collections::BTreeSet;
use std::path::Path;

use femc_coordinator::{Artifacts, Config, Coordinator, Log};
use femc_model::{Artefact, Control, JobId, JobState, JobStatus, Registration, ToWorker, Work};
use femc_proto::Client;

#[tokio::test]
async fn a_log_of_version_1_is_read_and_gone_on_with() {
    holds_the_farm("log-1.sqlite", &[]).await;
}

#[tokio::test]
async fn a_snapshot_of_version_1_is_read_and_gone_on_with() {
    holds_the_farm("log-1-snapshot.sqlite", &[]).await;
}

#[tokio::test]
async fn a_log_of_version_2_is_read_and_gone_on_with() {
    holds_the_farm("log-2.sqlite", &[JobId(5)]).await;
}

#[tokio::test]
async fn a_snapshot_of_version_2_is_read_and_gone_on_with() {
    holds_the_farm("log-2-snapshot.sqlite", &[JobId(5)]).await;
}

/// - `begun`: the jobs of which a tile is done.
async fn holds_the_farm(name: &str, begun: &[JobId]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name), &path).unwrap();
    let config = Config { log: Log::Sqlite(path), artifacts: Artifacts::Memory, ..Config::default() };
    let farm = Coordinator::start(config.clone()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let (jobs, under_way): (Vec<_>, Vec<_>) =
        client.list().await.unwrap().into_iter().partition(|job| !begun.contains(&job.job));
    assert_eq!(under_way.len(), begun.len());
    for job in under_way {
        let progress = job.active[0];
        assert_eq!((job.state, progress.tiles_done, progress.tiles_total), (JobState::Running, 1, 4), "{job:?}");
        goes_on_with_whole_tiles(&client, &job).await;
    }
    let glance = |job: &JobStatus| {
        (job.job.0, job.owner.clone(), job.priority, job.state, job.frames_done, job.frames_total, job.samples_planned)
    };
    let expected = [
        (1, "ann".into(), 50, JobState::Done, 3, 3, 3 * 4 * 48 * 32),
        (2, "bob".into(), 50, JobState::Done, 1, 1, 65536 * 16 * 16),
        (3, "ann".into(), 90, JobState::Paused, 0, 3, 3 * 8 * 32 * 32),
        (4, "ann".into(), 50, JobState::Cancelled, 0, 1, 8 * 32 * 32),
    ];
    assert_eq!(jobs.iter().map(glance).collect::<Vec<_>>(), expected);
    assert!(jobs.iter().all(|job| job.failure.is_none() && job.quarantined.is_empty() && job.active.is_empty()));
    // What the frames' files say of their making differs from run to run; the pixels of a preview do not.
    let frames = client.frames(JobId(1)).await.unwrap();
    let found: Vec<_> = frames.iter().map(|frame| (frame.frame, frame.spp, name_of(frame.preview))).collect();
    let previews = ["6752fedc2f87", "9fe44b439997", "2ef8e35abbea"].map(String::from);
    assert_eq!(found, (1..=3).zip([4; 3]).zip(previews).map(|((frame, spp), it)| (frame, spp, it)).collect::<Vec<_>>());
    let frames = client.frames(JobId(2)).await.unwrap();
    let [frame] = &*frames else { panic!("one frame: {frames:?}") };
    assert_eq!(
        (frame.frame, frame.spp, frame.relative_error),
        (1, 128, Some(0.01707846293591875)),
        "after four rounds"
    );

    client.control(JobId(3), Control::Resume).await.unwrap();
    client.control(JobId(4), Control::Retry).await.unwrap();
    farm.stop().await.unwrap();
    let farm = Coordinator::start(config).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    let states: Vec<_> = client.list().await.unwrap().iter().map(|job| job.state).collect();
    assert_eq!(states[..4], [JobState::Done, JobState::Done, JobState::Queued, JobState::Queued]);
    farm.stop().await.unwrap();
}

/// A worker is given the tiles that are not done, each with all of its samples, however many: that version cut no tile.
async fn goes_on_with_whole_tiles(client: &Client, job: &JobStatus) {
    let registration = Registration {
        name: "slow".into(),
        instance: 1,
        engine: "0.1".into(),
        threads: 1,
        slots: 8,
        tags: vec!["slow".into()],
        held: vec![],
    };
    let (_out, mut incoming) = client.session(registration).await.unwrap();
    let mut leased = BTreeSet::new();
    while leased.len() < 3 {
        let Some(ToWorker::Assign(assignment)) = incoming.next().await.unwrap() else { continue };
        let Work::Render { tile, samples } = assignment.work else { panic!("no merge is due") };
        assert_eq!((assignment.task.job, assignment.task.index, samples), (job.job, tile, 0..4096));
        leased.insert(tile);
    }
}

/// The beginning of an artefact's name.
fn name_of(artefact: Option<Artefact>) -> String {
    artefact.map(|artefact| artefact.digest.to_string().chars().take(12).collect()).unwrap_or_default()
}
