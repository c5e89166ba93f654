//! Tests of the laws of frame and task times.

use std::num::NonZeroU64;

use femc_model::*;

use super::{JobTimes, TimesCache};
use crate::attempts::{GroupBy, JobRecord, rows};
use crate::call::{AttemptPage, Call, JobShape};
use crate::farm::Farm;

/// Makes a job with tiles of 64 units in two rounds of 8 steps each, and an image.
fn shape() -> JobShape {
    let tiles = StageTemplate::new(StageKind::Render, Scope::Frame, [(4, 64)].into_iter().collect(), &[Role::Tile]);
    let image = StageTemplate::new(StageKind::Image, Scope::Frame, [(1, 1)].into_iter().collect(), &[Role::Image]);
    let spec = JobSpec {
        name: "drive".into(),
        bundle: Digest::compute(b"scene"),
        entry: "drive.mgf".into(),
        settings: "{}".into(),
        frames: vec![1, 2, 3],
        grid: Grid { film: [16, 16], tile: 8 },
        graph: Graph { stages: vec![tiles.with_steps(&[8, 16]), image] },
        contents: Vec::new(),
        priority: 50,
        owner: "ann".into(),
        tags: Vec::new(),
        notes: JobNotes::default(),
    };
    // Two chunks for each task and round.
    JobShape { spec: Box::new(spec), chunk_size: ChunkSize::Units(NonZeroU64::new(256).expect("not zero")) }
}

fn task(frame: u32, round: u32, index: u32) -> TaskKey {
    let stage = Stage { frame, round, number: 0, kind: StageKind::Render };
    TaskKey { job: JobId(1), stage, index }
}

/// Makes an attempt from `granted` to `ended` (milliseconds) that waited and worked for these seconds.
fn attempt(task: TaskKey, epoch: u64, [granted, ended]: [u64; 2], [wait, wall, cpu]: [f64; 3]) -> AttemptRecord {
    AttemptRecord {
        task,
        epoch: Epoch(epoch),
        worker: format!("w{}", epoch % 2),
        instance: epoch % 2,
        granted: Tick(granted),
        ended: Tick(ended),
        ending: LeaseEnding::Done,
        samples: 64,
        relative_error: None,
        usage: Some(ResourceUsage { wait, wall, cpu, ..ResourceUsage::default() }),
    }
}

fn times(records: &[AttemptRecord]) -> JobTimes {
    let (shape, mut times) = (shape(), JobTimes::default());
    records.iter().for_each(|record| times.put(&shape, record));
    times.update_sums();
    times
}

fn status(task: TaskKey, state: TaskState, is_of_all_rounds: bool) -> TaskStatus {
    TaskStatus {
        task,
        state,
        covers_all_rounds: is_of_all_rounds,
        workers: Vec::new(),
        attempts: 0,
        seconds: None,
        failure: None,
        times: None,
    }
}

/// Returns a generator of reproducible numbers in [0, 1).
fn numbers() -> impl FnMut() -> f64 {
    let mut state = 7_u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1_u64 << 24) as f64
    }
}

#[test]
fn waiting_is_the_time_of_the_leases_in_which_no_attempt_ran() {
    // Working from 1 to 3, from 2 to 4, and from 8 to 9; leases from 0 to 10.
    let records = [
        attempt(task(1, 0, 0), 1, [0, 3_000], [1.0, 2.0, 1.9]),
        attempt(task(1, 0, 1), 2, [1_000, 4_000], [1.0, 2.0, 1.8]),
        attempt(task(1, 0, 2), 3, [4_000, 10_000], [4.0, 1.0, 0.5]),
    ];
    let found = times(&records).frame(1).expect("it has attempts");
    assert_eq!((found.attempts, found.wall, found.waiting), (3, 5.0, 10.0 - 3.0 - 1.0));
    assert!((found.processor - 4.2).abs() < 1e-12, "{found:?}");
    assert_eq!(times(&records).frame(2), None);
}

