//! Rows of the tables of measurements.

use super::message::{MAX_COUNT, Measured};
use super::reading::LampShare;
use super::request::Quantity;
use super::summary::{Interval, Summary};
use serde::{Deserialize, Serialize};

/// A reading, or the part of it that comes from one lamp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReadingRow {
    /// Name of the part of the request.
    pub part: String,
    /// Number within the part, from 0.
    pub number: u32,
    /// Column in a grid, from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<u32>,
    /// Row in a grid, from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub row: Option<u32>,
    /// Position in the world, m.
    pub position: [f64; 3],
    /// Quantity.
    pub quantity: Quantity,
    /// Unit of the values.
    pub unit: String,
    /// Lamp; `None`: all light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lamp: Option<String>,
    /// Value.
    pub value: f64,
    /// Half width of the 95 % confidence interval.
    pub half_width: f64,
    /// Light by channel; only of all light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<[f64; 3]>,
    /// Area of a cell, m2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub area: Option<f64>,
    /// Number of samples.
    pub samples: u64,
    /// Number of samples that were not finite and are left out.
    pub bad_samples: u64,
    /// Whether the requested error was reached.
    pub converged: bool,
}

/// A summary of the readings of a part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SummaryRow {
    /// Name of the part of the request.
    pub part: String,
    /// Quantity.
    pub quantity: Quantity,
    /// Unit of the values.
    pub unit: String,
    /// Lamp; `None`: all light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lamp: Option<String>,
    /// Number of readings.
    pub readings: u64,
    /// Area, m2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub area: Option<f64>,
    /// Mean.
    pub mean: f64,
    /// Half width of the mean's 95 % confidence interval.
    pub mean_half_width: f64,
    /// Smallest reading; only of all light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub least: Option<f64>,
    /// Largest reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub greatest: Option<f64>,
    /// Smallest reading over the mean.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uniformity: Option<f64>,
    /// Number of readings without light. Their points may lie within objects.
    pub dark: u64,
    /// Smallest reading with light over the mean of these readings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lit_uniformity: Option<f64>,
}

impl ReadingRow {
    /// Checks that all numbers are in their domains.
    pub(super) fn is_sound(&self) -> bool {
        let values = [self.value, self.half_width].into_iter().chain(self.color.into_iter().flatten()).chain(self.area);
        values.into_iter().all(|value| value.is_finite() && value >= 0.0)
            && self.position.iter().all(|x| x.is_finite())
            && [self.samples, self.bad_samples].iter().all(|count| *count <= MAX_COUNT)
            && self.unit == self.quantity.unit()
    }
}

/// Returns the rows of readings. Each reading is followed by its lamps.
pub fn reading_rows(measured: &[Measured]) -> Vec<ReadingRow> {
    let rows = |Measured { place, reading }: &Measured| {
        let whole = ReadingRow {
            part: place.part.clone(),
            number: place.number,
            column: place.cell.map(|[column, _]| column),
            row: place.cell.map(|[_, row]| row),
            position: place.position,
            quantity: place.quantity,
            unit: place.quantity.unit().to_owned(),
            lamp: None,
            value: reading.value,
            half_width: reading.half_width,
            color: Some(reading.color),
            area: place.area,
            samples: reading.samples,
            bad_samples: reading.bad_samples,
            converged: reading.is_converged,
        };
        let lamp = |lamp: &LampShare| ReadingRow {
            lamp: Some(lamp.lamp.clone()),
            value: lamp.value,
            half_width: lamp.half_width,
            color: None,
            ..whole.clone()
        };
        let lamps: Vec<ReadingRow> = reading.lamps.iter().map(lamp).collect();
        std::iter::once(whole).chain(lamps)
    };
    measured.iter().flat_map(rows).collect()
}

/// Returns the rows of summaries. Each summary is followed by its lamps.
pub fn summary_rows(summaries: &[Summary]) -> Vec<SummaryRow> {
    let rows = |summary: &Summary| {
        let row = |lamp: Option<String>, mean: Interval| SummaryRow {
            part: summary.part.clone(),
            quantity: summary.quantity,
            unit: summary.quantity.unit().to_owned(),
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
