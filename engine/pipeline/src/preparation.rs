//! Preparation of frames.

use crate::first_pass::{
    FrameLight, attach_first_pass, attach_targets, first_pass_world, learn_targets, solve_first_pass,
};
use crate::path_splitting::choose_branches;
use crate::settings::{Method, Settings};
use femc_guiding::document::TargetDocument;
use femc_layers::Feature;
use femc_prepared::{FrameSpec, PrepareError, Prepared, SceneSource};
use femc_scene::FrameKey;
use std::fmt::Display;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Prepares frame `frame` (from 1) of `source`, which has the overrides applied, for rendering. Solves its first pass if the method
/// has one. `previous`: any other frame; common parts are shared.
pub fn prepare_frame(
    source: &SceneSource,
    settings: &Settings,
    frame: u32,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    finish_frame(prepare_world(source, settings, frame, previous)?, source, settings, frame)
}

/// Prepares a frame with fewer pixels, for a pilot, as [`prepare_frame`] does. Its paths have as many branches as those of the
/// whole frame: larger pixels would need another number.
/// - `settings`: settings with the smaller film;
/// - `whole`: the whole frame.
pub fn prepare_pilot(
    source: &SceneSource,
    settings: &Settings,
    frame: u32,
    whole: &Prepared,
) -> Result<Prepared, PrepareError> {
    let mut prepared = femc_prepared::prepare_frame(source, &frame_spec(settings, frame), Some(whole))?;
    prepared.first_branches = whole.first_branches;
    finish_frame(prepared, source, settings, frame)
}

/// Solves the first pass of a frame, if the method has one, and learns its targets.
fn finish_frame(
    mut prepared: Prepared,
    source: &SceneSource,
    settings: &Settings,
    frame: u32,
) -> Result<Prepared, PrepareError> {
    if settings.method.has_first_pass() && prepared.field().is_none() {
        let world = first_pass_world(source, settings, frame, Some(&prepared))?;
        let solution = solve_first_pass(&world, settings.method, &AtomicBool::new(false));
        let solution = solution.map_err(first_pass_error)?;
        let light = FrameLight::new(Arc::new(solution.field), prepared.brightness);
        attach_first_pass(&mut prepared, light).map_err(first_pass_error)?;
    }
    // The field of another frame of the same world has no targets of this frame's view.
    attach_learned_targets(&mut prepared, settings.method)?;
    Ok(prepared)
}

/// Learns the targets of a frame's paths, and assigns them. Returns them, if the method has targets and the frame has a field.
pub fn attach_learned_targets(prepared: &mut Prepared, method: Method) -> Result<Option<TargetDocument>, PrepareError> {
    let targets = learn_targets(prepared, method, &AtomicBool::new(false)).map_err(first_pass_error)?;
    if let Some(targets) = &targets {
        attach_targets(prepared, targets).map_err(first_pass_error)?;
    }
    Ok(targets)
}

fn first_pass_error(error: impl Display) -> PrepareError {
    PrepareError::FirstPass { reason: error.to_string() }
}

/// Prepares a frame as [`prepare_frame`] does, but without the first pass: [`solve_first_pass`](crate::solve_first_pass()) solves
/// it, [`attach_first_pass`](crate::attach_first_pass) applies a solution.
pub fn prepare_world(
    source: &SceneSource,
    settings: &Settings,
    frame: u32,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    let mut prepared = femc_prepared::prepare_frame(source, &frame_spec(settings, frame), previous)?;
    prepared.first_branches = choose_branches(&prepared, settings);
    Ok(prepared)
}

/// Returns the key of the inputs from which [`prepare_frame`] makes the frame, including the next frame if the frame has motion
/// vectors.
pub fn frame_key(source: &SceneSource, settings: &Settings, frame: u32) -> Result<FrameKey, PrepareError> {
    let key = femc_prepared::frame_key(source, &frame_spec(settings, frame))?;
    if !settings.features.contains(&Feature::Motion) || frame >= source.scene().frame_count() {
        return Ok(key);
    }
    Ok(key.with_next(&femc_prepared::frame_key(source, &frame_spec(settings, frame + 1))?))
}

pub(crate) fn frame_spec(settings: &Settings, frame: u32) -> FrameSpec {
    FrameSpec { camera: settings.camera.clone(), size: settings.size, frame, filter_radius: settings.filter.radius() }
}