#[test]
fn waiting_for_another_job_adds_no_processor_or_wall_seconds() {
    let alone = [[0, 2_000], [2_000, 4_000]];
    let beside = [[0, 2_000], [50_000, 52_000]];
    let [alone, beside] = [alone, beside].map(|leases| {
        let records: Vec<_> =
            (0..).zip(leases).map(|(k, lease)| attempt(task(1, 0, k), 1, lease, [0.0, 2.0, 1.5])).collect();
        times(&records).frame(1).expect("it has attempts")
    });
    assert_eq!((alone.processor, alone.wall), (beside.processor, beside.wall));
    assert_eq!((alone.waiting, beside.waiting), (0.0, 48.0));
}

#[test]
fn frames_and_tasks_add_up_to_job_and_rows_of_statistics() {
    let mut next = numbers();
    let mut records = Vec::new();
    for epoch in 0..2_000 {
        let task = task(1 + epoch as u32 % 3, (next() * 2.0) as u32, (next() * 8.0) as u32);
        let granted = (next() * 1e6) as u64;
        let [wait, wall] = [next() * 3.0, next() * 9.0];
        // Some leases end before the time that the worker measured, and some long after it.
        let ended = granted + ((wait + wall) * 1000.0 * (0.9 + next())) as u64;
        let record = attempt(task, epoch, [granted, ended], [wait, wall, wall * next()]);
        let ending = LeaseEnding::ALL[epoch as usize % 5];
        let usage = record.usage.filter(|_| ending != LeaseEnding::Lost);
        records.push(AttemptRecord { ending, usage, ..record });
    }
    let times = times(&records);
    let frames: Vec<AttemptTimes> = [1, 2, 3].map(|frame| times.frame(frame).expect("it has attempts")).into();
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6 * b.abs().max(1.0);
    let sum = |of: fn(&AttemptTimes) -> f64| frames.iter().map(of).sum::<f64>();
    let (processor, wall) = times.totals();
    assert!(near(processor, sum(|times| times.processor)) && near(wall, sum(|times| times.wall)));
    assert_eq!(frames.iter().map(|times| times.attempts as usize).sum::<usize>(), records.len());

    let JobShape { spec, chunk_size: cut } = shape();
    let attempts: Attempts = records.iter().cloned().collect();
    let attempts = attempts.iter().cloned().collect();
    let record = JobRecord { job: JobId(1), run: 0, variant: None, spec: *spec, cut, attempts, failures: Vec::new() };
    for (row, frame) in rows(&[record], GroupBy::Frame).iter().zip(&frames) {
        assert!(near(row.cpu, frame.processor) && near(row.wall, frame.wall) && near(row.waiting, frame.waiting));
        let leases = records.iter().filter(|record| Some(record.task.stage.frame) == row.task.map(|it| it.stage.frame));
        let (first, last) =
            leases.fold((u64::MAX, 0), |(first, last), record| (first.min(record.granted.0), last.max(record.ended.0)));
        let whole = (last - first) as f64 / 1000.0;
        assert!(frame.waiting >= 0.0 && frame.waiting <= whole, "{frame:?}");
        assert!(frame.waiting + frame.wall >= whole - 1e-6, "{frame:?} of {whole} s");
    }

    // Tasks of a finished frame cover all rounds, tasks of an unfinished frame one round.
    for is_of_all_rounds in [true, false] {
        let rounds = if is_of_all_rounds { 0..1 } else { 0..2 };
        let mut sums = AttemptTimes::default();
        for (round, index) in rounds.flat_map(|round| (0..4).map(move |index| (round, index))) {
            let mut status = status(task(1, round, index), TaskState::Done, is_of_all_rounds);
            times.fill_task(&mut status);
            let of_task = status.times.expect("it has attempts");
            assert_eq!(status.attempts, of_task.attempts);
            assert_eq!(status.workers.len(), 2, "{status:?}");
            sums.processor += of_task.processor;
            sums.wall += of_task.wall;
            sums.attempts += of_task.attempts;
        }
        assert!(near(sums.processor, frames[0].processor) && near(sums.wall, frames[0].wall));
        assert_eq!(sums.attempts, frames[0].attempts);
    }
}

