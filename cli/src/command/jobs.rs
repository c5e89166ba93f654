//! `femc jobs`: all jobs of the farm.

use super::client;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::job::{JobJson, table};
use crate::output::{Say, json};
use clap::Args;
use femc_proto::Listing;

/// List the farm's jobs
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc jobs\n  \
    femc jobs --json | jq '.[] | select(.state == \"running\") | .job'")]
pub struct JobsArgs {
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// List.
pub fn run(args: &JobsArgs, say: Say) -> Result<Exit, Failure> {
    let Listing { jobs, warnings } = client::block_on(&args.server, async |farm| farm.listing().await)?;
    for warning in warnings {
        say.warning(warning);
    }
    if args.format.json {
        json::print(say, &jobs.iter().map(JobJson::from).collect::<Vec<_>>())?;
    } else if jobs.is_empty() {
        say.note("no jobs; queue one with `femc submit SCENE`");
    } else {
        say.result(table(&jobs));
    }
    Ok(Exit::Done)
}
