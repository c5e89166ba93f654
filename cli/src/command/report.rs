//! `femc report JOB`: what became of jobs, as a page.

use super::subject::{self, Logs, Subject};
use crate::args::ServerArgs;
use crate::exit::{Exit, Failure, failed};
use crate::output::Say;
use crate::report::Report;
use clap::Args;
use std::path::PathBuf;

/// Write a page about jobs: workers over time, durations, errors, samples, cost, failures
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc report 7 -o report.html\n  \
    femc report fog                            # of the sweep in the folder fog, without a farm\n  \
    femc watch 7 && femc report 7 && xdg-open job-7.html\n\n\
    One file that opens without a network. The numbers behind it: `femc stats`.")]
pub struct ReportArgs {
    /// Numbers of jobs, or the folders of sweeps that have ended
    #[arg(value_name = "JOB|DIR", required = true)]
    subjects: Vec<Subject>,
    /// File to write [default: job-JOB.html, of a sweep DIR/report.html]
    #[arg(long, short, value_name = "FILE.html")]
    out: Option<PathBuf>,
    #[command(flatten)]
    server: ServerArgs,
}

/// Write.
pub fn run(args: &ReportArgs, say: Say) -> Result<Exit, Failure> {
    let records = subject::records(&args.subjects, Logs::Failures, &args.server)?;
    let out = args.out.clone().unwrap_or_else(|| match &args.subjects[..] {
        [Subject::Job(job)] => format!("job-{job}.html").into(),
        [Subject::Sweep(folder)] => folder.join("report.html"),
        _ => "jobs.html".into(),
    });
    let title = match &args.subjects[..] {
        [Subject::Sweep(folder)] => Some(folder.display().to_string()),
        _ => None,
    };
    femc_film::file::write_atomic(&out, Report { title, records }.html()?.as_bytes()).map_err(failed)?;
    say.result(out.display());
    Ok(Exit::Done)
}
