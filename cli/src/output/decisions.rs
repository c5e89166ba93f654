//! Parts of the variance by decision of the paths, for reports.

use super::human;
use femc_pipeline::variance_by_decision::{Decision, DecisionKey, MAX_BOUNCE, MeanEstimate, VarianceByDecision};
use serde::Serialize;

/// Parts of the variance of samples by decision. Shares add up to 1.
#[derive(Clone, Debug, Serialize)]
pub struct DecisionsReport {
    /// Number of samples, and of samples that were traced again with new random numbers.
    pub samples: u64,
    /// Number of samples that were traced again.
    pub replays: u64,
    /// Sum of all parts, and its standard error: the relative variance of a sample.
    pub variance: f64,
    /// Standard error of the sum.
    pub variance_error: f64,
    /// Variance from the spread of each pixel's samples, for comparison.
    pub spread: f64,
    /// Standard error of the spread.
    pub spread_error: f64,
    /// Parts, the largest share first.
    pub parts: Vec<DecisionReport>,
}

/// Part of the variance in one kind of decisions.
#[derive(Clone, Debug, Serialize)]
pub struct DecisionReport {
    /// Decision, or `later` for all decisions from segment 8 on.
    pub decision: &'static str,
    /// Segment of the path, 0: the camera's. The decision is made on it or at its end.
    pub bounce: u32,
    /// Whether the guide of a first pass drew the direction.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub guided: bool,
    /// Share of the variance.
    pub share: f64,
    /// Standard error of the share.
    pub error: f64,
}

impl DecisionsReport {
    /// Creates the report.
    pub fn new(found: &VarianceByDecision) -> Self {
        let sum = found.sum.mean;
        let fraction = |part: f64| if sum > 0.0 { part / sum } else { 0.0 };
        let part = |(key, part): (&DecisionKey, &MeanEstimate)| DecisionReport {
            decision: key.decision.map_or("later", Decision::word),
            bounce: key.bounce,
            guided: key.is_guided,
            share: fraction(part.mean),
            error: fraction(part.error),
        };
        let mut parts: Vec<DecisionReport> = found.parts.iter().map(part).collect();
        parts.sort_by(|a, b| b.share.total_cmp(&a.share));
        Self {
            samples: found.samples,
            replays: found.replays,
            variance: sum,
            variance_error: found.sum.error,
            spread: found.spread.mean,
            spread_error: found.spread.error,
            parts,
        }
    }

    /// Returns the lines of a table: a row for each decision, a column for each segment.
    pub fn table(&self) -> Vec<String> {
        let mut names: Vec<(&str, bool)> = Vec::new();
        for part in &self.parts {
            let name = (part.decision, part.guided);
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let cell = |share: f64| format!("{:.1}", 100.0 * share);
        let mut rows: Vec<(f64, Vec<String>)> = names
            .into_iter()
            .map(|(decision, guided)| {
                let own = || self.parts.iter().filter(|part| (part.decision, part.guided) == (decision, guided));
                let all: f64 = own().map(|part| part.share).sum();
                let error = own().map(|part| part.error.powi(2)).sum::<f64>().sqrt();
                let name = if guided { format!("{decision}, guided") } else { decision.to_owned() };
                let at =
                    |bounce: u32| own().find(|part| part.bounce == bounce).map_or(String::new(), |it| cell(it.share));
                let mut row = vec![name, format!("{} ± {}", cell(all), cell(error))];
                row.extend((0..=MAX_BOUNCE).map(at));
                (all, row)
            })
            .collect();
        rows.sort_by(|a, b| b.0.total_cmp(&a.0));
        let bounces: Vec<String> = (0..MAX_BOUNCE).map(|bounce| bounce.to_string()).collect();
        let mut header = vec!["decision", "variance, %"];
        header.extend(bounces.iter().map(String::as_str));
        let later = format!("{MAX_BOUNCE}+");
        header.push(&later);
        let rows: Vec<Vec<String>> = rows.into_iter().map(|(_, row)| row).collect();
        vec![
            human::table(&header, &rows),
            format!(
                "relative variance of a sample: {:.4} ± {:.4} by decisions, {:.4} ± {:.4} by the spread of the samples",
                self.variance, self.variance_error, self.spread, self.spread_error
            ),
        ]
    }
}
