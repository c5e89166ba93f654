//! Tests of divided tiles: the sample chunks of a lease, and that every sample is counted once.

use std::num::NonZeroU64;

use crate::common::{TestFarm, config, job, panic_failure, result_in};
use femc_model::*;
use femc_schedule::*;

use Decision::Done;

/// Creates a farm in which tiles of 64 pixels and 64 samples have 64 sample chunks of one sample per pixel. The intended duration
/// of a task is 8 s, and 1.5 s at the end.
fn farm() -> TestFarm {
    TestFarm::with_config(Config { chunk_size: NonZeroU64::MIN, ..config() })
}

/// Completes the worker's oldest task, at `each` milliseconds for one sample of every pixel. Returns its samples.
fn complete_first(farm: &mut TestFarm, worker: u64, each: u64) -> std::ops::Range<u32> {
    let held = farm.first_lease_of(worker);
    let covered = held.spec.steps.clone();
    let milliseconds = each * covered.len() as u64;
    for _ in 0..milliseconds / 1000 {
        farm.now = farm.now.after(1000);
        farm.heartbeat(worker, Phase::Working, farm.now.0);
    }
    farm.now = farm.now.after(milliseconds % 1000);
    farm.complete_with(worker, &held, result_in(&held, Done, milliseconds as f64 / 1000.0));
    covered
}

fn is_refused(commands: &[Command]) -> bool {
    commands.iter().any(|command| matches!(command, Command::Refuse { .. }))
}

#[test]
fn task_of_unknown_pace_is_small_and_next_ones_take_target_time() {
    // A single frame behaves the same, while it has enough work for all workers.
    for frames in [&[1, 2, 3][..], &[1]] {
        check_target_duration(frames);
    }
}

fn check_target_duration(frames: &[u32]) {
    let mut farm = farm();
    let id = farm.submit(job(frames, 4, &[64]));
    farm.join(1);
    assert_eq!([0, 1].map(|place| samples_of(&farm.leases[place].1)), [0..1, 1..2], "one grain each");
    complete_first(&mut farm, 1, 400);
    assert_eq!(samples_of(&farm.leases[1].1), 2..22, "20 grains of 400 ms are 8 s");
    complete_first(&mut farm, 1, 400);
    complete_first(&mut farm, 1, 400);
    assert_eq!(samples_of(&farm.leases[1].1), 42..62);
    complete_first(&mut farm, 1, 400);
    assert_eq!(samples_of(&farm.leases[1].1), 62..64, "a task does not go beyond its tile");
    let progress = farm.status(id).active[0];
    assert_eq!((progress.tiles_done, progress.tiles_total), (0, 4), "a tile counts when all of it is done");
    complete_first(&mut farm, 1, 400);
    complete_first(&mut farm, 1, 400);
    assert_eq!(farm.status(id).active[0].tiles_done, 1);
}

#[test]
fn fast_tiles_are_done_in_one_piece() {
    let mut farm = farm();
    farm.submit(job(&[1, 2, 3], 4, &[64]));
    farm.join(1);
    complete_first(&mut farm, 1, 1);
    complete_first(&mut farm, 1, 1);
    let runs: Vec<_> = (0..3).map(|_| complete_first(&mut farm, 1, 1)).collect();
    assert_eq!(runs, [2..64, 0..64, 0..64]);
}

#[test]
fn progress_tells_the_pace_before_anything_is_done() {
    let mut farm = farm();
    farm.submit(job(&[1, 2, 3], 4, &[64]));
    farm.join(1);
    farm.heartbeat(1, Phase::Working, 0);
    farm.now = farm.now.after(1000);
    // Half a sample chunk in a second: a chunk takes two seconds.
    farm.heartbeat(1, Phase::Working, 32);
    farm.join(2);
    assert_eq!(samples_of(&farm.first_lease_of(2)), 2..6, "four grains of 2 s");
}

#[test]
fn tasks_shrink_at_the_job_end_so_that_workers_end_together() {
    let mut farm = farm();
    (1..=4).for_each(|worker| drop(farm.join(worker)));
    farm.submit(job(&[1], 1, &[64]));
    let (mut left, mut least) = (64, 64);
    while farm.leases[0].1.task.stage.kind == StageKind::Render {
        let worker = farm.leases[0].0.0;
        left -= complete_first(&mut farm, worker, 200).len();
        let sizes = farm.leases.iter().map(|(_, held)| held.spec.steps.len());
        let most = sizes.clone().max().unwrap_or(0);
        least = least.min(sizes.filter(|&size| size > 1).min().unwrap_or(least));
        assert!(most <= 8.max(left.div_ceil(4)), "one of four holds {most} of {left}");
    }
    assert_eq!(least, 7, "a task takes a second and a half or the rest");
}

