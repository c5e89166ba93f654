//! Tables and documents of measurements (`femc measure`).

use crate::attempts::{Audience, Cell, Column, Kind, column};
use femc_pipeline::measure::{FrameReadings, ReadingRow, SummaryRow};
use serde::Serialize;

use Audience::{Everyone, Programs};
use Kind::{Count, Number, Share, Text};

/// Result of `femc measure`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasureReport {
    /// Scene file.
    pub scene: String,
    /// Frame, from 1.
    pub frame: u32,
    /// Seed.
    pub seed: u64,
    /// Elapsed seconds.
    pub seconds: f64,
    /// Number of rays.
    pub rays: u64,
    /// Number of samples that were not finite and are left out.
    pub bad_samples: u64,
    /// Number of readings that did not reach the requested error.
    pub not_converged: u64,
    /// Readings; each is followed by its lamps, if these were requested.
    pub readings: Vec<ReadingRow>,
    /// Summaries of the parts that have several readings.
    pub summaries: Vec<SummaryRow>,
}

impl MeasureReport {
    /// Creates the report of a frame.
    /// - `scene`: scene file; `seconds`: elapsed seconds.
    pub fn new(scene: String, seconds: f64, frame: FrameReadings) -> Self {
        Self {
            scene,
            frame: frame.id.frame,
            seed: frame.seed,
            seconds,
            rays: frame.rays,
            bad_samples: frame.bad_samples,
            not_converged: frame.not_converged,
            readings: frame.readings,
            summaries: frame.summaries,
        }
    }
}

/// Returns a summary of each part, in order, followed by its lamps. A single reading is its own mean.
pub fn part_rows(frame: &FrameReadings) -> Vec<SummaryRow> {
    let single = |row: &ReadingRow| SummaryRow {
        part: row.part.clone(),
        quantity: row.quantity,
        unit: row.unit.clone(),
        lamp: row.lamp.clone(),
        readings: 1,
        area: row.area,
        mean: row.value,
        mean_half_width: row.half_width,
        least: None,
        greatest: None,
        uniformity: None,
        dark: u64::from(row.value == 0.0),
        lit_uniformity: None,
    };
    let parts = frame.readings.chunk_by(|a, b| a.part == b.part);
    let rows = |part: &[ReadingRow]| -> Vec<SummaryRow> {
        let summaries: Vec<SummaryRow> =
            frame.summaries.iter().filter(|row| row.part == part[0].part).cloned().collect();
        if summaries.is_empty() { part.iter().map(single).collect() } else { summaries }
    };
    parts.flat_map(rows).collect()
}

fn relative(value: f64, half_width: f64) -> Cell {
    if value > 0.0 { Cell::Real(half_width / value) } else { Cell::Empty }
}

fn real(value: Option<f64>) -> Cell {
    value.map_or(Cell::Empty, Cell::Real)
}

fn number(value: Option<u32>) -> Cell {
    value.map_or(Cell::Empty, |value| Cell::Count(value.into()))
}

/// Returns the columns of readings.
pub fn reading_columns() -> Vec<Column<ReadingRow>> {
    vec![
        column("part", "part", Text, Everyone, |row| Cell::Text(row.part.clone())),
        column("number", "number", Count, Everyone, |row| Cell::Count(row.number.into())),
        column("column", "column", Count, Programs, |row| number(row.column)),
        column("row", "row", Count, Programs, |row| number(row.row)),
        column("x_m", "x", Number, Everyone, |row| Cell::Real(row.position[0])),
        column("y_m", "y", Number, Everyone, |row| Cell::Real(row.position[1])),
        column("z_m", "z", Number, Everyone, |row| Cell::Real(row.position[2])),
        column("quantity", "quantity", Text, Everyone, |row| Cell::Text(row.quantity.word().into())),
        column("lamp", "lamp", Text, Audience::Comparing, |row| row.lamp.clone().into()),
        column("value", "value", Number, Everyone, |row| Cell::Real(row.value)),
        column("unit", "", Text, Everyone, |row| Cell::Text(row.unit.clone())),
        column("half_width", "half width", Number, Programs, |row| Cell::Real(row.half_width)),
        column("relative_error", "error", Share, Everyone, |row| relative(row.value, row.half_width)),
        column("r", "r", Number, Programs, |row| real(row.color.map(|color| color[0]))),
        column("g", "g", Number, Programs, |row| real(row.color.map(|color| color[1]))),
        column("b", "b", Number, Programs, |row| real(row.color.map(|color| color[2]))),
        column("area_m2", "area", Number, Programs, |row| real(row.area)),
        column("samples", "samples", Count, Programs, |row| Cell::Count(row.samples)),
        column("bad_samples", "bad samples", Count, Programs, |row| Cell::Count(row.bad_samples)),
        column("converged", "converged", Count, Programs, |row| Cell::Count(row.converged.into())),
    ]
}

/// Returns the columns of summaries.
pub fn summary_columns() -> Vec<Column<SummaryRow>> {
    vec![
        column("part", "part", Text, Everyone, |row| Cell::Text(row.part.clone())),
        column("quantity", "quantity", Text, Everyone, |row| Cell::Text(row.quantity.word().into())),
        column("lamp", "lamp", Text, Audience::Comparing, |row| row.lamp.clone().into()),
        column("readings", "readings", Count, Everyone, |row| Cell::Count(row.readings)),
        column("area_m2", "m2", Number, Everyone, |row| real(row.area)),
        column("mean", "mean", Number, Everyone, |row| Cell::Real(row.mean)),
        column("unit", "", Text, Everyone, |row| Cell::Text(row.unit.clone())),
        column("mean_error", "error", Share, Everyone, |row| relative(row.mean, row.mean_half_width)),
        column("least", "least", Number, Everyone, |row| real(row.least)),
        column("greatest", "greatest", Number, Everyone, |row| real(row.greatest)),
        column("uniformity", "uniformity", Number, Everyone, |row| real(row.uniformity)),
        column("dark", "dark", Count, Everyone, |row| Cell::Count(row.dark)),
        column("lit_uniformity", "of the lit", Number, Programs, |row| real(row.lit_uniformity)),
    ]
}
