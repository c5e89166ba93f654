//! Execution of tasks, one file per task kind.

mod count_levels;
mod decide;
mod drill;
mod encode_clip;
mod encode_picture;
mod encode_sheet;
mod first_pass;
mod first_pass_finish;
mod first_pass_guides;
mod first_pass_rays;
mod first_pass_solve;
mod first_pass_start;
mod geometry;
mod image;
mod inputs;
mod join_readings;
mod layers;
mod learn;
mod measure;
mod paint;
mod pictures;
mod reduce;
mod reduce_layers;
mod reduce_levels;
mod reduce_paths;
mod render;
mod solution;
mod solver_state;
mod statistics;

pub use drill::drill_key;

use std::any::Any;
use std::fmt::Display;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;

use bytes::Bytes;
use femc_fault::{Point, abort_if_deadly, panic_if_sick, pass_point};
use femc_model::{Artifact, Failure, Output, Role, Stage, StageKind, StageTemplate, TaskResult};
use rayon::ThreadPool;
use tracing::Span;

use crate::clock::Stopwatch;
use crate::fetch::Fetcher;
use crate::memory::MemoryGuard;
use crate::meter::Activity;
use crate::niceness::Niceness;
use crate::task_table::Task;
use crate::threads::AbandonedThreads;
use crate::{Cache, Journal};

/// Resources that tasks need.
#[derive(Debug, Clone)]
pub(crate) struct Tools {
    pub(crate) pool: Arc<ThreadPool>,
    pub(crate) cache: Cache,
    pub(crate) fetch: Fetcher,
    pub(crate) memory: MemoryGuard,
    pub(crate) nice: Niceness,
    pub(crate) journal: Journal,
    pub(crate) abandoned_threads: AbandonedThreads,
}

impl Tools {
    /// Returns a copy that charges its downloads to `task`.
    fn for_task(&self, task: &Arc<Task>) -> Self {
        Self { fetch: self.fetch.for_task(task), ..self.clone() }
    }

    /// Runs `work` for `task` on the pool. The task is not charged for processor time until a thread of the pool is free for it.
    pub(crate) fn install<T: Send>(&self, task: &Task, work: impl FnOnce() -> T + Send) -> T {
        let span = Span::current();
        task.account.set_activity(Activity::Waiting);
        self.pool.install(|| {
            task.account.set_activity(Activity::Computing);
            span.in_scope(|| task.log.record_during(work))
        })
    }
}

/// A result and the artifacts that it names.
#[derive(Debug, Default)]
pub(crate) struct Product {
    pub(crate) result: TaskResult,
    pub(crate) artifacts: Vec<Bytes>,
}

impl Product {
    /// Returns a product with one output of this role, if the stage makes one.
    fn of_one(stage: &StageTemplate, role: Role, bytes: Vec<u8>, watch: &Stopwatch) -> Self {
        let mut product = Self::default();
        product.put(stage, role, || bytes);
        product.result.seconds = watch.seconds();
        product
    }

    /// Adds an output if the stage makes one of this role.
    fn put<T: Into<Bytes>>(&mut self, stage: &StageTemplate, role: Role, make: impl FnOnce() -> T) {
        if stage.outputs.contains(&role) {
            let bytes = make().into();
            self.result.outputs.push(Output { role, artifact: Artifact::from_bytes(&bytes) });
            self.artifacts.push(bytes);
        }
    }
}

/// Executes the task. A panic counts as a failure.
pub(crate) fn execute(task: &Arc<Task>, tools: &Tools) -> Result<Product, Failure> {
    task.begin();
    let tools = &tools.for_task(task);
    let (key, epoch) = task.key();
    let _span = tracing::info_span!("task", job = key.job.0, task = %key, epoch = epoch.0).entered();
    pass_point(Point::WorkerBeforeTask);
    abort_if_deadly(&key);
    task.log.record_during(|| {
        let outcome = attempt(task, tools);
        match &outcome {
            Ok(_) | Err(Failure::Cancelled) => {}
            Err(failure) => tracing::warn!(task = %task.key().0, %failure, "task failed"),
        }
        outcome
    })
}

