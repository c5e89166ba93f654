//! Common parts of all figures.

use crate::ReportError;
use plotters::coord::Shift;
use plotters::drawing::DrawingAreaErrorKind;
use plotters::prelude::*;
use std::io;

/// A surface to draw on.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// Result of drawing.
pub type DrawResult = Result<(), DrawingAreaErrorKind<io::Error>>;

/// Width of every figure, pixels.
pub const WIDTH: u32 = 1000;
/// Font of labels.
pub const FONT: (&str, u32) = ("sans-serif", 13);
/// Color of finished work.
pub const BLUE: RGBColor = RGBColor(46, 109, 164);
/// Color of a second kind of work.
pub const ORANGE: RGBColor = RGBColor(217, 130, 43);

/// Draws an SVG of this height, pixels.
pub fn figure(height: u32, draw: impl FnOnce(&Area<'_>) -> DrawResult) -> Result<String, ReportError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        let drawn = area.fill(&WHITE).and_then(|()| draw(&area)).and_then(|()| area.present());
        drawn.map_err(|error| ReportError::Figure(error.to_string()))?;
    }
    Ok(svg)
}

/// Returns an upper end for an axis that shows `max`.
pub fn axis_end(max: f64) -> f64 {
    if max > 0.0 { max * 1.03 } else { 1.0 }
}

/// Returns round values for a logarithmic axis: 1, 2 and 5 of each decade, or equal steps if these are fewer than three.
pub fn log_ticks(min: f64, max: f64) -> Vec<f64> {
    const ROUND: [f64; 3] = [1.0, 2.0, 5.0];
    let decade = |value: f64| value.log10().floor() as i32;
    let rounds = |decade: i32| ROUND.map(|digit| digit * 10_f64.powi(decade));
    let ticks: Vec<f64> =
        (decade(min)..=decade(max)).flat_map(rounds).filter(|tick| (min..=max).contains(tick)).collect();
    if ticks.len() > 2 {
        return ticks;
    }
    let third = (max - min) / 3.0;
    let step =
        rounds(decade(third)).into_iter().filter(|step| *step <= third).fold(10_f64.powi(decade(third)), f64::max);
    let first = (min / step).ceil() as u64;
    let last = (max / step).floor() as u64;
    (first..=last).map(|number| number as f64 * step).collect()
}
