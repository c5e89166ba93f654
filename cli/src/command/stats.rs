//! `femc stats JOB`: prints the usage of jobs' tasks.

use super::subject::{self, IncludedLogs, Subject};
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::{Printer, json};
use clap::{Args, ValueEnum};
use femc_reports::attempts::{GroupBy, RowsAsJson, columns, csv, rows, text_table, write_parquet};
use std::path::PathBuf;

/// Print the usage of jobs' tasks: time, processor, memory, samples, rays, bytes
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc stats 7                              # one line per frame\n  \
    femc stats 7 --by worker                  # the work of each worker\n  \
    femc stats 7 --by attempt --csv > 7.csv   # every attempt, including failed and abandoned ones\n  \
    femc stats 7 --by task --parquet 7.parquet && python3 -c \\\n    \
    \"import pandas; print(pandas.read_parquet('7.parquet').groupby('worker').cpu_seconds.sum())\"\n  \
    femc stats fog --by variant               # the sweep in the folder fog, without a farm\n  \
    femc stats 7 8 9 --by variant             # several jobs\n  \
    femc stats shared-1                       # a result that jobs share, like a first pass; `femc logs 7` shows its name\n  \
    femc stats 7 --json | jq '[.[].cpu_seconds] | add'\n\n\
    An attempt is a lease under which work began. It ended done, failed, cancelled (given back, or its job had ended), revoked \
    (it expired, or another worker finished first) or lost (the worker disappeared, and its usage is unknown). CPU is the time \
    of the worker's process during the task, divided among the tasks that ran at the same time; memory is the peak of the \
    process during the task. `began` and `ended` are seconds since the first attempt, by the coordinator's clock.")]
pub struct StatsArgs {
    /// Job numbers, or folders of sweeps that have ended
    #[arg(value_name = "JOB|DIR", required = true)]
    subjects: Vec<Subject>,
    /// Subject of a line
    #[arg(long, value_enum, default_value_t = RowSubject::Frame, value_name = "WHAT")]
    by: RowSubject,
    /// Print CSV on stdout, with a header line
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    /// Write an Apache Parquet file
    #[arg(long, value_name = "FILE", conflicts_with_all = ["json", "csv"])]
    parquet: Option<PathBuf>,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// Subject of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RowSubject {
    /// A task, with all its attempts.
    Task,
    /// A frame.
    Frame,
    /// A variant of a sweep; for other jobs, the job.
    Variant,
    /// A worker process.
    Worker,
    /// One attempt at a task.
    Attempt,
}

impl From<RowSubject> for GroupBy {
    fn from(subject: RowSubject) -> Self {
        match subject {
            RowSubject::Task => Self::Task,
            RowSubject::Frame => Self::Frame,
            RowSubject::Variant => Self::Variant,
            RowSubject::Worker => Self::Worker,
            RowSubject::Attempt => Self::Attempt,
        }
    }
}

/// Runs `femc stats`.
pub fn run(args: &StatsArgs, printer: Printer) -> Result<Exit, Failure> {
    let records = subject::records(&args.subjects, IncludedLogs::None, &args.server)?;
    let by = args.by.into();
    let (columns, rows) = (columns(by), rows(&records, by));
    if let Some(path) = &args.parquet {
        write_parquet(path, &columns, &rows)?;
        printer.note(format!("{}: {} rows", path.display(), rows.len()));
    } else if args.format.json {
        json::print(printer, &RowsAsJson(&columns, &rows))?;
    } else if args.csv {
        printer.result(csv(&columns, &rows));
    } else if rows.is_empty() {
        printer.note("no attempt at a task has ended yet");
    } else {
        printer.result(text_table(&columns, &rows));
    }
    Ok(Exit::Done)
}
