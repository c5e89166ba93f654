//! The first pass of a world. It is solved once for all frames and jobs that share the world, in one task or in many steps.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use femc_model::{Digest, Failure, Phase, Role, StageTemplate};
use femc_pipeline::{FirstPassReport, RenderError};

use super::{Product, Tools, first_pass_steps, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(crate) fn first_pass(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let spec = &task.spec;
    task.set_phase(Phase::Preparing);
    let watch = Stopwatch::start();
    // Any frame with this content will do: its frames do not differ in anything that the solution depends on.
    let frame = *spec.frames.first().ok_or_else(|| settings_failure("a first pass requires at least one frame"))?;
    let loaded = tools.cache.scene(spec, &task.client, &tools.fetch)?;
    if !loaded.settings.method.has_first_pass() {
        return Err(settings_failure("the job's graph has a first pass, but its method has none"));
    }
    let frame_key = loaded.frame_key(frame)?;
    let method = loaded.settings.method;
    let solver = femc_pipeline::solver(method);
    let key = femc_pipeline::first_pass_key(&frame_key, method, first_pass_steps::blocks(&spec.graph));
    if spec.content_key(0) != Some(Digest::from_bytes(key)) {
        return Err(settings_failure("the content of the job does not match its key"));
    }
    let prepared = tools.cache.world(spec, frame, &task.client, &tools.fetch)?;
    task.account.set_preparation(watch.elapsed());
    tracing::debug!(frame, seconds = watch.seconds(), "the world is ready");
    task.set_phase(Phase::Working);
    if stage.needs.is_empty() {
        let needs = solver.min_bytes(&prepared);
        let surfaces = femc_pipeline::count_surfaces(&prepared.scene);
        let what = format!("the first pass of {surfaces} surfaces (--method pt needs none)");
        tools.memory.check_room(needs, &what)?;
    }
    let solving = Stopwatch::start();
    if !stage.needs.is_empty() || !stage.outputs.contains(&Role::Field) {
        let mut product = first_pass_steps::step(task, stage, tools, (&*solver, &prepared), &solving)?;
        task.units.store(1, Ordering::Relaxed);
        product.result.seconds = watch.seconds();
        return Ok(product);
    }
    let solved = tools.install(task, || {
        let solution = femc_pipeline::solve_first_pass(&prepared, method, &task.cancel)?;
        let bytes = femc_pipeline::encode_solution(&solution);
        log(&solution.report, bytes.len(), &solving);
        Ok((bytes, Arc::new(solution.field)))
    });
    let (bytes, field) = solved.map_err(render_failure)?;
    task.units.store(1, Ordering::Relaxed);
    // The worker that solved the first pass need not download it.
    tools.cache.insert_field(Digest::compute(&bytes), field);
    let mut product = Product::default();
    product.put(stage, Role::Field, || bytes);
    product.result.seconds = watch.seconds();
    Ok(product)
}

pub(super) fn render_failure(error: RenderError) -> Failure {
    match error {
        RenderError::Cancelled => Failure::Cancelled,
        error @ (RenderError::Film(_) | RenderError::Untrusted(_)) => settings_failure(error),
    }
}

pub(super) fn log(report: &FirstPassReport, stored: usize, solving: &Stopwatch) {
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
        is_energy_bounded: bounded,
        ray_link_ratio: checked,
        ray_correction: corrected,
        census: _,
    } = *report;
    let seconds = solving.seconds();
    tracing::debug!(
        elements, leaves, links, lamp_links, rays, iterations, residual, row_sum, bounded, checked, corrected, bytes,
        stored, seconds, "solved"
    );
    if refused > 0 {
        tracing::debug!(
            links = refused,
            "links below the requested accuracy: their elements are too small to be split, or memory is short"
        );
    }
}
