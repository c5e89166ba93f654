//! The first-pass task: solves the first pass of a world, once for all frames and jobs that share the world.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use femc_model::{Digest, Failure, Phase, Role, StageTemplate};
use femc_pipeline::{FirstPassReport, Prepared, RenderError, Solution, Solver};

use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn first_pass(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let world = World::prepare(task, tools)?;
    world.check_memory(tools)?;
    let known = task.spec.content_key(0).and_then(|key| tools.cache.take_solution(key));
    let solution = match known {
        Some(solution) => {
            tracing::debug!("the first pass was solved before the job");
            Arc::unwrap_or_clone(solution)
        }
        None => tools.install(task, || world.solver.solve(&world.prepared, &task.cancel)).map_err(render_failure)?,
    };
    let product = write_solution(task, stage, tools, &world, solution)?;
    world.finish(task, product)
}

/// World of a first pass, with the times of its task.
pub(super) struct World {
    pub(super) solver: Arc<dyn Solver>,
    pub(super) prepared: Arc<Prepared>,
    watch: Stopwatch,
    /// Time since the world is ready.
    pub(super) solving: Stopwatch,
}

impl World {
    /// Prepares the world and checks its key.
    pub(super) fn prepare(task: &Task, tools: &Tools) -> Result<Self, Failure> {
        let spec = &task.spec;
        task.set_phase(Phase::Preparing);
        let watch = Stopwatch::start();
        // Any frame with this content will do: its frames do not differ in anything that the solution depends on.
        let frame = *spec.frames.first().ok_or_else(|| settings_failure("a first pass requires at least one frame"))?;
        let loaded = tools.cache.scene(spec, &task.client, &tools.fetch)?;
        let method = loaded.settings.method;
        if !method.has_first_pass() {
            return Err(settings_failure("the job's graph has a first pass, but its method has none"));
        }
        let blocks = femc_pipeline::planned_first_pass_blocks(&spec.graph);
        let key = femc_pipeline::first_pass_key(&loaded.frame_key(frame)?, method, blocks);
        if spec.content_key(0) != Some(Digest::from_bytes(key)) {
            return Err(settings_failure("the content of the job does not match its key"));
        }
        let prepared = tools.cache.world(spec, frame, &task.client, &tools.fetch)?;
        task.account.set_preparation(watch.elapsed());
        tracing::debug!(frame, seconds = watch.seconds(), "the world is ready");
        task.set_phase(Phase::Working);
        Ok(Self { solver: femc_pipeline::solver(method), prepared, watch, solving: Stopwatch::start() })
    }

    /// Checks that the memory suffices for the elements.
    pub(super) fn check_memory(&self, tools: &Tools) -> Result<(), Failure> {
        let needs = self.solver.min_bytes(&self.prepared);
        let surfaces = femc_pipeline::count_surfaces(&self.prepared.scene);
        tools.memory.check_room(needs, &format!("the first pass of {surfaces} surfaces (--method pt needs none)"))
    }

    /// Counts the task's unit of work, and sets its time.
    pub(super) fn finish(&self, task: &Task, mut product: Product) -> Result<Product, Failure> {
        task.units.store(1, Ordering::Relaxed);
        product.result.seconds = self.watch.seconds();
        if task.is_cancelled() { Err(Failure::Cancelled) } else { Ok(product) }
    }
}

/// Verifies a solution, and encodes it as the stage's output. This worker need not download it.
pub(super) fn write_solution(
    task: &Task,
    stage: &StageTemplate,
    tools: &Tools,
    world: &World,
    solution: Solution,
) -> Result<Product, Failure> {
    let bytes =
        tools.install(task, || solution.verify(&world.prepared).map(|()| femc_pipeline::encode_solution(&solution)));
    let bytes = bytes.map_err(|error| render_failure(error.into()))?;
    log(&solution.report, bytes.len(), &world.solving);
    tools.cache.insert_field(Digest::compute(&bytes), Arc::new(solution.field));
    let mut product = Product::default();
    product.put(stage, Role::Field, || bytes);
    Ok(product)
}

pub(super) fn render_failure(error: RenderError) -> Failure {
    match error {
        RenderError::Cancelled => Failure::Cancelled,
        error @ (RenderError::Film(_) | RenderError::Untrusted(_)) => settings_failure(error),
    }
}

fn log(report: &FirstPassReport, stored: usize, solving: &Stopwatch) {
    let FirstPassReport {
        elements,
        leaves,
        links,
        lamp_links,
        inexact_links: refused,
        rays,
        iterations,
        residual,
        bytes,
        row_sum,
        imbalance,
        ray_link_ratio: checked,
        ray_correction: corrected,
        census: _,
    } = *report;
    let seconds = solving.seconds();
    tracing::debug!(
        elements, leaves, links, lamp_links, rays, iterations, residual, row_sum, imbalance, checked, corrected, bytes,
        stored, seconds, "solved"
    );
    if refused > 0 {
        tracing::debug!(
            links = refused,
            "links below the requested accuracy: their elements are too small to be split, or memory is short"
        );
    }
}
