//! Figure of the cost of each variant.

use super::figure::{BLUE, FONT, axis_end, figure};
use crate::ReportError;
use crate::attempts::Row;
use plotters::prelude::*;

/// Most bars that are shown, the most expensive ones.
const MAX_BARS: usize = 60;

/// Draws the figure for variants or jobs.
pub fn draw(variants: &[Row]) -> Result<String, ReportError> {
    let mut shown: Vec<(String, f64)> = variants.iter().map(|row| (name(row), row.cpu)).collect();
    if shown.len() > MAX_BARS {
        shown.sort_by(|a, b| b.1.total_cmp(&a.1));
        shown.truncate(MAX_BARS);
    }
    // The first one comes on top.
    shown.reverse();
    let most = axis_end(shown.iter().map(|(_, cpu)| *cpu).fold(0.0, f64::max));
    let longest = shown.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0) as u32;
    figure(60 + 18 * shown.len() as u32, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size((7 * longest + 16).min(420))
            .build_cartesian_2d(0.0..most, (0..shown.len().saturating_sub(1)).into_segmented())?;
        let label = |value: &SegmentValue<usize>| match value {
            SegmentValue::CenterOf(bar) | SegmentValue::Exact(bar) => {
                shown.get(*bar).map(|(name, _)| name.clone()).unwrap_or_default()
            }
            SegmentValue::Last => String::new(),
        };
        chart
            .configure_mesh()
            .disable_y_mesh()
            .light_line_style(WHITE)
            .label_style(FONT)
            .x_desc("processor seconds")
            .y_labels(shown.len())
            .y_label_formatter(&label)
            .draw()?;
        let bars = shown.iter().enumerate().map(|(bar, &(_, cpu))| {
            let above = if bar + 1 < shown.len() { SegmentValue::Exact(bar + 1) } else { SegmentValue::Last };
            let mut bar = Rectangle::new([(0.0, SegmentValue::Exact(bar)), (cpu, above)], BLUE.filled());
            bar.set_margin(2, 2, 0, 0);
            bar
        });
        chart.draw_series(bars)?;
        Ok(())
    })
}

fn name(row: &Row) -> String {
    row.variant.clone().unwrap_or_else(|| format!("job {}", row.job))
}
