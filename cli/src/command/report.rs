//! `femc report JOB`: what became of a job, as a page.

use super::client;
use crate::args::ServerArgs;
use crate::exit::{Exit, Failure, failed};
use crate::output::Say;
use crate::report::Report;
use clap::Args;
use femc_model::{Attempt, JobId, LogText, Tick};
use std::path::PathBuf;

/// Write a page about a job: workers over time, durations, errors, samples, cost, failures
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc report 7 -o report.html\n  \
    femc watch 7 && femc report 7 && xdg-open job-7.html\n\n\
    One file that opens without a network. The numbers behind it: `femc stats`.")]
pub struct ReportArgs {
    /// The job's number
    #[arg(value_name = "JOB")]
    job: u64,
    /// File to write [default: job-JOB.html]
    #[arg(long, short, value_name = "FILE.html")]
    out: Option<PathBuf>,
    #[command(flatten)]
    server: ServerArgs,
}

/// Most failures whose logs are shown.
const FAILURES: usize = 50;

/// Write.
pub fn run(args: &ReportArgs, say: Say) -> Result<Exit, Failure> {
    let job = JobId(args.job);
    let report = client::block_on(&args.server, async |farm| {
        let status = farm.status(job).await?;
        let (shape, attempts) = farm.attempts(job).await?;
        let logs = farm.logs(job, Tick(0)).await?.into_iter();
        let failed = logs.filter(|record| record.log.attempt == Attempt::Failed).take(FAILURES);
        let mut failures = Vec::new();
        for record in failed {
            let text = match &record.log.text {
                LogText::Inline(text) => text.clone(),
                LogText::Stored(artefact) => match farm.get(artefact).await {
                    Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
                    Err(failure) => format!("the log cannot be read: {failure}\n"),
                },
            };
            failures.push((record, text));
        }
        Ok(Report { status, shape, attempts, failures })
    })?;
    let out = args.out.clone().unwrap_or_else(|| format!("job-{job}.html").into());
    femc_film::file::write_atomic(&out, report.html()?.as_bytes()).map_err(failed)?;
    say.result(out.display());
    Ok(Exit::Done)
}
