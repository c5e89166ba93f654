//! Figure of the decreasing errors of frames.

use super::figure::{BLUE, FONT, axis_end, figure, log_ticks};
use crate::ReportError;
use crate::attempts::Row;
use plotters::coord::combinators::BindKeyPoints;
use plotters::prelude::*;
use std::collections::BTreeMap;

/// Draws the figure for attempts; nothing if no error was measured.
pub fn draw(attempts: &[Row]) -> Result<Vec<String>, ReportError> {
    let mut frames: BTreeMap<(usize, u32), Vec<(f64, f64)>> = BTreeMap::new();
    for row in attempts {
        if let (Some(task), Some(error)) = (row.task, row.relative_error.filter(|error| *error > 0.0)) {
            frames.entry((row.source, task.stage.frame)).or_default().push((row.ended, error));
        }
    }
    let Some(least) = frames.values().flatten().map(|point| point.1).reduce(f64::min) else { return Ok(Vec::new()) };
    let most = frames.values().flatten().map(|point| point.1).fold(least, f64::max);
    let (least, most) = (least * 0.8, most * 1.25);
    let end = axis_end(attempts.iter().map(|row| row.ended).fold(0.0, f64::max));
    let drawn = figure(300, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .x_label_area_size(36)
            .y_label_area_size(70)
            .build_cartesian_2d(0.0..end, (least..most).log_scale().with_key_points(log_ticks(least, most)))?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .label_style(FONT)
            .x_desc("seconds")
            .y_desc("relative error")
            .y_label_formatter(&|error| percent(*error))
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

/// Formats an error as a percentage with three digits.
fn percent(error: f64) -> String {
    let percent = error * 100.0;
    let digits = (2 - percent.log10().floor() as i32).clamp(0, 9) as usize;
    format!("{percent:.digits$} %")
}

#[cfg(test)]
mod tests {
    use super::super::figure::log_ticks;
    use super::percent;

    #[test]
    fn an_axis_of_errors_has_numbers_however_little_they_span() {
        for least in [1e-7, 0.0123, 0.05, 0.3, 7.0] {
            for span in [1.5625, 2.0, 3.0, 10.0, 1e5] {
                let (ticks, most) = (log_ticks(least, least * span), least * span);
                assert!((3..=20).contains(&ticks.len()), "{least} to {most}: {ticks:?}");
                assert!(
                    ticks.iter().all(|tick| (least * 0.999..=most * 1.001).contains(tick)),
                    "{least} to {most}: {ticks:?}"
                );
                let names: Vec<String> = ticks.iter().map(|&tick| percent(tick)).collect();
                assert!(names.windows(2).all(|pair| pair[0] != pair[1]), "{names:?}");
            }
        }
        let names: Vec<String> = log_ticks(0.0401, 0.0625).into_iter().map(percent).collect();
        assert_eq!(names, ["4.50 %", "5.00 %", "5.50 %", "6.00 %"]);
        assert_eq!(percent(0.00125), "0.125 %");
    }
}
