//! A job's report: one HTML file with its figures inside, which asks nobody for anything.

mod cost;
mod durations;
mod errors;
mod figure;
mod heat;
mod page;
mod timeline;

use crate::attempts::{By, Row, rows};
use crate::exit::Failure;
use femc_model::{AttemptRecord, Attempts, Ending, JobStatus, LogRecord};
use femc_proto::JobShape;
use page::Page;

/// All that a report tells.
pub struct Report {
    /// The job now.
    pub status: JobStatus,
    /// What it is made of.
    pub shape: JobShape,
    /// What its attempts took.
    pub attempts: Attempts,
    /// Failures, with what was written down.
    pub failures: Vec<(LogRecord, String)>,
}

impl Report {
    /// The file.
    pub fn html(&self) -> Result<String, Failure> {
        let of = |by| rows(&self.attempts, &self.shape, by);
        let (attempts, tasks, frames, workers) = (of(By::Attempt), of(By::Task), of(By::Frame), of(By::Worker));
        let mut page = Page::new(&format!("Job {}: {}", self.status.job, self.status.name));
        page.facts(&self.facts(&workers, &attempts));
        if attempts.is_empty() {
            page.text("No attempt at a task of this job has ended yet.");
            return Ok(page.end());
        }
        page.section(
            "Workers",
            "Each bar is an attempt at a task; those that lie closer together than can be seen are one.",
        );
        page.figure(&timeline::draw(&attempts)?);
        page.legend(&timeline::LEGEND);
        page.table(By::Worker, &workers);
        page.section("Durations of tasks", "From the beginning of a render task to its result.");
        page.figures(&durations::draw(&attempts)?, "No render task is done yet.");
        page.section("Error against time", "Relative error of a frame as each of its merges measured it.");
        page.figures(&errors::draw(&attempts)?, "No merge has measured an error yet.");
        page.section("Samples", "Samples a pixel of each tile, of results that count.");
        page.figures(&heat::draw(&tasks, &self.shape)?, "No tile is done yet.");
        page.section("Cost", "Processor seconds of a frame, attempts that came to nothing included.");
        page.figure(&cost::draw(&frames)?);
        page.table(By::Frame, &frames);
        page.section("Failures", "Attempts that failed, with what their workers wrote down.");
        page.failures(&self.failures);
        Ok(page.end())
    }

    fn facts(&self, workers: &[Row], attempts: &[Row]) -> Vec<(&'static str, String)> {
        use crate::output::human::{bytes, count, quantity, seconds};
        let sum = |of: fn(&Row) -> f64| workers.iter().map(of).sum::<f64>();
        let wasted: f64 = attempts.iter().filter(|row| row.ending != Some(Ending::Done)).map(|row| row.cpu).sum();
        let unknown = self.attempts.iter().filter(|record: &&AttemptRecord| record.usage.is_none()).count();
        let span = attempts.iter().map(|row| row.ended).fold(0.0, f64::max);
        let [width, height] = self.shape.spec.grid.film;
        let attempts_told = match unknown {
            0 => attempts.len().to_string(),
            _ => format!("{}; what {unknown} of them took is not known", attempts.len()),
        };
        vec![
            ("State", format!("{:?}", self.status.state).to_lowercase()),
            ("Frames", format!("{} of {} finished", self.status.frames_done, self.status.frames_total)),
            ("Film", format!("{width} x {height}")),
            ("First attempt to last", seconds(span)),
            (
                "Processor",
                format!(
                    "{}, of which {} in attempts that came to nothing",
                    seconds(sum(|row| row.cpu)),
                    seconds(wasted)
                ),
            ),
            ("Workers", count(workers.len() as u64, "process").replace("processs", "processes")),
            ("Attempts", attempts_told),
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
