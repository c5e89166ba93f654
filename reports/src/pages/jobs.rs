//! Page about jobs.

use super::page::Page;
use super::{cost, durations, errors, sample_maps, timeline, variants};
use crate::ReportError;
use crate::attempts::{GroupBy, JobRecord, Row, rows};
use femc_model::LeaseEnding;
use std::collections::BTreeSet;

/// Content of a report on jobs.
pub struct JobsReport {
    /// Title of the page; by default, it is made from the jobs.
    pub title: Option<String>,
    /// Record of each job.
    pub records: Vec<JobRecord>,
}

impl JobsReport {
    /// Returns the HTML file.
    pub fn html(&self) -> Result<String, ReportError> {
        let of = |by| rows(&self.records, by);
        let (attempts, tasks, frames, workers) =
            (of(GroupBy::Attempt), of(GroupBy::Task), of(GroupBy::Frame), of(GroupBy::Worker));
        let mut page = Page::new(&self.title());
        page.facts(&self.facts(&workers, &attempts));
        if attempts.is_empty() {
            page.text("No attempt has ended yet.");
            return Ok(page.finish());
        }
        page.section(
            "Workers",
            "Each bar is an attempt. Bars that are too close together to be distinguished are drawn as one.",
        );
        page.figure(&timeline::draw(&attempts)?);
        page.legend(&timeline::LEGEND);
        page.table(GroupBy::Worker, &workers);
        page.section("Durations of tasks", "Time from the beginning to the result, for tasks that compute.");
        page.figures(&durations::draw(&attempts)?, "No task that computes is done yet.");
        page.section("Error against time", "Relative error of a frame at the end of each round.");
        page.figures(&errors::draw(&attempts)?, "No error has been measured yet.");
        page.section("Samples", "Samples per pixel of each tile, from results that count.");
        page.figures(&sample_maps::draw(&tasks, &self.records)?, "No tile is done yet.");
        page.section("Cost", "Processor seconds, including unsuccessful attempts.");
        if self.records.len() > 1 {
            let variants = of(GroupBy::Variant);
            page.figure(&variants::draw(&variants)?);
            page.table(GroupBy::Variant, &variants);
        } else {
            page.figure(&cost::draw(&frames)?);
        }
        page.table(GroupBy::Frame, &frames);
        page.section("Failures", "Failed attempts, with the logs of their workers.");
        page.failures(&self.records);
        Ok(page.finish())
    }

    fn title(&self) -> String {
        match (&self.title, &self.records[..]) {
            (Some(title), _) => title.clone(),
            (None, [record]) => format!("Job {}: {}", record.job, record.spec.name),
            (None, several) => {
                let numbers: Vec<String> = several.iter().map(|record| record.job.to_string()).collect();
                format!("Jobs {}", numbers.join(", "))
            }
        }
    }

    fn facts(&self, workers: &[Row], attempts: &[Row]) -> Vec<(&'static str, String)> {
        use crate::human::{bytes, counted_noun, quantity, seconds};
        let sum = |of: fn(&Row) -> f64| workers.iter().map(of).sum::<f64>();
        let wasted: f64 = attempts.iter().filter(|row| row.ending != Some(LeaseEnding::Done)).map(|row| row.cpu).sum();
        let unknown =
            self.records.iter().flat_map(|record| &record.attempts).filter(|attempt| attempt.usage.is_none()).count();
        let span = attempts.iter().map(|row| row.ended).fold(0.0, f64::max);
        let films: BTreeSet<[u32; 2]> = self.records.iter().map(|record| record.spec.grid.film).collect();
        let films: Vec<String> = films.iter().map(|[width, height]| format!("{width} x {height}")).collect();
        let frames: usize = self.records.iter().map(|record| record.spec.frames.len()).sum();
        let attempts_text = match unknown {
            0 => attempts.len().to_string(),
            _ => format!("{}; the usage of {unknown} of them is unknown", attempts.len()),
        };
        vec![
            ("Jobs", self.records.len().to_string()),
            ("Frames", frames.to_string()),
            ("Film", films.join(", ")),
            ("From the first to the last attempt", seconds(span)),
            (
                "Processor",
                format!("{}, of which {} in unsuccessful attempts", seconds(sum(|row| row.cpu)), seconds(wasted)),
            ),
            ("Workers", counted_noun(workers.len() as u64, "process").replace("processs", "processes")),
            ("Attempts", attempts_text),
            ("Samples", quantity(sum(|row| row.samples as f64))),
            ("Rays", quantity(sum(|row| row.rays as f64))),
            (
                "Moved",
                format!(
                    "{} fetched, {} sent",
                    bytes(sum(|row| row.fetched as f64) as u64),
                    bytes(sum(|row| row.sent as f64) as u64)
                ),
            ),
        ]
    }
}
