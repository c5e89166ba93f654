//! `femc status JOB`: prints the state of a job.

use super::client;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::job::{JobJson, describe, describe_wait, find_slowest, slowest_text};
use crate::output::{Printer, json};
use clap::Args;
use femc_model::JobId;
use serde::Serialize;

/// Show the state of a job
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc status 7\n  \
    femc status 7 --why\n  \
    femc status 7 --json | jq .frames_done\n\n\
    The slowest frame is the finished one whose attempts took the most processor time; waiting for other tasks and jobs does not \
    count. `femc stats 7` lists all frames.")]
pub struct StatusArgs {
    /// Job number, as printed by `submit`
    #[arg(value_name = "JOB")]
    job: u64,
    /// Explain why tasks of the job wait, as the scheduler sees it
    #[arg(long)]
    why: bool,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// A job as in `femc jobs --json`, and its slowest frame.
#[derive(Serialize)]
struct StatusJson {
    #[serde(flatten)]
    job: JobJson,
    slowest_frame: Option<SlowestFrame>,
}

/// The finished frame whose attempts took the most processor time.
#[derive(Serialize)]
struct SlowestFrame {
    frame: u32,
    processor_seconds: f64,
    wall_seconds: f64,
    waiting_seconds: f64,
}

/// Runs `femc status`.
pub fn run(args: &StatusArgs, printer: Printer) -> Result<Exit, Failure> {
    let (job, frames) = client::block_on(&args.server, async |farm| {
        let job = farm.status(JobId(args.job)).await?;
        Ok((job, farm.frames_with_times(JobId(args.job)).await?))
    })?;
    let slowest = find_slowest(&frames);
    if args.format.json {
        let slowest_frame = slowest.map(|(frame, times)| SlowestFrame {
            frame,
            processor_seconds: times.processor,
            wall_seconds: times.wall,
            waiting_seconds: times.waiting,
        });
        json::print(printer, &StatusJson { job: JobJson::from(&job), slowest_frame })?;
        return Ok(Exit::Done);
    }
    printer.result(describe(printer, &job));
    if let Some((frame, times)) = slowest.filter(|_| job.frames_total > 1) {
        printer.result(format!("slowest  {}", slowest_text(frame, &times)));
    }
    if args.why {
        if job.waits.is_empty() {
            printer.result("nothing is waiting");
        }
        for reason in &job.waits {
            printer.result(format!("waits: {}", describe_wait(&job, reason)));
        }
    }
    Ok(Exit::Done)
}
