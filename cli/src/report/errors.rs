//! How the frames' errors fall.

use super::figure::{BLUE, FONT, beyond, figure};
use crate::attempts::Row;
use crate::exit::Failure;
use plotters::prelude::*;
use std::collections::BTreeMap;

/// Of attempts; nothing where no error was measured.
pub fn draw(attempts: &[Row]) -> Result<Vec<String>, Failure> {
    let mut frames: BTreeMap<(usize, u32), Vec<(f64, f64)>> = BTreeMap::new();
    for row in attempts {
        if let (Some(task), Some(error)) = (row.task, row.relative_error.filter(|error| *error > 0.0)) {
            frames.entry((row.source, task.stage.frame)).or_default().push((row.ended, error));
        }
    }
    let Some(least) = frames.values().flatten().map(|point| point.1).reduce(f64::min) else { return Ok(Vec::new()) };
    let most = frames.values().flatten().map(|point| point.1).fold(least, f64::max);
    let end = beyond(attempts.iter().map(|row| row.ended).fold(0.0, f64::max));
    let drawn = figure(300, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(70)
            .build_cartesian_2d(0.0..end, (least * 0.8..most * 1.25).log_scale())?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .label_style(FONT)
            .x_desc("seconds")
            .y_desc("relative error")
            .y_label_formatter(&|error| format!("{:.2} %", error * 100.0))
            .draw()?;
        for points in frames.values_mut() {
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            chart.draw_series(LineSeries::new(points.iter().copied(), BLUE.mix(0.5)))?;
            chart.draw_series(points.iter().map(|&point| Circle::new(point, 3, BLUE.filled())))?;
        }
        Ok(())
    })?;
    Ok(vec![drawn])
}
