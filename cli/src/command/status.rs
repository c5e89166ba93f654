//! `femc status JOB`.

use super::client;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::job::{JobJson, describe, wait};
use crate::output::{Say, json};
use clap::Args;
use femc_model::JobId;

/// Show where a job stands
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc status 7\n  \
    femc status 7 --why\n  \
    femc status 7 --json | jq .frames_done")]
pub struct StatusArgs {
    /// The job's number, as `submit` printed it
    #[arg(value_name = "JOB")]
    job: u64,
    /// Say why tasks of it wait, as the scheduler sees it
    #[arg(long)]
    why: bool,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// Show.
pub fn run(args: &StatusArgs, say: Say) -> Result<Exit, Failure> {
    let job = client::block_on(&args.server, async |farm| farm.status(JobId(args.job)).await)?;
    if args.format.json {
        json::print(say, &JobJson::from(&job))?;
        return Ok(Exit::Done);
    }
    say.result(describe(say, &job));
    if args.why {
        if job.waits.is_empty() {
            say.result("nothing of it waits");
        }
        for reason in &job.waits {
            say.result(format!("waits: {}", wait(&job, reason)));
        }
    }
    Ok(Exit::Done)
}
