//! The encode-picture task: encodes a frame as PNG under the exposure common to all frames.

use femc_film::{FilmError, LuminanceLevels, Picture, ToneCurve, exr};
use femc_model::{Failure, Phase, Role, StageTemplate};

use super::inputs::for_each_input;
use super::{Product, Tools, internal_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn encode_picture(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let watch = Stopwatch::start();
    task.set_phase(Phase::Working);
    let png = picture(task, tools)?;
    // The stage makes one of these, for other tasks or for users.
    let role = if stage.outputs.contains(&Role::Still) { Role::Still } else { Role::Picture };
    Ok(Product::of_one(stage, role, png, &watch))
}

/// Encodes a frame as PNG under the exposure common to all frames. A missing frame gives a card.
fn picture(task: &Task, tools: &Tools) -> Result<Vec<u8>, Failure> {
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
