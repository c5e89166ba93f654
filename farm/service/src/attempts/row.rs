//! Rows: attempts, and sums over several attempts.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{AttemptRecord, Chunks, LeaseEnding, TaskKey, Tick};

use super::job_record::JobRecord;
use crate::times::{Span, Sum};

/// Grouping of the attempts into rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroupBy {
    /// One row per task, with all its attempts.
    Task,
    /// One row per frame.
    Frame,
    /// One row per variant of a sweep, or per job if the job is not part of a sweep.
    Variant,
    /// One row per process of a worker.
    Worker,
    /// One row per attempt.
    Attempt,
}

/// Resources that one attempt, or several together, used. Units are seconds and bytes. Points in time are relative to the start of
/// the earliest attempt.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// Index of the job's record among those shown, because jobs of two farms may have the same number.
    pub source: usize,
    /// Number of the job of the first attempt.
    pub job: u64,
    /// Variant that the job renders, if it belongs to a sweep.
    pub variant: Option<String>,
    /// Task of the first attempt.
    pub task: Option<TaskKey>,
    /// Number of the tile in the grid, for tasks of the main stage.
    pub tile: Option<u32>,
    /// Number of the attempt at its task, from 1. For several attempts, the greatest.
    pub attempt: u64,
    /// Epoch of the lease of the first attempt.
    pub epoch: u64,
    /// Worker of the result that counts, or of the last attempt if there is none.
    pub worker: String,
    /// Process of the worker.
    pub instance: u64,
    /// Ending of the attempt. For several attempts, the best ending.
    pub ending: Option<LeaseEnding>,
    /// Number of tasks.
    pub tasks: u64,
    /// Number of attempts.
    pub attempts: u64,
    /// Number of attempts whose result counts.
    pub done: u64,
    /// Number of attempts that failed.
    pub failed: u64,
    /// Number of workers.
    pub workers: u64,
    /// Start of the first attempt, in seconds since the run began.
    pub began: f64,
    /// End of the last attempt, in seconds since the run began.
    pub ended: f64,
    /// Seconds between arrival and start.
    pub wait: f64,
    /// Seconds without a running attempt, from the first lease to the end of the last one; see
    /// [`femc_model::AttemptTimes::waiting`].
    pub waiting: f64,
    /// Seconds from the start to the result.
    pub wall: f64,
    /// Part of `wall` until the inputs were ready.
    pub preparation: f64,
    /// Processor seconds.
    pub cpu: f64,
    /// Peak memory of the worker's process in bytes.
    pub peak: Option<u64>,
    /// Number of pixel samples in results that count.
    pub samples: u64,
    /// Number of pixel samples taken.
    pub samples_taken: u64,
    /// Number of rays traced.
    pub rays: u64,
    /// Bytes fetched.
    pub fetched: u64,
    /// Bytes uploaded.
    pub sent: u64,
    /// Last measured relative error.
    pub relative_error: Option<f64>,
}

impl Row {
    /// Makes the row of one attempt.
    /// - `zero`: start of the earliest attempt.
    fn from_attempt(record: &AttemptRecord, source: usize, job: &JobRecord, attempt: u64, zero: f64) -> Self {
        let usage = record.usage.unwrap_or_default();
        let began = began(record);
        let ended = if record.usage.is_some() { began + usage.wall } else { seconds(record.ended) };
        let TaskKey { stage, index, .. } = record.task;
        let main = job.spec.graph.main_stage().filter(|(number, _)| *number == stage.number);
        let tile = main.map(|(_, template)| Chunks::new(template, stage.round, None, job.cut).task(index));
        Self {
            source,
            job: job.job.0,
            variant: job.variant.clone(),
            task: Some(record.task),
            tile,
            attempt,
            epoch: record.epoch.0,
            worker: record.worker.clone(),
            instance: record.instance,
            ending: Some(record.ending),
            tasks: u64::from(attempt == 1),
            attempts: 1,
            done: u64::from(record.ending == LeaseEnding::Done),
            failed: u64::from(record.ending == LeaseEnding::Failed),
            workers: 1,
            began: began - zero,
            ended: ended - zero,
            wait: usage.wait,
            waiting: 0.0,
            wall: if record.usage.is_some() { usage.wall } else { ended - began },
            preparation: usage.preparation,
            cpu: usage.cpu,
            peak: usage.peak,
            samples: record.samples,
            samples_taken: usage.samples,
            rays: usage.rays,
            fetched: usage.fetched,
            sent: usage.sent,
            relative_error: record.relative_error,
        }
    }

