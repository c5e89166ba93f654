//! The first pass as a piece of work of its own: what its solution depends on, and the solution as bytes.

use crate::render::{RenderError, spec};
use crate::settings::{Method, Settings};
use femc_field::{Field, Statistics};
use femc_prepared::{PrepareError, Prepared, Source};
use femc_radiosity::{Options, Report, Solution};
use femc_scene::FrameKey;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Greatest error of a link where the solution guides paths: it need not be right, only know where light comes from.
const GUIDING: f32 = 1.0;

/// How exact every solution of a method is, what it may take, and what it is for.
pub(crate) fn options(method: Method) -> Options {
    match method {
        Method::Femc => Options { error: GUIDING, guides: true, ..Options::default() },
        Method::Auto | Method::Pt | Method::Fem => Options::default(),
    }
}

/// Solves the finite-element first pass of a prepared frame: its light, and what it took. It depends on what
/// [`first_pass_key`] is a digest of, and on nothing else.
/// - errors: `cancel` was set, or the solution cannot be trusted.
pub fn first_pass(prepared: &Prepared, method: Method, cancel: &AtomicBool) -> Result<Solution, RenderError> {
    let solution = femc_radiosity::solve(prepared, &options(method), cancel).map_err(|_| RenderError::Cancelled)?;
    solution.verify(prepared)?;
    Ok(solution)
}

/// The world of a frame as its first pass has it: with lamps of brightness 1. Frames with equal keys ([`first_pass_key`]) have the same one,
/// and the light of each is that of this one, as bright as its lamps are ([`brightened`]).
pub fn first_pass_world(
    source: &Source,
    settings: &Settings,
    frame: u32,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    femc_prepared::prepare_of_brightness_one(source, &spec(settings, frame), previous)
}

/// What the first pass of a [`first_pass_world`] has found, for a frame.
/// - `brightness`: of the frame's lamps.
pub fn brightened(field: Arc<Field>, brightness: f32) -> Arc<Field> {
    if brightness == 1.0 { field } else { Arc::new(Arc::unwrap_or_clone(field).times(brightness)) }
}

/// Digest of all that a solution depends on: the frame's world around its origin, but for how bright all lamps are together, and the options of
/// the method's first pass. Neither film, camera, seed nor samples: frames with equal keys share the solution.
/// - `blocks`: of [`first_pass_blocks`](crate::first_pass_blocks). They change no bit of the solution, but who shares it shares the tasks that it is made by.
pub fn first_pass_key(frame_key: &FrameKey, method: Method, blocks: u32) -> [u8; 32] {
    let Options { error, memory, guides } = options(method);
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"femc first pass 4");
    hasher.update(&frame_key.light.0);
    hasher.update(&error.to_bits().to_le_bytes());
    hasher.update(&(memory as u64).to_le_bytes());
    hasher.update(&[u8::from(guides)]);
    if blocks > 1 {
        hasher.update(&blocks.to_le_bytes());
    }
    *hasher.finalize().as_bytes()
}

/// A solution as bytes: [`Field::decode`] reads them.
pub fn encode_solution(solution: &Solution) -> Vec<u8> {
    let Report {
        elements,
        leaves,
        links,
        lamp_links,
        refused,
        rays,
        iterations,
        residual,
        bytes,
        row_sum: _,
        bounded: _,
        checked: _,
        corrected: _,
        census: _,
    } = solution.report;
    let statistics = Statistics {
        elements: elements as u64,
        leaves: leaves as u64,
        links: links as u64,
        lamp_links: lamp_links as u64,
        refused: refused as u64,
        rays,
        iterations: iterations as u64,
        bytes: bytes as u64,
        residual,
    };
    solution.field.encode(&statistics)
}

/// Gives a frame the light that the first pass of its world has found.
/// - errors: it is the light of other surfaces.
pub fn light(prepared: &mut Prepared, field: Arc<Field>) -> Result<(), OtherWorld> {
    if !field.fits(prepared.instances.iter().map(|group| group.compiled.primitives.len())) {
        return Err(OtherWorld);
    }
    prepared.field = Some(field);
    Ok(())
}

/// A field is not one of a frame's surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the light of the first pass is of other surfaces than the frame's")]
pub struct OtherWorld;
