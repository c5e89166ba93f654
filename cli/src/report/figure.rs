//! What all figures share.

use crate::exit::{Failure, failed};
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
pub fn figure(height: u32, draw: impl FnOnce(&Area<'_>) -> Drawn) -> Result<String, Failure> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        let drawn = area.fill(&WHITE).and_then(|()| draw(&area)).and_then(|()| area.present());
        drawn.map_err(|error| failed(format!("a figure cannot be drawn: {error}")))?;
    }
    Ok(svg)
}

/// An upper end of an axis on which `most` is seen.
pub fn beyond(most: f64) -> f64 {
    if most > 0.0 { most * 1.03 } else { 1.0 }
}
