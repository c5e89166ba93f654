//! The encode-sheet task: encodes all frames as a contact sheet in PNG.

use femc_film::contact_sheet;
use femc_film::picture::{NEARLY_SQUARE, sheet_width};
use femc_model::{Failure, Phase, Role, StageTemplate};

use super::pictures::pictures;
use super::{Product, Tools, internal_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(super) fn encode_sheet(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let watch = Stopwatch::start();
    task.set_phase(Phase::Working);
    let (count, pictures) = pictures(task, tools)?;
    let width = sheet_width(count);
    let small = pictures.map(|picture| Ok(picture?.shrunk_to(width))).collect::<Result<Vec<_>, Failure>>()?;
    let png = tools.install(task, || contact_sheet(&small, NEARLY_SQUARE).to_png());
    Ok(Product::of_one(stage, Role::Sheet, png.map_err(|error| internal_failure(&error))?, &watch))
}
