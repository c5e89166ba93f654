//! Tables and documents of measurements (`femc measure`).

use crate::attempts::{Audience, Cell, Column, Kind, column};
use femc_pipeline::measure::{Interval, Place, Quantity, Reading, Summary};
use serde::Serialize;

use Audience::{Everyone, Programs};
use Kind::{Count, Number, Share, Text};

/// A reading, or the part of it that comes from one lamp.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReadingRow {
    /// Name of the part of the request.
    pub part: String,
    /// Number within the part, from 0.
    pub number: u32,
    /// Column in a grid, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<u32>,
    /// Row in a grid, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub row: Option<u32>,
    /// Position in the world, m.
    pub position: [f64; 3],
    /// Quantity.
    pub quantity: Quantity,
    /// Unit of the values.
    pub unit: &'static str,
    /// Lamp; `None`: all light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lamp: Option<String>,
    /// Value.
    pub value: f64,
    /// Half width of the 95 % confidence interval.
    pub half_width: f64,
    /// Light by channel; only of all light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color: Option<[f64; 3]>,
    /// Area of a cell, m2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub area: Option<f64>,
    /// Number of samples.
    pub samples: u64,
    /// Number of samples that were not finite and are left out.
    pub bad_samples: u64,
    /// Whether the requested error was reached.
    pub converged: bool,
}

/// A summary of the readings of a part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SummaryRow {
    /// Name of the part of the request.
    pub part: String,
    /// Quantity.
    pub quantity: Quantity,
    /// Unit of the values.
    pub unit: &'static str,
    /// Lamp; `None`: all light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lamp: Option<String>,
    /// Number of readings.
    pub readings: u64,
    /// Area, m2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub area: Option<f64>,
    /// Mean.
    pub mean: f64,
    /// Half width of the mean's 95 % confidence interval.
    pub mean_half_width: f64,
    /// Smallest reading; only of all light.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least: Option<f64>,
    /// Largest reading.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub greatest: Option<f64>,
    /// Smallest reading over the mean.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uniformity: Option<f64>,
    /// Number of readings without light. Their points may lie within objects.
    pub dark: u64,
    /// Smallest reading with light over the mean of these readings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lit_uniformity: Option<f64>,
}

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

/// Returns the rows of readings. Each reading is followed by its lamps.
/// - `places`: places of `readings`.
pub fn reading_rows(places: &[Place], readings: &[Reading]) -> Vec<ReadingRow> {
    let rows = |(place, reading): (&Place, &Reading)| {
        let whole = ReadingRow {
            part: place.part.clone(),
            number: place.number,
            column: place.cell.map(|[column, _]| column),
            row: place.cell.map(|[_, row]| row),
            position: place.position,
            quantity: place.quantity,
            unit: place.quantity.unit(),
            lamp: None,
            value: reading.value,
            half_width: reading.half_width,
            color: Some(reading.color),
            area: place.area(),
            samples: reading.samples,
            bad_samples: reading.bad_samples,
            converged: reading.is_converged,
        };
        let lamp = |lamp: &femc_pipeline::measure::LampShare| ReadingRow {
            lamp: Some(lamp.lamp.clone()),
            value: lamp.value,
            half_width: lamp.half_width,
            color: None,
            ..whole.clone()
        };
        let lamps: Vec<ReadingRow> = reading.lamps.iter().map(lamp).collect();
        std::iter::once(whole).chain(lamps)
    };
    places.iter().zip(readings).flat_map(rows).collect()
}

/// Returns the rows of summaries. Each summary is followed by its lamps.
pub fn summary_rows(summaries: &[Summary]) -> Vec<SummaryRow> {
    let rows = |summary: &Summary| {
        let row = |lamp: Option<String>, mean: Interval| SummaryRow {
            part: summary.part.clone(),
            quantity: summary.quantity,
            unit: summary.quantity.unit(),
            lamp,
            readings: summary.readings,
            area: summary.area,
            mean: mean.value,
            mean_half_width: mean.half_width,
            least: None,
            greatest: None,
            uniformity: None,
            dark: summary.dark,
            lit_uniformity: None,
        };
        let whole = SummaryRow {
            least: Some(summary.least.value),
            greatest: Some(summary.greatest.value),
            uniformity: Some(summary.uniformity),
            lit_uniformity: Some(summary.lit_uniformity),
            ..row(None, summary.mean)
        };
        let lamps: Vec<SummaryRow> = summary.lamps.iter().map(|(lamp, mean)| row(Some(lamp.clone()), *mean)).collect();
        std::iter::once(whole).chain(lamps)
    };
    summaries.iter().flat_map(rows).collect()
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
        column("unit", "", Text, Everyone, |row| Cell::Text(row.unit.into())),
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
        column("unit", "", Text, Everyone, |row| Cell::Text(row.unit.into())),
        column("mean_error", "error", Share, Everyone, |row| relative(row.mean, row.mean_half_width)),
        column("least", "least", Number, Everyone, |row| real(row.least)),
        column("greatest", "greatest", Number, Everyone, |row| real(row.greatest)),
        column("uniformity", "uniformity", Number, Everyone, |row| real(row.uniformity)),
        column("dark", "dark", Count, Everyone, |row| Cell::Count(row.dark)),
        column("lit_uniformity", "of the lit", Number, Programs, |row| real(row.lit_uniformity)),
    ]
}
