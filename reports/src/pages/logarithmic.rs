//! Charts with two logarithmic axes: lines through points, with bands.

use super::figure::{FONT, figure, log_ticks};
use crate::ReportError;
use plotters::coord::combinators::BindKeyPoints;
use plotters::prelude::*;
use std::fmt::Write;

/// A chart.
pub struct Chart {
    /// Titles of the axes.
    pub axes: [&'static str; 2],
    /// Lines of the chart.
    pub lines: Vec<Line>,
}

/// A line.
pub struct Line {
    /// Color of the line.
    pub color: RGBColor,
    /// Points in the order in which they are joined. Points that are not positive are left out.
    pub marks: Vec<Mark>,
}

/// A point of a line.
pub struct Mark {
    /// Position.
    pub position: (f64, f64),
    /// Half width of the band at the point.
    pub half_width: Option<f64>,
    /// Tooltip of the point.
    pub title: String,
}

/// Lower end of a band that would reach zero or below, as a fraction of the point's value.
const MIN_BAND: f64 = 0.2;

impl Mark {
    /// Returns the ends of the band.
    fn band(&self) -> (f64, f64) {
        let half = self.half_width.unwrap_or(0.0);
        ((self.position.1 - half).max(MIN_BAND * self.position.1), self.position.1 + half)
    }

    fn is_drawable(&self) -> bool {
        let is_positive = |value: f64| value > 0.0 && value.is_finite();
        is_positive(self.position.0) && is_positive(self.position.1)
    }
}

/// Draws charts of this height side by side; nothing if no point can be shown.
pub fn draw(charts: Vec<Chart>, height: u32) -> Result<Vec<String>, ReportError> {
    let shown = |mut chart: Chart| {
        chart.lines.iter_mut().for_each(|line| line.marks.retain(Mark::is_drawable));
        chart
    };
    let charts: Vec<Chart> = charts.into_iter().map(shown).filter(|it| it.marks().next().is_some()).collect();
    if charts.is_empty() {
        return Ok(Vec::new());
    }
    let mut titled = String::new();
    let svg = figure(height, |area| {
        let places = area.split_evenly((1, charts.len()));
        charts.iter().zip(places).try_for_each(|(chart, place)| chart.draw(&place, &mut titled))
    })?;
    // Points with tooltips lie on top.
    Ok(vec![svg.replacen("</svg>", &format!("{titled}</svg>"), 1)])
}

impl Chart {
    fn marks(&self) -> impl Iterator<Item = &Mark> {
        self.lines.iter().flat_map(|line| &line.marks)
    }

    fn draw(&self, area: &super::figure::Area<'_>, titled: &mut String) -> super::figure::DrawResult {
        let (left, right) = padded_range(self.marks().map(|mark| mark.position.0));
        let (low, high) = padded_range(self.marks().flat_map(|mark| <[f64; 2]>::from(mark.band())));
        let [across, up] = [(left, right), (low, high)].map(|(least, most)| axis(least, most));
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .margin_right(24)
            .x_label_area_size(40)
            .y_label_area_size(78)
            .build_cartesian_2d(
                (left..right).log_scale().with_key_points(across),
                (low..high).log_scale().with_key_points(up),
            )?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(228, 228, 228))
            .label_style(FONT)
            .x_desc(self.axes[0])
            .y_desc(self.axes[1])
            .x_label_formatter(&|value| number(*value))
            .y_label_formatter(&|value| number(*value))
            .draw()?;
        for Line { color, marks } in &self.lines {
            let edge = |upper: bool| {
                let end = move |(low, high): (f64, f64)| if upper { high } else { low };
                marks.iter().map(move |mark| (mark.position.0, end(mark.band())))
            };
            let band: Vec<(f64, f64)> = edge(true).chain(edge(false).rev()).collect();
            if marks.iter().any(|mark| mark.half_width.is_some()) {
                chart.draw_series([Polygon::new(band, color.mix(0.18))])?;
                // The band of a single point is a line. Lines also mark the band at each point.
                let whiskers = marks.iter().map(|mark| {
                    let ends = mark.band();
                    PathElement::new(vec![(mark.position.0, ends.0), (mark.position.0, ends.1)], color.mix(0.5))
                });
                chart.draw_series(whiskers)?;
            }
            chart.draw_series(LineSeries::new(marks.iter().map(|mark| mark.position), color.stroke_width(2)))?;
            for mark in marks {
                let ((x, y), RGBColor(r, g, b)) = (chart.backend_coord(&mark.position), color);
                let title = super::page::escape_html(&mark.title);
                // Writing into a string cannot fail.
                let _ = writeln!(
                    titled,
                    "<circle cx=\"{x}\" cy=\"{y}\" r=\"4\" fill=\"rgb({r},{g},{b})\" stroke=\"white\"><title>{title}</title></circle>"
                );
            }
        }
        Ok(())
    }
}

/// Returns the range of values, with some room at both ends.
fn padded_range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (least, most) = values.fold((f64::INFINITY, 0.0_f64), |(least, most), it| (least.min(it), most.max(it)));
    let room = (most / least).powf(0.06).max(1.25);
    (least / room, most * room)
}

/// Returns the decades of an axis, with more values in between if there are fewer than three.
fn axis(least: f64, most: f64) -> Vec<f64> {
    let decades: Vec<f64> =
        (least.log10().ceil() as i32..=most.log10().floor() as i32).map(|it| 10_f64.powi(it)).collect();
    if decades.len() > 2 { decades } else { log_ticks(least, most) }
}

/// Formats a number: `0.02`, `5`, `2e-5`.
fn number(value: f64) -> String {
    if !(1e-3..1e5).contains(&value) {
        return format!("{value:.1e}").replace(".0e", "e");
    }
    let decimals = (2 - value.log10().floor() as i32).clamp(0, 5) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_has_decades_or_more_numbers_where_it_is_short() {
        assert_eq!(axis(0.5, 300.0), [1.0, 10.0, 100.0]);
        assert_eq!(axis(0.9, 6.0), [1.0, 2.0, 5.0]);
        assert_eq!(
            [0.02, 5.0, 2e-5, 100.0, 0.1, 0.045, 1e5].map(number),
            ["0.02", "5", "2e-5", "100", "0.1", "0.045", "1e5"]
        );
    }

    #[test]
    fn points_have_titles_and_those_without_logarithm_are_left_out() {
        let mark = |x, y, half_width| Mark { position: (x, y), half_width, title: format!("{x} <s>") };
        let line = |marks| Line { color: RGBColor(1, 2, 3), marks };
        let marks = vec![mark(1.0, 0.5, Some(0.9)), mark(2.0, -0.1, None), mark(4.0, 0.1, Some(0.01))];
        let svg = draw(vec![Chart { axes: ["s", "error"], lines: vec![line(marks)] }], 300).expect("drawn");
        assert_eq!(svg[0].matches("<title>").count(), 2, "{}", svg[0]);
        assert!(svg[0].contains("<title>4 &lt;s&gt;</title>") && svg[0].contains("<polygon"));
        let nothing = vec![Chart { axes: ["s", "error"], lines: vec![line(vec![mark(1.0, 0.0, None)])] }];
        assert!(draw(nothing, 300).expect("no fault").is_empty());
    }
}
