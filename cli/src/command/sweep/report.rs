//! Report of a sweep.

use super::share::Shares;
use super::work::Work;
use crate::exit::{Exit, Failure};
use crate::output::{Say, human, json};
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::Path;

/// Summary of a sweep, printed whole by `--json`.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Folder of the sweep; empty without `-o`.
    pub out: String,
    /// Names of the variants, which are also the names of their folders.
    pub variants: Vec<String>,
    /// Sharing, counted before the start.
    #[serde(flatten)]
    pub shares: Counts,
    /// Jobs that were queued or found again.
    pub jobs: Vec<JobReport>,
    /// The sheet.
    pub contact_sheet: Option<String>,
    /// Wall-clock time of this run, s.
    pub seconds: f64,
}

/// Frames by origin.
#[derive(Debug, Serialize)]
pub struct Counts {
    /// Number of all frames.
    pub frames: usize,
    /// Frames rendered by this run.
    pub rendered: usize,
    /// Frames linked to equal ones.
    pub linked: usize,
    /// Frames finished before this run.
    pub kept: usize,
    /// Number of prepared worlds.
    pub worlds: usize,
}

/// A job of the sweep.
#[derive(Debug, Serialize)]
pub struct JobReport {
    /// Variant whose frames it renders.
    pub variant: String,
    /// Number of the job.
    pub job: u64,
}

impl Report {
    /// Creates the report before anything has run.
    pub fn new(work: &Work, out: &Path, shares: Shares) -> Self {
        let Shares { frames, there: kept, linked, render: rendered, worlds, .. } = shares;
        Self {
            out: out.display().to_string(),
            variants: work.variants.iter().map(|variant| variant.name.clone()).collect(),
            shares: Counts { frames, rendered, linked, kept, worlds },
            jobs: Vec::new(),
            contact_sheet: None,
            seconds: 0.0,
        }
    }

    /// Prints on stderr which job belongs to which variant.
    pub fn note_jobs(&self, say: Say) {
        self.jobs.iter().for_each(|job| say.note(format!("job {}: {}", job.job, job.variant)));
    }

    /// Prints the numbers of queued jobs on stdout, one per line, when the command does not wait.
    pub fn queued(&self, as_json: bool, say: Say) -> Result<Exit, Failure> {
        if as_json {
            json::print(say, self)?;
        } else {
            let mut seen = BTreeSet::new();
            self.jobs.iter().filter(|job| seen.insert(job.job)).for_each(|job| say.result(job.job));
        }
        Ok(Exit::Done)
    }

    /// Prints the report of a complete sweep.
    pub fn print(&self, as_json: bool, say: Say) -> Result<(), Failure> {
        if as_json {
            return json::print(say, self);
        }
        let Counts { frames, rendered, linked, kept, .. } = self.shares;
        let variants = human::count(self.variants.len() as u64, "variant");
        say.result(format!(
            "{}: {variants}, {frames} frames ({rendered} rendered, {linked} linked, {kept} already finished), {}",
            self.out,
            human::seconds(self.seconds)
        ));
        self.contact_sheet.iter().for_each(|sheet| say.result(sheet));
        Ok(())
    }
}
