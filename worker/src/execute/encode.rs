//! The encode task: stills under one exposure, a contact sheet, a clip. The reduce task of levels is here, too.

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use femc_film::picture::{NEARLY_SQUARE, sheet_width};
use femc_film::{FilmError, Frame, LuminanceLevels, Picture, SampleRange, Tile, ToneCurve, contact_sheet, exr};
use femc_model::{Artifact, Failure, Phase, Role, StageTemplate};
use rayon::prelude::*;

use super::inputs::{LostInputs, artifacts, expected_samples, for_each_input, tile_span, tiling};
use super::{Product, Tools, settings_failure};
use crate::clip::{self, ClipError};
use crate::clock::Stopwatch;
use crate::extra_outputs::{ExtraOutputs, Video};
use crate::task_table::Task;

/// Number of inputs downloaded in parallel; limits the memory use.
const BATCH: usize = 16;

/// Computes the levels of thumbnails, or the sum of levels.
pub(super) fn levels(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    let sum = if stage.needs.iter().any(|need| need.role == Role::Thumbnail) {
        LuminanceLevels::from_thumbnails(&thumbnails(task, stage, tools)?)
    } else {
        let mut sum = LuminanceLevels::default();
        for_each_input(task, Role::Levels, tools, |bytes| {
            LuminanceLevels::decode(bytes).map(|levels| sum.merge(&levels))
        })?;
        sum
    };
    tracing::debug!(blocks = sum.blocks(), seconds = watch.seconds(), "counted");
    Ok(product(stage, Role::Levels, sum.encode(), &watch))
}

/// Combines the thumbnails of a group of tiles. Checks that each tile holds exactly the samples that it was given.
fn thumbnails(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Frame, Failure> {
    let span = tile_span(task, stage, Role::Thumbnail)?;
    let small = tiling(task)?.thumbnail_tiling();
    let small =
        small.ok_or_else(|| settings_failure("the tile width of the job is not a multiple of the block size"))?;
    let mut frame = Frame::new(small);
    for_each_input(task, Role::Thumbnail, tools, |bytes| frame.insert(Tile::decode_thumbnail(bytes)?).map(drop))?;
    let mut places = (span.start as usize..span.end as usize).enumerate();
    match places.find(|&(place, index)| SampleRange::join(frame.ranges(index)) != Some(expected_samples(task, place))) {
        None => Ok(frame),
        Some((_, index)) => {
            let message = format!("thumbnail {index} has wrong samples: {:?}", frame.ranges(index));
            Err(Failure::Panicked { message })
        }
    }
}

pub(super) fn encode(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let watch = Stopwatch::start();
    task.set_phase(Phase::Working);
    match stage.outputs.first() {
        Some(&role @ (Role::Picture | Role::Still)) => Ok(product(stage, role, still(task, tools)?, &watch)),
        Some(Role::Sheet) => Ok(product(stage, Role::Sheet, sheet(task, tools)?, &watch)),
        Some(Role::Clip) => Ok(product(stage, Role::Clip, clip(task, stage, tools)?, &watch)),
        _ => Err(settings_failure("invalid job graph: an encode stage has no output that it can make")),
    }
}

fn product(stage: &StageTemplate, role: Role, bytes: Vec<u8>, watch: &Stopwatch) -> Product {
    let mut product = Product::default();
    product.put(stage, role, || bytes);
    product.result.seconds = watch.seconds();
    product
}

/// Encodes a frame as PNG under the exposure common to all frames. A missing frame gives a card.
fn still(task: &Task, tools: &Tools) -> Result<Vec<u8>, Failure> {
    let mut curve = ToneCurve::from_levels(&LuminanceLevels::default());
    for_each_input(task, Role::Levels, tools, |bytes| {
        LuminanceLevels::decode(bytes).map(|levels| curve = ToneCurve::from_levels(&levels))
    })?;
    let [width, height] = task.spec.grid.film;
    let mut picture = None;
    for_each_input(task, Role::Image, tools, |bytes| {
        let image = exr::decode(std::io::Cursor::new(bytes))?.image;
        if [image.width, image.height] != [width, height] {
            return Err(FilmError::Corrupt("the image and the job's film differ in size"));
        }
        picture = Some(curve.picture(&image));
        Ok(())
    })?;
    let picture = picture.unwrap_or_else(|| Picture::placeholder(width, height));
    tools.install(task, || picture.to_png()).map_err(|error| internal_failure(&error))
}

/// Returns the number of frames, and their pictures in order.
fn pictures<'a>(
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

/// Encodes all frames as a contact sheet in PNG.
fn sheet(task: &Task, tools: &Tools) -> Result<Vec<u8>, Failure> {
    let (count, pictures) = pictures(task, tools)?;
    let width = sheet_width(count);
    let small = pictures.map(|picture| Ok(picture?.shrunk_to(width))).collect::<Result<Vec<_>, Failure>>()?;
    tools.install(task, || contact_sheet(&small, NEARLY_SQUARE).to_png()).map_err(|error| internal_failure(&error))
}

/// Encodes all frames as a clip.
fn clip(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Vec<u8>, Failure> {
    let outputs: ExtraOutputs = serde_json::from_str(&stage.options).map_err(settings_failure)?;
    let video = outputs
        .video
        .filter(Video::is_valid)
        .ok_or_else(|| settings_failure("the stage's options describe no valid clip"))?;
    let (count, pictures) = pictures(task, tools)?;
    let folder = Folder::new().map_err(|error| Failure::Resources { message: error.to_string() })?;
    let path = folder.0.join(&video.name);
    let is_cancelled = || task.is_cancelled();
    clip::write(&path, task.spec.grid.film, video.rate, count, pictures, &is_cancelled).map_err(
        |error| match error {
            ClipError::Picture(failure) => failure,
            ClipError::Cancelled => Failure::Cancelled,
            ClipError::Film(_) | ClipError::Ffmpeg(_) => internal_failure(&error),
        },
    )?;
    fs::read(&path).map_err(|error| internal_failure(&format!("cannot read the encoded clip: {error}")))
}

/// A temporary folder for an encoder's file; removed on drop.
struct Folder(PathBuf);

impl Folder {
    fn new() -> std::io::Result<Self> {
        static SERIAL: AtomicU64 = AtomicU64::new(0);
        let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("femc-clip-{}-{serial}", std::process::id()));
        fs::create_dir(&path).map(|()| Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // The system cleans up what cannot be removed here.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Returns a failure that is not caused by the inputs.
fn internal_failure(error: &dyn std::fmt::Display) -> Failure {
    Failure::Panicked { message: error.to_string() }
}
