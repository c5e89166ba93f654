//! Doing tasks: one file a kind.

mod gather;
mod merge;
mod render;
mod union;

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use bytes::Bytes;
use femc_fault::{Point, dies_of, pass};
use femc_model::{Failure, TaskResult, Work};
use rayon::ThreadPool;
use tracing::Span;

use crate::fetch::Fetch;
use crate::memory::Memory;
use crate::meter::Doing;
use crate::nice::Nice;
use crate::table::Task;
use crate::{Cache, Journal};

/// What a task needs beside itself.
#[derive(Debug, Clone)]
pub(crate) struct Tools {
    pub(crate) pool: Arc<ThreadPool>,
    pub(crate) cache: Cache,
    pub(crate) fetch: Fetch,
    pub(crate) memory: Memory,
    pub(crate) nice: Nice,
    pub(crate) journal: Journal,
}

impl Tools {
    /// The same for one task: what is fetched with them is fetched for it.
    fn of(&self, task: &Arc<Task>) -> Self {
        Self { fetch: self.fetch.of(task), ..self.clone() }
    }

    /// Does `work` for `task` on the pool. Until a thread of the pool is free for it, the task takes no processor time.
    pub(crate) fn install<T: Send>(&self, task: &Task, work: impl FnOnce() -> T + Send) -> T {
        let span = Span::current();
        task.account.doing(Doing::Waits);
        self.pool.install(|| {
            task.account.doing(Doing::Computes);
            span.in_scope(|| task.log.hear(work))
        })
    }
}

/// A result and the artefacts that it names.
#[derive(Debug)]
pub(crate) struct Product {
    pub(crate) result: TaskResult,
    pub(crate) artefacts: Vec<Bytes>,
}

/// Does the task. A panic is a failure like others.
pub(crate) fn execute(task: &Arc<Task>, tools: &Tools) -> Result<Product, Failure> {
    task.begin();
    let tools = &tools.of(task);
    let (key, epoch) = task.key();
    let _span = tracing::info_span!("task", job = key.job.0, task = %key, epoch = epoch.0).entered();
    pass(Point::WorkerBeforeTask);
    dies_of(&key);
    task.log.hear(|| {
        let outcome = attempt(task, tools);
        match &outcome {
            Ok(_) | Err(Failure::Cancelled) => {}
            Err(failure) => tracing::warn!(task = %task.key().0, %failure, "task failed"),
        }
        outcome
    })
}

fn attempt(task: &Task, tools: &Tools) -> Result<Product, Failure> {
    let work = || match &task.assignment.work {
        Work::Render { tile, samples } => render::render(task, *tile, samples.clone(), tools),
        Work::Gather { span, parts, more } => gather::gather(task, span.clone(), parts, *more, tools),
        Work::Merge { .. } => merge::merge(task, tools),
    };
    let measured = tools.memory.begin(task.assignment.task.stage.kind, &tools.cache)?;
    let outcome = std::panic::catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|panic| Err(Failure::Panicked { message: message(&*panic) }));
    measured.end();
    outcome
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "without a message".into())
}
