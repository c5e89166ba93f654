//! Report of a sweep.

use super::measure::{self, MeasuredPart};
use super::resolved::ResolvedSweep;
use super::sharing::SharingCounts;
use crate::exit::{Exit, Failure};
use crate::output::{Printer, human, json};
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::Path;

/// Largest number of summaries that are printed.
const MAX_PARTS: usize = 200;

/// Summary of a sweep, printed whole by `--json`.
#[derive(Debug, Serialize)]
pub struct SweepReport {
    /// Folder of the sweep; empty without `-o`.
    pub out: String,
    /// Names of the variants, which are also the names of their folders.
    pub variants: Vec<String>,
    /// Sharing, counted before the start.
    #[serde(flatten)]
    pub shares: FrameCounts,
    /// Jobs that were queued or found again.
    pub jobs: Vec<JobReport>,
    /// The sheet.
    pub contact_sheet: Option<String>,
    /// Summaries of the measured light, by variant, frame and part; empty without `measure`.
    pub readings: Vec<MeasuredPart>,
    /// Wall-clock time of this run, s.
    pub seconds: f64,
}

/// Frames by origin.
#[derive(Debug, Serialize)]
pub struct FrameCounts {
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

impl SweepReport {
    /// Creates the report before anything has run.
    pub fn new(sweep: &ResolvedSweep, out: &Path, sharing: SharingCounts) -> Self {
        let SharingCounts { frames, there: kept, linked, render: rendered, worlds, .. } = sharing;
        Self {
            out: out.display().to_string(),
            variants: sweep.variants.iter().map(|variant| variant.name.clone()).collect(),
            shares: FrameCounts { frames, rendered, linked, kept, worlds },
            jobs: Vec::new(),
            contact_sheet: None,
            readings: Vec::new(),
            seconds: 0.0,
        }
    }

    /// Prints on stderr which job belongs to which variant.
    pub fn note_jobs(&self, printer: Printer) {
        self.jobs.iter().for_each(|job| printer.note(format!("job {}: {}", job.job, job.variant)));
    }

    /// Prints the numbers of queued jobs on stdout, one per line, when the command does not wait.
    pub fn print_jobs(&self, as_json: bool, printer: Printer) -> Result<Exit, Failure> {
        if as_json {
            json::print(printer, self)?;
        } else {
            let mut seen = BTreeSet::new();
            self.jobs.iter().filter(|job| seen.insert(job.job)).for_each(|job| printer.result(job.job));
        }
        Ok(Exit::Done)
    }

    /// Prints the report of a complete sweep.
    pub fn print(&self, sweep: &ResolvedSweep, as_json: bool, printer: Printer) -> Result<(), Failure> {
        if as_json {
            return json::print(printer, self);
        }
        let FrameCounts { frames, rendered, linked, kept, .. } = self.shares;
        let variants = human::counted_noun(self.variants.len() as u64, "variant");
        printer.result(format!(
            "{}: {variants}, {frames} frames ({rendered} rendered, {linked} linked, {kept} already finished), {}",
            self.out,
            human::seconds(self.seconds)
        ));
        self.contact_sheet.iter().for_each(|sheet| printer.result(sheet));
        if !self.readings.is_empty() {
            let shown = &self.readings[..self.readings.len().min(MAX_PARTS)];
            printer.result(measure::readings_text(sweep, shown));
            if shown.len() < self.readings.len() {
                printer.note(format!("the first {MAX_PARTS} rows; {}/readings.csv has all", self.out));
            }
        }
        Ok(())
    }
}
