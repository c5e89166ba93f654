//! Page about measurements: summaries, and maps of the grids with isolines.

use super::figure::{DrawResult, FONT, WIDTH, figure};
use super::isolines::{ValueGrid, levels};
use super::page::Page;
use crate::ReportError;
use crate::attempts::visible_cells;
use crate::human;
use crate::measure::{MeasureReport, reading_columns, summary_columns};
use femc_pipeline::measure::ReadingRow;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Most readings of points in the table.
const MAX_ROWS: usize = 200;
/// Greatest height of a map, pixels.
const MAX_HEIGHT: f64 = 900.0;
/// Space above a map, for its title, pixels.
const TITLE: i32 = 26;
/// Largest number of points of a grid whose values are written on the map.
const MAX_WRITTEN: usize = 160;

/// Returns the HTML file of measurements.
pub fn html(report: &MeasureReport) -> Result<String, ReportError> {
    let mut page = Page::new(&format!("Light measured in {}", report.scene));
    page.facts(&[
        ("Frame", report.frame.to_string()),
        ("Readings", report.readings.iter().filter(|row| row.lamp.is_none()).count().to_string()),
        ("Rays", human::quantity(report.rays as f64)),
        ("Readings that did not reach the error", report.not_converged.to_string()),
        ("Samples that were not finite", report.bad_samples.to_string()),
    ]);
    if !report.summaries.is_empty() {
        let about =
            "Errors are half widths of 95 % confidence intervals. Uniformity: the smallest reading over the mean.";
        page.section("Summary", about);
        let (titles, cells) = visible_cells(&summary_columns(), &report.summaries);
        page.cells(&titles, &cells);
    }
    for part in report.readings.chunk_by(|a, b| a.part == b.part) {
        let whole: Vec<&ReadingRow> = part.iter().filter(|row| row.lamp.is_none()).collect();
        if let Some(map) = Map::new(&whole) {
            let about = format!("{}, {}. Lines connect equal values.", map.quantity, map.unit);
            page.section(&format!("Map of {}", part[0].part), &about);
            page.figure(&map.draw()?);
        }
    }
    let is_point = |row: &&ReadingRow| row.column.is_none() && row.area.is_none();
    let points: Vec<ReadingRow> = report.readings.iter().filter(is_point).take(MAX_ROWS).cloned().collect();
    if !points.is_empty() {
        page.section("Points", "Errors are half widths of 95 % confidence intervals.");
        let (titles, cells) = visible_cells(&reading_columns(), &points);
        page.cells(&titles, &cells);
    }
    Ok(page.finish())
}

/// Map of a grid.
struct Map {
    columns: usize,
    rows: usize,
    values: Vec<f64>,
    /// Height of the grid over its width, m/m.
    aspect: f64,
    quantity: &'static str,
    unit: &'static str,
}

impl Map {
    /// Creates the map of a grid's readings; `None` for other readings.
    fn new(part: &[&ReadingRow]) -> Option<Self> {
        let (first, last) = (part.first()?, part.last()?);
        let (columns, rows) = (last.column? as usize + 1, last.row? as usize + 1);
        let step = |at: usize| {
            let (a, b) = (first.position, part.get(at)?.position);
            Some([0, 1, 2].map(|axis| b[axis] - a[axis]).iter().map(|x| x * x).sum::<f64>().sqrt())
        };
        let along = if columns > 1 { step(1)? } else { 1.0 };
        let across = if rows > 1 { step(columns)? } else { along };
        let aspect = (across * rows as f64) / (along * columns as f64);
        let values: Vec<f64> = part.iter().map(|row| row.value).collect();
        let is_whole = values.len() == columns * rows && aspect.is_finite();
        is_whole.then_some(Self {
            columns,
            rows,
            values,
            aspect,
            quantity: first.quantity.word(),
            unit: first.quantity.unit(),
        })
    }

