//! The pictures of all frames, as inputs of a sheet or a clip.

use bytes::Bytes;
use femc_film::Picture;
use femc_model::{Artifact, Failure, Role};
use rayon::prelude::*;

use super::inputs::{LostInputs, artifacts};
use super::{Tools, settings_failure};
use crate::task_table::Task;

/// Number of pictures downloaded in parallel; limits the memory use.
const BATCH: usize = 16;

/// Returns the number of frames, and their pictures in order.
pub(super) fn pictures<'a>(
    task: &'a Task,
    tools: &'a Tools,
) -> Result<(u32, impl Iterator<Item = Result<Picture, Failure>> + 'a), Failure> {
    let inputs = [artifacts(task, Role::Picture), artifacts(task, Role::Still)].concat();
    let (count, frames) = (inputs.len(), task.spec.frames.len());
    if count != frames {
        return Err(settings_failure(format!("found {count} pictures for {frames} frames")));
    }
    let batches: Vec<Vec<Artifact>> = inputs.chunks(BATCH).map(<[Artifact]>::to_vec).collect();
    Ok((count as u32, batches.into_iter().flat_map(|batch| decoded(task, &batch, tools))))
}

/// Downloads and decodes a batch of pictures; returns a failure for each one that is not available.
fn decoded(task: &Task, batch: &[Artifact], tools: &Tools) -> Vec<Result<Picture, Failure>> {
    let mut lost = LostInputs::default();
    let fetched = lost.fetch(task, batch, tools);
    let here = match fetched.and_then(|here| lost.finish().map(|()| here)) {
        Ok(here) => here,
        Err(failure) => return vec![Err(failure)],
    };
    let picture = |(artifact, bytes): &(Artifact, Bytes)| {
        let digests = vec![artifact.digest];
        Picture::from_png(bytes).map_err(|error| Failure::LostInputs { digests, message: error.to_string() })
    };
    tools.install(task, || here.par_iter().map(picture).collect())
}
