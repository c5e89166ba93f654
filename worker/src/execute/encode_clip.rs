//! The encode-clip task: encodes all frames as a clip.

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use femc_model::{Failure, Phase, Role, StageTemplate};

use super::pictures::pictures;
use super::{Product, Tools, internal_failure, settings_failure};
use crate::clip::{self, ClipError};
use crate::clock::Stopwatch;
use crate::extra_outputs::{ExtraOutputs, Video};
use crate::task_table::Task;

pub(super) fn encode_clip(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let watch = Stopwatch::start();
    task.set_phase(Phase::Working);
    Ok(Product::of_one(stage, Role::Clip, clip(task, stage, tools)?, &watch))
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
