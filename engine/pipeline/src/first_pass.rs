//! The first pass as a separate task: the inputs of its solution, and the solution as bytes.

use crate::preparation::frame_spec;
use crate::render::RenderError;
use crate::settings::{Method, Settings};
use crate::solver::solver;
use femc_field::{Field, SolveStatistics};
use femc_guiding::document::{TargetDocument, TargetError};
use femc_prepared::{PrepareError, Prepared, SceneSource};
use femc_radiosity::{Solution, SolveReport};
use femc_scene::FrameKey;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Solves the finite-element first pass of a prepared frame. Returns its light and a report of the work. The result depends only on
/// the inputs of the digest [`first_pass_key`].
/// - errors: `cancel` was set, or the solution cannot be trusted.
pub fn solve_first_pass(prepared: &Prepared, method: Method, cancel: &AtomicBool) -> Result<Solution, RenderError> {
    let solution = solver(method).solve(prepared, cancel)?;
    solution.verify(prepared)?;
    Ok(solution)
}

/// Returns the world of a frame for its first pass: with lamps of brightness 1. Frames with equal keys ([`first_pass_key`]) have
/// the same world, and the light of each frame is that of this world, scaled to the brightness of its lamps ([`FrameLight`]).
pub fn first_pass_world(
    source: &SceneSource,
    settings: &Settings,
    frame: u32,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    femc_prepared::prepare_frame_at_unit_brightness(source, &frame_spec(settings, frame), previous)
}

/// Light of a first pass, scaled to the brightness of a frame's lamps. Light can be scaled only once: [`attach_first_pass`] takes
/// nothing else, and compares the brightness.
#[derive(Clone, Debug)]
pub struct FrameLight {
    field: Arc<Field>,
    brightness: f32,
}

impl FrameLight {
    /// Scales the light of a [`first_pass_world`].
    /// - `brightness`: brightness of the frame's lamps.
    pub fn new(unit: Arc<Field>, brightness: f32) -> Self {
        let field = if brightness == 1.0 { unit } else { Arc::new(Arc::unwrap_or_clone(unit).scaled(brightness)) };
        Self { field, brightness }
    }
}

/// Computes the digest of all inputs of a solution: the frame's world around its origin, except for the common brightness of all
/// lamps, and the options of the method's first pass. Film, camera, seed and samples are not included: frames with equal keys share
/// the solution.
/// - `blocks`: value of [`first_pass_blocks`](crate::first_pass_blocks). It changes no bit of the solution, but frames that share
///   the solution also share the tasks that compute it.
pub fn first_pass_key(frame_key: &FrameKey, method: Method, blocks: u32) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"femc first pass 14");
    hasher.update(&frame_key.light.0);
    hasher.update(&solver(method).key());
    if blocks > 1 {
        hasher.update(&blocks.to_le_bytes());
    }
    *hasher.finalize().as_bytes()
}

/// Encodes a solution as bytes, for [`Field::decode`].
pub fn encode_solution(solution: &Solution) -> Vec<u8> {
    let SolveReport {
        elements,
        leaves,
        links,
        lamp_links,
        inexact_links: refused,
        rays,
        iterations,
        residual,
        bytes,
        row_sum: _,
        imbalance: _,
        ray_link_ratio: _,
        ray_correction: _,
        census: _,
    } = solution.report;
    let statistics = SolveStatistics {
        elements: elements as u64,
        leaves: leaves as u64,
        links: links as u64,
        lamp_links: lamp_links as u64,
        inexact_links: refused as u64,
        rays,
        iterations: iterations as u64,
        bytes: bytes as u64,
        residual,
    };
    solution.field.encode(&statistics)
}

/// Assigns the light of the first pass to a frame. Tables of directions are kept for the leaves that its camera sees. For
/// [`Method::Femc`], targets must follow ([`learn_targets`], [`attach_targets`]).
/// - errors: the light belongs to other surfaces, or to lamps of another brightness.
pub fn attach_first_pass(prepared: &mut Prepared, light: FrameLight) -> Result<(), FieldMismatch> {
    let FrameLight { field, brightness } = light;
    if brightness != prepared.brightness {
        return Err(FieldMismatch::Brightness);
    }
    if !field.matches_primitives(prepared.instances.iter().map(|group| group.compiled.primitives.len())) {
        return Err(FieldMismatch::Surfaces);
    }
    let field = if field.tables.is_empty() {
        field
    } else {
        let mut seen = Arc::unwrap_or_clone(field);
        femc_montecarlo::keep_seen_tables(prepared, &mut seen);
        Arc::new(seen)
    };
    prepared.set_field(Some(field));
    Ok(())
}

/// Learns the targets of a frame's paths. `None`: the method has no targets, or the frame has no field.
/// - errors: `cancel` was set.
pub fn learn_targets(
    prepared: &Prepared,
    method: Method,
    cancel: &AtomicBool,
) -> Result<Option<TargetDocument>, RenderError> {
    let Some(field) = prepared.field().filter(|_| method.has_targets()) else { return Ok(None) };
    let learned = femc_guiding::learn(prepared, field, cancel).ok_or(RenderError::Cancelled)?;
    Ok(Some(TargetDocument::new(&learned, prepared.origin)))
}

/// Assigns the targets of a frame's paths.
/// - errors: the targets belong to another first pass, or the frame has none.
pub fn attach_targets(prepared: &mut Prepared, targets: &TargetDocument) -> Result<(), TargetError> {
    let field = prepared.field().ok_or(TargetError::NoFirstPass)?;
    let guide = targets.guide(field)?;
    prepared.set_targets(Arc::new(guide));
    Ok(())
}

/// Reason why the light of a first pass does not match a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FieldMismatch {
    /// The surfaces differ.
    #[error("the light of the first pass belongs to other surfaces than the frame's")]
    Surfaces,
    /// The light is scaled to another brightness.
    #[error("the light of the first pass belongs to lamps of another brightness than the frame's")]
    Brightness,
}
