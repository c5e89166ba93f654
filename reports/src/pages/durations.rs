//! Figure of the durations of tasks that compute.

use super::figure::{BLUE, FONT, axis_end, figure};
use crate::ReportError;
use crate::attempts::Row;
use femc_model::{Lane, LeaseEnding};
use plotters::prelude::*;

const BINS: usize = 40;

/// Draws the figure for attempts; nothing if no such task is done.
pub fn draw(attempts: &[Row]) -> Result<Vec<String>, ReportError> {
    let is_wanted = |row: &&Row| {
        row.ending == Some(LeaseEnding::Done)
            && row.task.is_some_and(|task| task.stage.kind.properties().lane == Lane::Compute)
    };
    let walls: Vec<f64> = attempts.iter().filter(is_wanted).map(|row| row.wall).collect();
    if walls.is_empty() {
        return Ok(Vec::new());
    }
    let end = axis_end(walls.iter().copied().fold(0.0, f64::max));
    let mut bins = [0_u32; BINS];
    for wall in &walls {
        bins[((wall / end * BINS as f64) as usize).min(BINS - 1)] += 1;
    }
    let most = bins.iter().copied().max().unwrap_or(0);
    let drawn = figure(260, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(60)
            .build_cartesian_2d(0.0..end, 0..most + most / 20 + 1)?;
        chart.configure_mesh().disable_x_mesh().label_style(FONT).x_desc("seconds").y_desc("tasks").draw()?;
        let width = end / BINS as f64;
        let bars = bins.iter().enumerate().filter(|(_, count)| **count > 0).map(|(bin, &count)| {
            let left = bin as f64 * width;
            let mut bar = Rectangle::new([(left, 0), (left + width, count)], BLUE.filled());
            bar.set_margin(0, 0, 1, 1);
            bar
        });
        chart.draw_series(bars)?;
        Ok(())
    })?;
    Ok(vec![drawn])
}
