//! Means, extremes and uniformity of the readings of a part of a request.

use super::message::Measured;
use super::reading::{REPLICATES, Reading};
use super::request::Quantity;
use femc_film::convergence::student_95;
use std::collections::BTreeMap;

/// A value and its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Value.
    pub value: f64,
    /// Half width of the interval.
    pub half_width: f64,
}

/// Summary of the readings of a grid, of an area, or of a list of points.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Name of the part.
    pub part: String,
    /// Quantity.
    pub quantity: Quantity,
    /// Number of readings.
    pub readings: u64,
    /// Sum of the areas of cells, m2; `None` for points.
    pub area: Option<f64>,
    /// Mean, weighted by area. For an area it is the mean over all of its points.
    pub mean: Interval,
    /// Smallest reading, with its own interval.
    pub least: Interval,
    /// Largest reading, with its own interval.
    pub greatest: Interval,
    /// Smallest reading over the mean (U0). Noise makes it too small by up to the intervals.
    pub uniformity: f64,
    /// Number of dark readings. Their points may lie within objects.
    pub dark: u64,
    /// Smallest reading that is not dark over the mean of these readings.
    pub lit_uniformity: f64,
    /// Mean light of each lamp, brightest first; empty unless requested.
    pub lamps: Vec<(String, Interval)>,
}

/// Sum of independent estimates.
#[derive(Clone, Copy, Debug, Default)]
struct EstimateSum {
    value: f64,
    variance: f64,
    /// Sum of the squared variances.
    squares: f64,
}

impl EstimateSum {
    fn add(&mut self, value: f64, variance: f64) {
        self.value += value;
        self.variance += variance;
        self.squares += variance * variance;
    }

    /// Divides the sum by `weight`, and returns the interval of the result. Its degrees of freedom follow from the variances
    /// (\[satterthwaite1946\]).
    fn interval(&self, weight: f64) -> Interval {
        let each = (REPLICATES - 1) as f64;
        let freedom =
            if self.squares > 0.0 { each * self.variance * self.variance / self.squares } else { f64::INFINITY };
        Interval { value: self.value / weight, half_width: student_95(freedom) * self.variance.sqrt() / weight }
    }
}

/// Summarizes each part of a request that has several readings, in order.
/// - `measured`: all readings of the request, in order.
pub fn summarize(measured: &[Measured]) -> Vec<Summary> {
    let parts = measured.chunk_by(|a, b| a.place.part == b.place.part);
    parts.filter(|part| part.len() > 1).map(summarize_part).collect()
}

fn summarize_part(part: &[Measured]) -> Summary {
    let first = &part[0].place;
    let weight: f64 = part.iter().map(|it| it.place.weight()).sum();
    let mut sum = EstimateSum::default();
    let mut lamps: BTreeMap<&str, EstimateSum> = BTreeMap::new();
    for Measured { place, reading } in part {
        let weight = place.weight();
        sum.add(weight * reading.value, weight * weight * reading.variance());
        for lamp in &reading.lamps {
            let error = weight * lamp.half_width / student_95((REPLICATES - 1) as f64);
            lamps.entry(&lamp.lamp).or_default().add(weight * lamp.value, error * error);
        }
    }
    let mean = sum.interval(weight);
    let of = |reading: &Reading| Interval { value: reading.value, half_width: reading.half_width };
    let readings = || part.iter().map(|it| of(&it.reading));
    let least = readings().reduce(|a, b| if b.value < a.value { b } else { a }).unwrap_or(mean);
    let greatest = readings().reduce(|a, b| if b.value > a.value { b } else { a }).unwrap_or(mean);
    let lit = || part.iter().filter(|it| it.reading.value > 0.0);
    let lit_weight: f64 = lit().map(|it| it.place.weight()).sum();
    let lit_least = lit().map(|it| it.reading.value).fold(f64::INFINITY, f64::min);
    let mut lamps: Vec<(String, Interval)> =
        lamps.into_iter().map(|(lamp, sum)| (lamp.to_owned(), sum.interval(weight))).collect();
    lamps.sort_by(|a, b| b.1.value.total_cmp(&a.1.value));
    Summary {
        part: first.part.clone(),
        quantity: first.quantity,
        readings: part.len() as u64,
        area: first.area.map(|_| weight),
        mean,
        least,
        greatest,
        uniformity: if mean.value > 0.0 { least.value / mean.value } else { 0.0 },
        dark: (part.len() - lit().count()) as u64,
        lit_uniformity: if sum.value > 0.0 { lit_least / (sum.value / lit_weight) } else { 0.0 },
        lamps,
    }
}
