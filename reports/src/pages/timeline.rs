//! Timeline of workers: a lane for each worker's computing tasks, and a second one for its joining tasks.

use super::figure::{Area, BLUE, DrawResult, FONT, ORANGE, WIDTH, axis_end, figure};
use crate::ReportError;
use crate::attempts::Row;
use femc_model::{Lane, LeaseEnding};
use plotters::prelude::*;
use std::collections::BTreeMap;

/// Kind of a bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Bar {
    Computed,
    Joined,
    Failed,
    Dropped,
}

const GRAY: RGBColor = RGBColor(170, 170, 170);
const CRIMSON: RGBColor = RGBColor(200, 40, 50);

/// Legend of the colors.
pub const LEGEND: [(&str, RGBColor); 4] =
    [("computed", BLUE), ("joined", ORANGE), ("failed", CRIMSON), ("cancelled, revoked or lost", GRAY)];

impl Bar {
    fn from_row(row: &Row) -> Self {
        match row.ending {
            Some(LeaseEnding::Failed) => Self::Failed,
            Some(LeaseEnding::Done) if is_join(row) => Self::Joined,
            Some(LeaseEnding::Done) => Self::Computed,
            Some(LeaseEnding::Cancelled | LeaseEnding::Revoked | LeaseEnding::Lost) | None => Self::Dropped,
        }
    }

    fn color(self) -> RGBColor {
        LEGEND[self as usize].1
    }
}

fn is_join(row: &Row) -> bool {
    row.task.is_some_and(|task| task.stage.kind.properties().lane == Lane::Join)
}

/// Start and end of each bar.
type Spans = Vec<(f64, f64)>;

/// Draws the timeline of attempts.
pub fn draw(attempts: &[Row]) -> Result<String, ReportError> {
    let end = axis_end(attempts.iter().map(|row| row.ended).fold(0.0, f64::max));
    // Width of half a pixel.
    let gap = end / f64::from(2 * WIDTH);
    let mut lanes: BTreeMap<(String, u64, bool), BTreeMap<Bar, Spans>> = BTreeMap::new();
    for row in attempts {
        let lane = lanes.entry((row.worker.clone(), row.instance, is_join(row))).or_default();
        lane.entry(Bar::from_row(row)).or_default().push((row.began, row.ended));
    }
    for spans in lanes.values_mut().flat_map(BTreeMap::values_mut) {
        merge_spans(spans, gap);
        // At least two pixels.
        spans.iter_mut().for_each(|(began, ended)| *ended = ended.max(*began + 4.0 * gap));
    }
    let names: Vec<String> = lanes
        .keys()
        .rev()
        .map(|(name, _, joins)| if *joins { format!("{name}, joining") } else { name.clone() })
        .collect();
    let bars: Vec<_> = lanes.into_values().rev().collect();
    figure(60 + 24 * names.len() as u32, |area| chart(area, &names, &bars, end))
}

/// Merges bars that begin within `gap` of each other.
fn merge_spans(spans: &mut Spans, gap: f64) {
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut joined = Spans::new();
    for &(began, ended) in spans.iter() {
        match joined.last_mut() {
            Some(last) if began - last.0 < gap => last.1 = last.1.max(ended),
            _ => joined.push((began, ended)),
        }
    }
    *spans = joined;
}

fn chart(area: &Area<'_>, names: &[String], bars: &[BTreeMap<Bar, Spans>], end: f64) -> DrawResult {
    let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or(0) as u32;
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .x_label_area_size(36)
        .y_label_area_size((8 * longest + 16).min(260))
        .build_cartesian_2d(0.0..end, (0..names.len().saturating_sub(1)).into_segmented())?;
    let name = |value: &SegmentValue<usize>| match value {
        SegmentValue::CenterOf(lane) | SegmentValue::Exact(lane) => names.get(*lane).cloned().unwrap_or_default(),
        SegmentValue::Last => String::new(),
    };
    chart
        .configure_mesh()
        .disable_y_mesh()
        .light_line_style(WHITE)
        .label_style(FONT)
        .x_desc("seconds")
        .y_labels(names.len())
        .y_label_formatter(&name)
        .draw()?;
    for (lane, kinds) in bars.iter().enumerate() {
        let above = || if lane + 1 < names.len() { SegmentValue::Exact(lane + 1) } else { SegmentValue::Last };
        let shape = |&(began, ended): &(f64, f64), style: ShapeStyle| {
            let mut shape = Rectangle::new([(began, SegmentValue::Exact(lane)), (ended, above())], style);
            shape.set_margin(3, 3, 0, 0);
            shape
        };
        for (bar, spans) in kinds {
            chart.draw_series(spans.iter().map(|span| shape(span, bar.color().filled())))?;
            // Outlines separate wide bars that touch. They would hide narrow bars.
            let wide = spans.iter().filter(|(began, ended)| ended - began > 8.0 * end / f64::from(WIDTH));
            chart.draw_series(wide.map(|span| shape(span, WHITE.mix(0.6).into())))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_million_short_tasks_are_no_more_bars_than_can_be_seen() {
        let mut spans: Spans = (0..1_000_000).map(|n| (f64::from(n) * 1e-3, f64::from(n + 1) * 1e-3)).collect();
        merge_spans(&mut spans, 0.5);
        assert!((500..5_000).contains(&spans.len()), "{}", spans.len());
        let mut apart = vec![(5.0, 6.0), (0.0, 1.0)];
        merge_spans(&mut apart, 0.5);
        assert_eq!(apart, [(0.0, 1.0), (5.0, 6.0)]);
    }
}