#[test]
fn ended_lease_returns_all_chunks_and_late_results_are_refused() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 1, &[64]));
    farm.join(1);
    complete_first(&mut farm, 1, 10);
    complete_first(&mut farm, 1, 10);
    let late = farm.leases.clone();
    assert!(late.iter().any(|(_, held)| held.spec.steps.len() > 1));
    farm.leave(1);
    farm.join(2);
    for (_, held) in &late {
        assert!(is_refused(&farm.complete(1, held, Done)));
    }
    let mut covered = vec![0..1, 1..2];
    while farm.leases[0].1.task.stage.kind == StageKind::Render {
        covered.push(complete_first(&mut farm, 2, 10));
    }
    let all: Vec<u32> = covered.into_iter().flatten().collect();
    assert_eq!(all, (0..64).collect::<Vec<_>>());
    assert!(farm.leases[0].1.spec.inputs.len() > 2, "a tile in parts");
    farm.complete_first(2, Done);
    assert_eq!((farm.state(id), farm.status(id).samples_done), (JobState::Done, 64 * 64));
}

#[test]
fn a_part_that_is_lost_is_rendered_again_and_no_other() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 1, &[64]));
    farm.join(1);
    let mut parts = vec![];
    while farm.leases[0].1.task.stage.kind == StageKind::Render {
        parts.push(complete_first(&mut farm, 1, 100));
    }
    let merge = farm.first_lease_of(1);
    let tiles: Vec<Artifact> = merge.spec.artifacts().collect();
    assert_eq!(tiles.len(), parts.len());
    let failure = Failure::LostInputs { digests: vec![tiles[1].digest], message: "gone".into() };
    farm.fail(1, &merge, failure);
    assert_eq!(farm.status(id).active[0].tiles_done, 0);
    let again: Vec<u32> = farm.leases.iter().flat_map(|(_, held)| held.spec.steps.clone()).collect();
    assert_eq!(again, parts[1].clone().collect::<Vec<_>>());
    while farm.state(id) != JobState::Done {
        farm.complete_first(1, Done);
    }
}

#[test]
fn a_grain_that_fails_is_tried_alone_and_put_aside_alone() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 1, &[64]));
    farm.join(1);
    let (mut failures, mut worker) = (0, 1);
    while farm.state(id) == JobState::Running {
        let held = farm.first_lease_of(worker);
        // Sample 17 always fails.
        if held.spec.steps.contains(&17) {
            failures += 1;
            farm.fail(worker, &held, panic_failure());
            // A worker with repeated failures would be quarantined for the job.
            farm.leave(worker);
            worker += 1;
            farm.join(worker);
        } else {
            complete_first(&mut farm, worker, 30);
        }
    }
    let status = farm.status(id);
    let quarantined: Vec<u32> = status.quarantined.iter().map(|aside| aside.task.index).collect();
    assert_eq!((status.state, quarantined, status.samples_done), (JobState::Failed, vec![17], 64 * 63));
    assert!(failures < 40, "{failures} failures");
}

#[test]
fn returning_lease_is_adopted_with_its_samples_if_all_are_free() {
    let mut farm = farm();
    farm.submit(job(&[1], 1, &[64]));
    farm.join(1);
    complete_first(&mut farm, 1, 10);
    complete_first(&mut farm, 1, 10);
    let held: Vec<Assignment> = farm.leases.iter().map(|(_, held)| held.clone()).collect();
    farm.restart();
    farm.rejoin(2, &held);
    assert!(held.iter().all(|held| farm.leases.iter().filter(|(_, other)| other.epoch == held.epoch).count() == 1));
    let leased: Vec<u32> = farm.leases.iter().flat_map(|(_, held)| held.spec.steps.clone()).collect();
    assert!(leased.iter().all(|sample| leased.iter().filter(|other| *other == sample).count() == 1), "{leased:?}");
    assert!(held.iter().all(|held| !is_refused(&farm.complete(2, held, Done))));

    // Another worker holds a part of it by then.
    let old = farm.first_lease_of(2);
    farm.leave(2);
    farm.join(3);
    assert!(samples_of(&farm.first_lease_of(3)).start == samples_of(&old).start);
    let commands = farm.rejoin(4, std::slice::from_ref(&old));
    assert!(commands.iter().any(|c| matches!(c, Command::Revoke { epoch, .. } if *epoch == old.epoch)));
}

#[test]
fn a_snapshot_knows_the_cut_and_what_is_whole() {
    let mut farm = farm();
    let id = farm.submit(job(&[1], 3, &[64]));
    farm.join(1);
    while farm.status(id).active.first().is_none_or(|frame| frame.tiles_done < 2) {
        complete_first(&mut farm, 1, 30);
    }
    let ledger = farm.scheduler.ledger();
    assert_eq!(&Ledger::decode(&ledger.encode().unwrap()).unwrap(), ledger);
}

fn samples_of(held: &Assignment) -> std::ops::Range<u32> {
    held.spec.steps.clone()
}
