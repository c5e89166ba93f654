//! `femc usage`: prints the usage of the farm, by month and owner.

use super::client;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::{Printer, json};
use clap::Args;
use femc_model::{Month, OwnerUsage};
use femc_reports::attempts::{RowsAsJson, csv, text_table};
use femc_service::view::usage_columns;

/// Print the usage of the farm by month and owner: jobs, frames, samples, worker and processor time
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc usage                                   # every owner and month\n  \
    femc usage --month 2026-11 --csv > nov.csv   # for the accounts\n  \
    femc usage --owner ann --json | jq '[.[].processor_seconds] | add'\n\n\
    Months are in UTC. Worker time is the time in which tasks of the owner's jobs occupied workers; each moment of a worker \
    counts once. Processor time includes all attempts, also failed ones. The cost of a first pass that jobs of several owners \
    share is split by the owners' weights. Usage remains when jobs are deleted (`femc delete`, `--keep-ended`). A coordinator \
    that is killed loses up to five seconds of it.")]
pub struct UsageArgs {
    /// Only this month, YYYY-MM
    #[arg(long, value_name = "YYYY-MM")]
    month: Option<Month>,
    /// Only this owner
    #[arg(long, value_name = "NAME")]
    owner: Option<String>,
    /// Print CSV on stdout, with a header line
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// Runs `femc usage`.
pub fn run(args: &UsageArgs, printer: Printer) -> Result<Exit, Failure> {
    let mut usage = client::block_on(&args.server, async |farm| farm.usage().await)?;
    let is_wanted = |row: &OwnerUsage| {
        args.month.is_none_or(|month| month == row.month) && args.owner.as_ref().is_none_or(|owner| *owner == row.owner)
    };
    usage.retain(is_wanted);
    let columns = usage_columns();
    if args.format.json {
        json::print(printer, &RowsAsJson(&columns, &usage))?;
    } else if args.csv {
        printer.result(csv(&columns, &usage));
    } else if usage.is_empty() {
        printer.note("no usage recorded for these months and owners");
    } else {
        printer.result(text_table(&columns, &usage));
    }
    Ok(Exit::Done)
}