fn attempt(task: &Task, tools: &Tools) -> Result<Product, Failure> {
    let stage = stage(task)?;
    let work = || {
        panic_if_sick();
        match stage.kind {
            StageKind::Render => render::render(task, stage, tools),
            StageKind::Reduce => reduce::reduce(task, stage, tools),
            StageKind::Image => image::image(task, stage, tools),
            StageKind::Drill => drill::drill(task, stage, tools),
            StageKind::Decide => decide::decide(task, stage, tools),
            StageKind::Paint => paint::paint(task, stage, tools),
            StageKind::FirstPass => first_pass::first_pass(task, stage, tools),
            StageKind::FirstPassStart => first_pass_start::first_pass_start(task, stage, tools),
            StageKind::FirstPassRays => first_pass_rays::first_pass_rays(task, stage, tools),
            StageKind::FirstPassSolve => first_pass_solve::first_pass_solve(task, stage, tools),
            StageKind::FirstPassGuides => first_pass_guides::first_pass_guides(task, stage, tools),
            StageKind::FirstPassFinish => first_pass_finish::first_pass_finish(task, stage, tools),
            StageKind::CountLevels => count_levels::count_levels(task, stage, tools),
            StageKind::ReduceLevels => reduce_levels::reduce_levels(task, stage, tools),
            StageKind::ReducePaths => reduce_paths::reduce_paths(task, stage, tools),
            StageKind::ReduceLayers => reduce_layers::reduce_layers(task, stage, tools),
            StageKind::EncodePicture => encode_picture::encode_picture(task, stage, tools),
            StageKind::EncodeSheet => encode_sheet::encode_sheet(task, stage, tools),
            StageKind::EncodeClip => encode_clip::encode_clip(task, stage, tools),
            StageKind::Geometry => geometry::geometry(task, stage, tools),
            StageKind::Solution => solution::solution(task, stage, tools),
            StageKind::Measure => measure::measure(task, stage, tools),
            StageKind::JoinReadings => join_readings::join_readings(task, stage, tools),
            StageKind::Learn => learn::learn(task, stage, tools),
            kind @ (StageKind::FirstPassBlock | StageKind::Encode) => {
                let name = kind.name();
                Err(settings_failure(format!("invalid job graph: a stage of kind {name} has outputs of no known task")))
            }
        }
    };
    let measured = tools.memory.admit(stage.kind, &tools.cache)?;
    let outcome = std::panic::catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|panic| Err(Failure::Panicked { message: panic_message(&*panic) }));
    measured.finish();
    outcome
}

/// Returns the task's stage.
fn stage(task: &Task) -> Result<&StageTemplate, Failure> {
    let (graph, Stage { number, kind, round, .. }) = (&task.spec.graph, task.assignment.task.stage);
    let stage = graph.stage(number).filter(|stage| stage.kind == kind && round < graph.rounds(number));
    let stage = stage.filter(|stage| task.assignment.spec.item < stage.tasks());
    stage.ok_or_else(|| settings_failure(format!("the job's graph has no task {}", task.key().0)))
}

/// Returns the failure of a job whose settings, film and graph do not match.
fn settings_failure(message: impl Display) -> Failure {
    Failure::Settings { message: message.to_string() }
}

/// Returns a failure that is not caused by the inputs.
fn internal_failure(error: &dyn Display) -> Failure {
    Failure::Panicked { message: error.to_string() }
}

fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "without a message".into())
}

#[cfg(test)]
mod tests {
    use femc_model::{Grid, JobSpec, Reach, Scope, TaskSizes};
    use tokio::runtime::Handle;

    use super::*;

    fn tools() -> Tools {
        let pool = Arc::new(rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap());
        Tools {
            pool: pool.clone(),
            cache: Cache::default(),
            fetch: Fetcher::blocking(Handle::current(), pool),
            memory: MemoryGuard::default(),
            nice: Niceness::try_new(None).unwrap(),
            journal: Journal::default(),
            abandoned_threads: AbandonedThreads::default(),
        }
    }

    /// Runs a reduce task that reads four tiles with this reach, after `change` is applied to the task.
    async fn run_reduce(reach: Reach, change: impl FnOnce(&mut Task)) -> Result<Product, Failure> {
        let mut task = Arc::into_inner(crate::outbox::tests::task(0, b"").await).unwrap();
        let grid = Grid { film: [64, 16], tile: 16 };
        let render = StageTemplate::new(StageKind::Render, Scope::Frame, grid.sizes(), &[Role::Tile]).with_steps(&[4]);
        let reduce = StageTemplate::new(StageKind::Reduce, Scope::Frame, TaskSizes::even(2, 1), &[Role::Pixels]);
        let graph = femc_model::Graph { stages: vec![render, reduce.with_input(0, Role::Tile, reach)] };
        task.spec = Arc::new(JobSpec { grid, graph, ..(*task.spec).clone() });
        (task.assignment.task.stage.number, task.assignment.task.stage.kind) = (1, StageKind::Reduce);
        change(&mut task);
        let tools = tools();
        tokio::task::spawn_blocking(move || attempt(&task, &tools)).await.unwrap()
    }

    #[tokio::test]
    async fn task_outside_its_graph_or_reducing_nothing_fails_job() {
        let unfit = [
            run_reduce(Reach::Fan(2), |task| task.assignment.task.stage.number = 2).await,
            run_reduce(Reach::Fan(2), |task| task.assignment.task.stage.kind = StageKind::Image).await,
            run_reduce(Reach::Fan(2), |task| task.assignment.task.stage.round = 1).await,
            run_reduce(Reach::Fan(2), |task| task.assignment.spec.item = 2).await,
            run_reduce(Reach::Fan(4), |task| task.assignment.spec.item = 1).await,
            run_reduce(Reach::Same, |_| ()).await,
        ];
        for outcome in unfit {
            assert!(matches!(outcome, Err(Failure::Settings { .. })), "{outcome:?}");
        }
        let empty = run_reduce(Reach::Fan(2), |_| ()).await.unwrap_err().to_string();
        assert!(empty.contains("tile 0 has samples []"), "{empty}");
    }
}