#[test]
fn attempt_noted_twice_counts_once_in_either_order() {
    let whole = attempt(task(1, 0, 0), 1, [1_000, 4_000], [0.5, 2.0, 1.5]);
    let lost = AttemptRecord { ending: LeaseEnding::Lost, granted: Tick(0), usage: None, ..whole.clone() };
    for records in [[lost.clone(), whole.clone()], [whole, lost]] {
        let found = times(&records).frame(1).expect("it has attempts");
        assert_eq!((found.attempts, found.processor, found.wall, found.waiting), (1, 1.5, 2.0, 2.0));
    }
}

#[test]
fn tasks_keep_who_did_them_and_a_waiting_task_has_no_worker() {
    let records = [
        AttemptRecord { ending: LeaseEnding::Failed, ..attempt(task(1, 0, 0), 2, [0, 1_000], [0.0, 1.0, 1.0]) },
        attempt(task(1, 0, 0), 3, [1_000, 2_000], [0.0, 1.0, 1.0]),
    ];
    let times = times(&records);
    let filled = |state| {
        let mut status = status(task(1, 0, 0), state, false);
        times.fill_task(&mut status);
        (status.workers, status.attempts, status.times.map(|times| times.attempts))
    };
    assert_eq!(
        filled(TaskState::Done),
        (vec!["w1".to_owned(), "w0".to_owned()], 2, Some(2)),
        "first whose result counts"
    );
    assert_eq!(filled(TaskState::Failed).0.len(), 2);
    assert_eq!(filled(TaskState::Waiting), (Vec::new(), 0, Some(2)), "an attempt at it has failed");
    let mut other = status(task(2, 0, 0), TaskState::Done, true);
    times.fill_task(&mut other);
    assert_eq!((other.workers, other.attempts, other.times), (Vec::new(), 0, None));
}

#[tokio::test(start_paused = true)]
async fn notes_are_read_incrementally_and_dropped_when_unused() {
    let (calls, mut asked) = tokio::sync::mpsc::channel::<Call<()>>(1);
    let notes: Vec<_> = (0..5).map(|k| attempt(task(1, 0, k), u64::from(k), [0, 1_000], [0.0, 1.0, 1.0])).collect();
    let (told, mut pages) = tokio::sync::mpsc::unbounded_channel();
    tokio::spawn(async move {
        let mut there = 3;
        while let Some(Call::Attempts { from, reply, .. }) = asked.recv().await {
            // Pages have two records. Two more records are added after the first read.
            let (first, last) = (from as usize, (from as usize + 2).min(there));
            let next = (from as usize + 2 < there).then_some(from + 2);
            told.send(from).expect("somebody listens");
            drop(reply.send(Ok(AttemptPage { attempts: notes[first..last].to_vec(), next })));
            there = if next.is_none() { 5 } else { there };
        }
    });
    let (farm, shape, book) = (Farm::new(calls), shape(), TimesCache::default());
    let mut attempts = Vec::new();
    for _ in 0..3 {
        let times = book.get(&farm, JobId(1), &shape).await.expect("it is answered").expect("there are few");
        attempts.push(times.frame(1).expect("it has attempts").attempts);
    }
    assert_eq!(attempts, [3, 5, 5]);
    let mut read = |count| (0..count).map(|_| pages.try_recv().expect("a page")).collect::<Vec<u64>>();
    assert_eq!(read(5), [0, 2, 2, 4, 4]);
    tokio::time::sleep(std::time::Duration::from_secs(100)).await;
    drop(book.get(&farm, JobId(1), &shape).await);
    assert_eq!(read(3), [0, 2, 4], "it had been forgotten");
}
