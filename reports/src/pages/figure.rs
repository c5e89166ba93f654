//! What all figures share.

use crate::ReportError;
use plotters::coord::Shift;
use plotters::drawing::DrawingAreaErrorKind;
use plotters::prelude::*;
use std::io;

/// A surface to draw on.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// Whether it was drawn.
pub type Drawn = Result<(), DrawingAreaErrorKind<io::Error>>;

/// Pixels of every figure's width.
pub const WIDTH: u32 = 1000;
/// Of words.
pub const FONT: (&str, u32) = ("sans-serif", 13);
/// What is done.
pub const BLUE: RGBColor = RGBColor(46, 109, 164);
/// Of another kind.
pub const ORANGE: RGBColor = RGBColor(217, 130, 43);

/// An SVG of this height, pixels.
pub fn figure(height: u32, draw: impl FnOnce(&Area<'_>) -> Drawn) -> Result<String, ReportError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        let drawn = area.fill(&WHITE).and_then(|()| draw(&area)).and_then(|()| area.present());
        drawn.map_err(|error| ReportError::Figure(error.to_string()))?;
    }
    Ok(svg)
}

/// An upper end of an axis on which `most` is seen.
pub fn beyond(most: f64) -> f64 {
    if most > 0.0 { most * 1.03 } else { 1.0 }
}

/// Round values of a logarithmic axis: 1, 2 and 5 of each decade, or, where these are fewer than three, equal steps.
pub fn ticks(least: f64, most: f64) -> Vec<f64> {
    const ROUND: [f64; 3] = [1.0, 2.0, 5.0];
    let decade = |value: f64| value.log10().floor() as i32;
    let rounds = |decade: i32| ROUND.map(|digit| digit * 10_f64.powi(decade));
    let ticks: Vec<f64> =
        (decade(least)..=decade(most)).flat_map(rounds).filter(|tick| (least..=most).contains(tick)).collect();
    if ticks.len() > 2 {
        return ticks;
    }
    let third = (most - least) / 3.0;
    let step =
        rounds(decade(third)).into_iter().filter(|step| *step <= third).fold(10_f64.powi(decade(third)), f64::max);
    let first = (least / step).ceil() as u64;
    let last = (most / step).floor() as u64;
    (first..=last).map(|number| number as f64 * step).collect()
}
