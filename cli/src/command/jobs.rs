//! `femc jobs`: lists all jobs of the farm.

use super::client;
use crate::args::{FormatArgs, SelectArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::job::{JobJson, table};
use crate::output::{Printer, json};
use clap::Args;
use clap::builder::PossibleValuesParser;
use femc_model::JobStatus;
use femc_proto::JobList;

/// List the farm's jobs
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc jobs\n  \
    femc jobs --owner ann --name 'fog-*' --state running\n  \
    femc jobs --json | jq '.[] | select(.state == \"running\") | .job'")]
pub struct JobsArgs {
    #[command(flatten)]
    select: SelectArgs,
    /// Only jobs in this state; repeatable
    #[arg(long, value_name = "STATE", value_parser = PossibleValuesParser::new(STATES))]
    state: Vec<String>,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// States of jobs.
const STATES: [&str; 6] = ["queued", "running", "paused", "done", "failed", "cancelled"];

/// Runs `femc jobs`.
pub fn run(args: &JobsArgs, printer: Printer) -> Result<Exit, Failure> {
    let JobList { jobs, warnings } = client::block_on(&args.server, async |farm| farm.listing().await)?;
    for warning in warnings {
        printer.warning(warning);
    }
    let has_any = !jobs.is_empty();
    let is_wanted = |job: &JobStatus| args.state.is_empty() || args.state.iter().any(|name| name == job.state.name());
    let jobs: Vec<JobStatus> = jobs.into_iter().filter(|job| args.select.matches(job) && is_wanted(job)).collect();
    if args.format.json {
        json::print(printer, &jobs.iter().map(JobJson::from).collect::<Vec<_>>())?;
    } else if jobs.is_empty() && has_any {
        printer.note("no job with this owner, name and state");
    } else if jobs.is_empty() {
        printer.note("no jobs; queue one with `femc submit SCENE`");
    } else {
        printer.result(table(&jobs));
    }
    Ok(Exit::Done)
}
