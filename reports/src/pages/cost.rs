//! Figure of the cost of each frame.

use super::figure::{BLUE, FONT, axis_end, figure};
use crate::ReportError;
use crate::attempts::Row;
use plotters::prelude::*;

/// Draws the figure for frames.
pub fn draw(frames: &[Row]) -> Result<String, ReportError> {
    let number = |row: &Row| row.task.map_or(0, |task| task.stage.frame);
    let (first, last) = (frames.first().map_or(0, number), frames.last().map_or(0, number));
    let most = axis_end(frames.iter().map(|row| row.cpu).fold(0.0, f64::max));
    figure(260, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(70)
            .build_cartesian_2d((first..last).into_segmented(), 0.0..most)?;
        let name = |value: &SegmentValue<u32>| match value {
            SegmentValue::CenterOf(frame) | SegmentValue::Exact(frame) => frame.to_string(),
            SegmentValue::Last => String::new(),
        };
        chart
            .configure_mesh()
            .disable_x_mesh()
            .label_style(FONT)
            .x_desc("frame")
            .y_desc("processor seconds")
            .x_label_formatter(&name)
            .draw()?;
        let bars = frames.iter().map(|row| {
            let frame = number(row);
            let right = if frame < last { SegmentValue::Exact(frame + 1) } else { SegmentValue::Last };
            let mut bar = Rectangle::new([(SegmentValue::Exact(frame), 0.0), (right, row.cpu)], BLUE.filled());
            bar.set_margin(0, 0, 1, 1);
            bar
        });
        chart.draw_series(bars)?;
        Ok(())
    })
}
