//! Figures of the distribution of samples: a picture of tiles for each frame.

use super::figure::{Area, DrawResult, FONT, WIDTH, figure};
use crate::ReportError;
use crate::attempts::{JobRecord, Row};
use femc_model::Grid;
use plotters::prelude::*;
use std::collections::BTreeMap;

/// Most frames that are shown. If there are more, they are chosen evenly.
const MAX_FRAMES: usize = 12;
const ACROSS: usize = 4;

/// Longest title of a picture, in characters.
const TITLE: usize = 38;

/// Samples per pixel of each tile.
type Tiles = BTreeMap<u32, f64>;

/// Picture of a frame.
struct Picture {
    title: String,
    grid: Grid,
    tiles: Tiles,
}

/// Draws the figures for tasks; nothing if no tile is done.
pub fn draw(tasks: &[Row], records: &[JobRecord]) -> Result<Vec<String>, ReportError> {
    let mut frames: BTreeMap<(usize, u32), Tiles> = BTreeMap::new();
    for row in tasks {
        let rect = row.tile.and_then(|tile| records.get(row.source)?.spec.grid.rect(tile));
        if let (Some(task), Some(tile), Some(rect)) = (row.task, row.tile, rect) {
            let spp = row.samples as f64 / rect.pixels().max(1) as f64;
            *frames.entry((row.source, task.stage.frame)).or_default().entry(tile).or_default() += spp;
        }
    }
    let step = frames.len().div_ceil(MAX_FRAMES).max(1);
    let picture = |((source, frame), tiles): ((usize, u32), Tiles)| {
        let record = records.get(source)?;
        let title = record.variant.as_ref().map_or_else(String::new, |variant| format!("{variant}, "));
        Some(Picture { title: format!("{title}frame {frame}"), grid: record.spec.grid, tiles })
    };
    let shown: Vec<Picture> = frames.into_iter().step_by(step).filter_map(picture).collect();
    let Some(first) = shown.first() else { return Ok(Vec::new()) };
    let most = shown.iter().flat_map(|picture| picture.tiles.values()).copied().fold(0.0, f64::max);
    let [width, height] = first.grid.film.map(f64::from);
    let (columns, rows) = (ACROSS.min(shown.len()), shown.len().div_ceil(ACROSS));
    let across = f64::from(WIDTH) / columns.max(2) as f64;
    let each = (across * (height / width).clamp(0.1, 2.0)) as u32 + 34;
    let drawn = figure(each * rows as u32, |area| {
        shown.iter().zip(area.split_evenly((rows, columns))).try_for_each(|(picture, place)| picture.draw(&place, most))
    })?;
    Ok(vec![drawn])
}

impl Picture {
    fn draw(&self, area: &Area<'_>, most: f64) -> DrawResult {
        let least = self.tiles.values().copied().fold(f64::INFINITY, f64::min);
        let here = self.tiles.values().copied().fold(0.0, f64::max);
        let range = if least < here { format!("{least:.0} to {here:.0}") } else { format!("{here:.0}") };
        let title = shortened(&format!("{}: {range} spp", self.title));
        let area = area.margin(4, 4, 6, 6).titled(&title, FONT)?;
        let [width, height] = self.grid.film;
        let (across, down) = area.dim_in_pixel();
        let scale = (f64::from(across) / f64::from(width)).min(f64::from(down) / f64::from(height));
        let at = |x: u32, y: u32| ((f64::from(x) * scale) as i32, (f64::from(y) * scale) as i32);
        area.draw(&Rectangle::new([at(0, 0), at(width, height)], RGBColor(235, 235, 235).filled()))?;
        for (&tile, &spp) in &self.tiles {
            let Some(rect) = self.grid.rect(tile) else { continue };
            let corners = [at(rect.x, rect.y), at(rect.x + rect.width, rect.y + rect.height)];
            area.draw(&Rectangle::new(corners, color(spp / most.max(f64::MIN_POSITIVE)).filled()))?;
        }
        Ok(())
    }
}

/// Returns the end of a text that is too long, because the end says the most.
fn shortened(text: &str) -> String {
    let length = text.chars().count();
    if length <= TITLE {
        text.to_owned()
    } else {
        format!("…{}", text.chars().skip(length + 1 - TITLE).collect::<String>())
    }
}

/// Maps a fraction to a color from dark to light.
fn color(share: f64) -> RGBColor {
    let mix = |from: f64, to: f64| (from + (to - from) * share.clamp(0.0, 1.0)) as u8;
    RGBColor(mix(20.0, 253.0), mix(24.0, 200.0), mix(82.0, 60.0))
}
