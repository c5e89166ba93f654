//! Where the samples went: a picture of tiles for each frame.

use super::figure::{Area, Drawn, FONT, WIDTH, figure};
use crate::attempts::Row;
use crate::exit::Failure;
use femc_proto::JobShape;
use plotters::prelude::*;
use std::collections::BTreeMap;

/// Most frames that are shown: evenly chosen where there are more.
const FRAMES: usize = 12;
const ACROSS: usize = 4;

/// Samples a pixel of each tile.
type Tiles = BTreeMap<u32, f64>;

/// Of tasks; nothing where no tile is done.
pub fn draw(tasks: &[Row], shape: &JobShape) -> Result<Vec<String>, Failure> {
    let grid = shape.spec.grid;
    let mut frames: BTreeMap<u32, Tiles> = BTreeMap::new();
    for row in tasks {
        let rect = row.tile.and_then(|tile| grid.rect(tile));
        if let (Some(task), Some(tile), Some(rect)) = (row.task, row.tile, rect) {
            let spp = row.samples as f64 / rect.pixels().max(1) as f64;
            *frames.entry(task.stage.frame).or_default().entry(tile).or_default() += spp;
        }
    }
    let step = frames.len().div_ceil(FRAMES).max(1);
    let shown: Vec<(u32, Tiles)> = frames.into_iter().step_by(step).collect();
    if shown.is_empty() {
        return Ok(Vec::new());
    }
    let most = shown.iter().flat_map(|(_, tiles)| tiles.values()).copied().fold(0.0, f64::max);
    let [width, height] = grid.film.map(f64::from);
    let (columns, rows) = (ACROSS.min(shown.len()), shown.len().div_ceil(ACROSS));
    let picture = f64::from(WIDTH) / columns.max(2) as f64;
    let each = (picture * (height / width).clamp(0.1, 2.0)) as u32 + 34;
    let drawn = figure(each * rows as u32, |area| {
        for ((frame, tiles), place) in shown.iter().zip(area.split_evenly((rows, columns))) {
            one(&place, *frame, tiles, shape, most)?;
        }
        Ok(())
    })?;
    Ok(vec![drawn])
}

fn one(area: &Area<'_>, frame: u32, tiles: &Tiles, shape: &JobShape, most: f64) -> Drawn {
    let least = tiles.values().copied().fold(f64::INFINITY, f64::min);
    let here = tiles.values().copied().fold(0.0, f64::max);
    let range = if least < here { format!("{least:.0} to {here:.0}") } else { format!("{here:.0}") };
    let area = area.margin(4, 4, 6, 6).titled(&format!("frame {frame}: {range} spp"), FONT)?;
    let [width, height] = shape.spec.grid.film;
    let (space, _) = area.dim_in_pixel();
    let scale = (f64::from(space) / f64::from(width)).min(f64::from(area.dim_in_pixel().1) / f64::from(height));
    let at = |x: u32, y: u32| ((f64::from(x) * scale) as i32, (f64::from(y) * scale) as i32);
    area.draw(&Rectangle::new([at(0, 0), at(width, height)], RGBColor(235, 235, 235).filled()))?;
    for (&tile, &spp) in tiles {
        let Some(rect) = shape.spec.grid.rect(tile) else { continue };
        let corners = [at(rect.x, rect.y), at(rect.x + rect.width, rect.y + rect.height)];
        area.draw(&Rectangle::new(corners, color(spp / most.max(f64::MIN_POSITIVE)).filled()))?;
    }
    Ok(())
}

/// From dark to light.
fn color(share: f64) -> RGBColor {
    let mix = |from: f64, to: f64| (from + (to - from) * share.clamp(0.0, 1.0)) as u8;
    RGBColor(mix(20.0, 253.0), mix(24.0, 200.0), mix(82.0, 60.0))
}