    /// Adds another row. The caller counts distinct workers.
    fn add(&mut self, other: &Self) {
        if other.ending >= self.ending {
            (self.worker, self.instance, self.ending) = (other.worker.clone(), other.instance, other.ending);
        }
        if other.relative_error.is_some() && other.ended >= self.ended || self.relative_error.is_none() {
            self.relative_error = other.relative_error;
        }
        self.attempt = self.attempt.max(other.attempt);
        self.tasks += other.tasks;
        self.attempts += other.attempts;
        self.done += other.done;
        self.failed += other.failed;
        self.began = self.began.min(other.began);
        self.ended = self.ended.max(other.ended);
        self.wait += other.wait;
        self.wall += other.wall;
        self.preparation += other.preparation;
        self.cpu += other.cpu;
        self.peak = self.peak.max(other.peak);
        self.samples += other.samples;
        self.samples_taken += other.samples_taken;
        self.rays += other.rays;
        self.fetched += other.fetched;
        self.sent += other.sent;
    }
}

fn seconds(tick: Tick) -> f64 {
    tick.0 as f64 / 1000.0
}

/// Returns the start of an attempt in seconds of the coordinator's clock: the time of its lease plus its wait. If the lease was
/// handed over, its time may be too late; then the end minus the wall time is used.
fn began(record: &AttemptRecord) -> f64 {
    let (wait, wall) = record.usage.map_or((0.0, 0.0), |usage| (usage.wait, usage.wall));
    (seconds(record.granted) + wait).min(seconds(record.ended) - wall)
}

/// Returns one row for each task, frame, variant, worker or attempt, in their order.
pub fn rows(jobs: &[JobRecord], group_by: GroupBy) -> Vec<Row> {
    rows_since(jobs, group_by, &zeros(jobs))
}

/// Returns the rows of one page of a job's attempts, one row per attempt. Times are those of the coordinator. Attempts are numbered
/// per task within this page.
pub fn rows_of_page(job: JobRecord) -> Vec<Row> {
    rows_since(&[job], GroupBy::Attempt, &BTreeMap::new())
}

fn rows_since(jobs: &[JobRecord], group_by: GroupBy, zeros: &BTreeMap<u64, f64>) -> Vec<Row> {
    let all = jobs.iter().enumerate().flat_map(|(source, job)| {
        let zero = zeros.get(&job.run).copied().unwrap_or_default();
        let (mut last, mut number) = (None, 0);
        job.attempts.iter().map(move |record| {
            number = if last == Some(record.task) { number + 1 } else { 1 };
            last = Some(record.task);
            (
                Row::from_attempt(record, source, job, number, zero),
                Span::new(record.granted, record.ended, record.usage),
            )
        })
    });
    match group_by {
        GroupBy::Attempt => all.map(|(row, span)| with_waiting(row, [span].into_iter().collect())).collect(),
        GroupBy::Task => grouped(all, |row| (row.source, row.task)),
        GroupBy::Frame => grouped(all, |row| (row.source, row.task.map(|task| task.stage.frame))),
        GroupBy::Variant => grouped(all, |row| (row.variant.is_none().then_some(row.source), row.variant.clone())),
        GroupBy::Worker => {
            let mut workers = grouped(all, |row| (row.worker.clone(), row.instance));
            workers.iter_mut().for_each(|worker| worker.tasks = worker.done);
            workers
        }
    }
}

/// Returns the zero point of each run, by that run's clock. Runs follow each other without the gaps between them.
fn zeros(jobs: &[JobRecord]) -> BTreeMap<u64, f64> {
    let mut runs: BTreeMap<u64, (f64, f64)> = BTreeMap::new();
    for job in jobs {
        for record in &job.attempts {
            let (first, last) = runs.entry(job.run).or_insert((f64::INFINITY, 0.0));
            (*first, *last) = (first.min(began(record)), last.max(seconds(record.ended)));
        }
    }
    let mut before = 0.0;
    let zero = |(run, (first, last)): (u64, (f64, f64))| {
        let zero = first - before;
        before += last - first;
        (run, zero)
    };
    runs.into_iter().map(zero).collect()
}

fn with_waiting(row: Row, sum: Sum) -> Row {
    Row { waiting: sum.times().map_or(0.0, |times| times.waiting), ..row }
}

fn grouped<K: Ord>(all: impl Iterator<Item = (Row, Span)>, key: impl Fn(&Row) -> K) -> Vec<Row> {
    let mut groups: BTreeMap<K, (Row, Sum, BTreeSet<u64>)> = BTreeMap::new();
    for (row, span) in all {
        let instance = row.instance;
        let (_, sum, workers) = (groups.entry(key(&row)))
            .and_modify(|(known, ..)| known.add(&row))
            .or_insert_with(|| (row, Sum::default(), BTreeSet::new()));
        sum.add(&span);
        workers.insert(instance);
    }
    let count = |(row, sum, workers): (Row, Sum, BTreeSet<u64>)| {
        with_waiting(Row { workers: workers.len() as u64, ..row }, sum)
    };
    groups.into_values().map(count).collect()
}