    /// Draws the cells by value, the isolines, and the values where there is space.
    fn draw(&self) -> Result<String, ReportError> {
        let least = self.values.iter().copied().fold(f64::INFINITY, f64::min);
        let greatest = self.values.iter().copied().fold(0.0, f64::max);
        let width = f64::from(WIDTH).min(MAX_HEIGHT / self.aspect);
        let cell = [width / self.columns as f64, width * self.aspect / self.rows as f64];
        let height = (cell[1] * self.rows as f64) as u32;
        let title = format!("{} to {} {}", shortest(least), shortest(greatest), self.unit);
        figure(height + TITLE as u32, |area| {
            area.draw(&Text::new(title, (4, 4), FONT.into_font()))?;
            // Rows go up, as in a plan.
            let place = |[column, row]: [f64; 2]| {
                (((column + 0.5) * cell[0]) as i32, TITLE + ((self.rows as f64 - 0.5 - row) * cell[1]) as i32)
            };
            let center = |at: usize| [(at % self.columns) as f64, (at / self.columns) as f64];
            for (at, value) in self.values.iter().enumerate() {
                let [column, row] = center(at);
                let corners = [place([column - 0.5, row + 0.5]), place([column + 0.5, row - 0.5])];
                area.draw(&Rectangle::new(corners, color(value / greatest.max(f64::MIN_POSITIVE)).filled()))?;
            }
            self.draw_isolines(area, least, greatest, place)?;
            if self.values.len() <= MAX_WRITTEN {
                let style = ("sans-serif", 12).into_font().color(&BLACK).pos(Pos::new(HPos::Center, VPos::Center));
                for (at, value) in self.values.iter().enumerate() {
                    area.draw(&Text::new(shortest(*value), place(center(at)), style.clone()))?;
                }
            }
            Ok(())
        })
    }

    fn draw_isolines(
        &self,
        area: &super::figure::Area<'_>,
        least: f64,
        greatest: f64,
        place: impl Fn([f64; 2]) -> (i32, i32),
    ) -> DrawResult {
        let grid = ValueGrid { columns: self.columns, values: &self.values };
        let style = ("sans-serif", 12).into_font().color(&RGBColor(120, 0, 60));
        for level in levels(least, greatest) {
            let segments = grid.isoline(level);
            for segment in &segments {
                area.draw(&PathElement::new(segment.map(&place).to_vec(), RGBColor(120, 0, 60).stroke_width(2)))?;
            }
            if let Some([point, _]) = segments.get(segments.len() / 2) {
                area.draw(&Text::new(shortest(level), place(*point), style.clone()))?;
            }
        }
        Ok(())
    }
}

/// Formats a number with three digits, without zeros at the end.
fn shortest(value: f64) -> String {
    let magnitude = if value > 0.0 { value.log10().floor() as i32 } else { 0 };
    let decimals = usize::try_from(2 - magnitude).unwrap_or(0);
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Maps a share of the greatest value to a color from blue over white to yellow, light enough for black text.
fn color(share: f64) -> RGBColor {
    let share = share.clamp(0.0, 1.0);
    let mix = |from: f64, to: f64, part: f64| (from + (to - from) * part) as u8;
    match share {
        ..0.5 => {
            RGBColor(mix(120.0, 245.0, share * 2.0), mix(150.0, 245.0, share * 2.0), mix(200.0, 245.0, share * 2.0))
        }
        _ => RGBColor(
            mix(245.0, 255.0, share * 2.0 - 1.0),
            mix(245.0, 200.0, share * 2.0 - 1.0),
            mix(245.0, 60.0, share * 2.0 - 1.0),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::shortest;

    #[test]
    fn numbers_of_a_map_have_three_digits() {
        let shown = [112.43, 98.973, 9.8801, 0.5, 0.01234, 12_345.6, 20.0, 0.0].map(shortest);
        assert_eq!(shown, ["112", "99", "9.88", "0.5", "0.0123", "12346", "20", "0"]);
    }
}
