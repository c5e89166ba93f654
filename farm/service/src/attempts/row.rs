//! Attempts, and what they add up to.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{AttemptRecord, Ending, Grains, TaskKey, Tick};

use super::job_record::JobRecord;
use crate::times::{Span, Sum};

/// What a row is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// A task, with all its attempts.
    Task,
    /// A frame.
    Frame,
    /// A variant of a sweep; of other jobs, a job.
    Variant,
    /// A worker's process.
    Worker,
    /// One attempt at a task.
    Attempt,
}

/// What one attempt took, or several together. Seconds, bytes; times are since the first attempt of all began.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// Index of the job's record among those shown: jobs of two farms may have the same number.
    pub source: usize,
    /// Number of the job, of the first of the attempts.
    pub job: u64,
    /// The variant that the job renders, of a sweep.
    pub variant: Option<String>,
    /// The task, of the first of the attempts.
    pub task: Option<TaskKey>,
    /// Number of the tile in the grid, of tasks of the main stage.
    pub tile: Option<u32>,
    /// Which attempt at its task, from 1; of several the last.
    pub attempt: u64,
    /// Epoch of the lease, of the first of the attempts.
    pub epoch: u64,
    /// The worker of the result that counts, else of the last attempt.
    pub worker: String,
    /// Its process.
    pub instance: u64,
    /// How it ended; of several, the best end.
    pub ending: Option<Ending>,
    /// Tasks.
    pub tasks: u64,
    /// Attempts.
    pub attempts: u64,
    /// Of these, those whose result counts.
    pub done: u64,
    /// Of these, those that failed.
    pub failed: u64,
    /// Workers.
    pub workers: u64,
    /// Begin of the first attempt, in seconds since the run began.
    pub began: f64,
    /// End of the last attempt, in seconds since the run began.
    pub ended: f64,
    /// Between arrival and beginning.
    pub wait: f64,
    /// Between the first lease and the end of the last one, while no attempt ran; see [`femc_model::Times::waiting`].
    pub waiting: f64,
    /// From the beginning to the result.
    pub wall: f64,
    /// Of these, until the inputs were ready.
    pub preparation: f64,
    /// Processor time.
    pub cpu: f64,
    /// Most memory of the worker's process.
    pub peak: Option<u64>,
    /// Pixel samples of results that count.
    pub samples: u64,
    /// Pixel samples taken.
    pub taken: u64,
    /// Rays traced.
    pub rays: u64,
    /// Bytes fetched.
    pub fetched: u64,
    /// Bytes brought home.
    pub sent: u64,
    /// Relative error that was measured last.
    pub relative_error: Option<f64>,
}

impl Row {
    /// Of one attempt.
    /// - `zero`: when the first attempt of all began.
    fn of(record: &AttemptRecord, source: usize, job: &JobRecord, attempt: u64, zero: f64) -> Self {
        let usage = record.usage.unwrap_or_default();
        let began = began(record);
        let ended = if record.usage.is_some() { began + usage.wall } else { seconds(record.ended) };
        let TaskKey { stage, index, .. } = record.task;
        let main = job.spec.graph.main().filter(|(number, _)| *number == stage.number);
        let tile = main.map(|(_, template)| Grains::of(template, stage.round, None, job.cut).task(index));
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
            done: u64::from(record.ending == Ending::Done),
            failed: u64::from(record.ending == Ending::Failed),
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
            taken: usage.samples,
            rays: usage.rays,
            fetched: usage.fetched,
            sent: usage.sent,
            relative_error: record.relative_error,
        }
    }

    /// Both together; the tasks and workers of both are told apart by who calls this.
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
        self.taken += other.taken;
        self.rays += other.rays;
        self.fetched += other.fetched;
        self.sent += other.sent;
    }
}

fn seconds(tick: Tick) -> f64 {
    tick.0 as f64 / 1000.0
}

/// When an attempt began, in seconds of the coordinator: after its lease was granted and it had waited; a lease that was
/// handed over says a later time than that.
fn began(record: &AttemptRecord) -> f64 {
    let (wait, wall) = record.usage.map_or((0.0, 0.0), |usage| (usage.wait, usage.wall));
    (seconds(record.granted) + wait).min(seconds(record.ended) - wall)
}

/// One row for each task, frame, variant, worker or attempt, in their order.
pub fn rows(jobs: &[JobRecord], by: By) -> Vec<Row> {
    rows_since(jobs, by, &zeros(jobs))
}

/// The rows of some of a job's attempts, an attempt each. Their times are the coordinator's own; the numbers of the attempts at a
/// task count within these.
pub fn rows_of_page(job: JobRecord) -> Vec<Row> {
    rows_since(&[job], By::Attempt, &BTreeMap::new())
}

fn rows_since(jobs: &[JobRecord], by: By, zeros: &BTreeMap<u64, f64>) -> Vec<Row> {
    let all = jobs.iter().enumerate().flat_map(|(source, job)| {
        let zero = zeros.get(&job.run).copied().unwrap_or_default();
        let (mut last, mut number) = (None, 0);
        job.attempts.iter().map(move |record| {
            number = if last == Some(record.task) { number + 1 } else { 1 };
            last = Some(record.task);
            (Row::of(record, source, job, number, zero), Span::new(record.granted, record.ended, record.usage))
        })
    });
    match by {
        By::Attempt => all.map(|(row, span)| with_waiting(row, [span].into_iter().collect())).collect(),
        By::Task => grouped(all, |row| (row.source, row.task)),
        By::Frame => grouped(all, |row| (row.source, row.task.map(|task| task.stage.frame))),
        By::Variant => grouped(all, |row| (row.variant.is_none().then_some(row.source), row.variant.clone())),
        By::Worker => {
            let mut workers = grouped(all, |row| (row.worker.clone(), row.instance));
            workers.iter_mut().for_each(|worker| worker.tasks = worker.done);
            workers
        }
    }
}

/// What is the beginning, by each run's clock: runs come one after the other, without what was between them.
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
