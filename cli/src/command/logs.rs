//! `femc logs JOB [TASK]`: prints the logs of a job's tasks.

use super::client::{self, FarmClient};
use super::interrupt::Interrupt;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure, interrupted, usage};
use crate::output::{Printer, human, json};
use crate::values::{JobTaskSelector, TaskSelector};
use clap::Args;
use femc_model::{AttemptOutcome, Epoch, LogRecord, LogText, TaskKey, Tick};
use femc_service::view::LogJson;
use std::collections::BTreeSet;
use std::time::Duration;

/// Print the logs of a job's tasks, the newest last
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc logs 7                      # every attempt with a stored log\n  \
    femc logs 7 12                   # attempts of frame 12\n  \
    femc logs 7 12.0/image           # image tasks of frame 12\n  \
    femc logs 7/12.0/render.0/3      # one task, named as in logs, `femc stats` and `femc status`\n  \
    femc logs 7 --failed             # failures only\n  \
    femc logs 7 --follow             # continue until the job ends\n  \
    femc logs 7 --json | jq -r '.[] | select(.attempt == \"failed\") | .text'\n\n\
    At most 512 logs are kept with a job: those of failures, of image tasks and of first passes. Logs of successful tiles are \
    short, and only the latest ones of all jobs are kept, in the coordinator's memory. The name of a task consists of its job, \
    its frame (0: stages of the whole job) and round, the kind and number of its stage (as in `femc plan`), and its number in \
    the stage. Results that jobs share have names like shared-3; their logs are shown with each of these jobs.")]
pub struct LogsArgs {
    /// Job number, or a task with its job, like 7/12.0/render.0/3
    #[arg(value_name = "JOB")]
    job: JobTaskSelector,
    /// A frame, or a task: 12, 12.0/image, 12.0/render.0/3
    #[arg(value_name = "TASK")]
    task: Option<TaskSelector>,
    /// Only attempts that failed
    #[arg(long)]
    failed: bool,
    /// Follow: print new records until the job ends; with --json one document per line
    #[arg(long, short)]
    follow: bool,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// Interval between two calls.
const POLL_INTERVAL: Duration = Duration::from_millis(500);

/// Runs `femc logs`.
pub fn run(args: &LogsArgs, printer: Printer) -> Result<Exit, Failure> {
    if args.task.is_some() && args.job.tasks != TaskSelector::default() {
        return Err(usage("TASK: the task is named twice; write JOB TASK, or JOB/TASK"));
    }
    client::block_on(&args.server, async |farm| {
        let mut interrupt = Interrupt::listen()?;
        let mut printed = PrintedLogs::default();
        loop {
            // The status is read before the logs, so that records from before the end are not missed.
            let has_ended = !args.follow || farm.status_with_retry(args.job.job).await?.state.has_ended();
            let records = printed.take_new(farm.logs(args.job.job, printed.since).await?);
            print_logs(args, farm, &records, printer).await?;
            if has_ended {
                return Ok(Exit::Done);
            }
            tokio::select! {
                () = tokio::time::sleep(POLL_INTERVAL) => {}
                () = interrupt.wait() => return Err(interrupted("stopped following; the job continues")),
            }
        }
    })
}

/// Records that have been printed.
#[derive(Default)]
struct PrintedLogs {
    since: Tick,
    attempts: BTreeSet<(TaskKey, Epoch)>,
}

impl PrintedLogs {
    /// Returns the new logs among `records`.
    fn take_new(&mut self, records: Vec<LogRecord>) -> Vec<LogRecord> {
        self.since = records.last().map_or(self.since, |record| record.reported_at);
        let attempts = &mut self.attempts;
        records.into_iter().filter(|record| attempts.insert((record.task, record.epoch))).collect()
    }
}

async fn print_logs(
    args: &LogsArgs,
    farm: &FarmClient,
    records: &[LogRecord],
    printer: Printer,
) -> Result<(), Failure> {
    let wanted = |record: &&LogRecord| {
        let is_named = args.task.unwrap_or(args.job.tasks).matches(&record.task);
        is_named && (!args.failed || record.log.outcome == AttemptOutcome::Failed)
    };
    let mut all = Vec::new();
    for record in records.iter().filter(wanted) {
        let text = match &record.log.text {
            LogText::Inline(text) => text.clone(),
            LogText::Stored(artifact) => match farm.get(artifact).await {
                Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
                Err(failure) => format!("the log cannot be read: {failure}\n"),
            },
        };
        if args.format.json && args.follow {
            json::print_line(printer, &LogJson::new(record, text))?;
        } else if args.format.json {
            all.push(LogJson::new(record, text));
        } else {
            printer.result(heading(record, printer));
            printer.result(human::escape_controls(&text));
        }
    }
    if args.format.json && !args.follow {
        json::print(printer, &all)?;
    } else if records.is_empty() && !args.follow {
        printer.note("no attempt of this job has a log yet");
    } else if !args.follow && !records.iter().any(|record| wanted(&record)) {
        let others = human::counted_noun(records.len() as u64, "log");
        printer.note(format!("no requested attempt has a log; the job has {others} of other attempts"));
    }
    Ok(())
}

fn heading(record: &LogRecord, printer: Printer) -> String {
    let seconds = human::seconds(record.log.seconds);
    match record.log.outcome {
        AttemptOutcome::Done => {
            printer.style_heading(&format!("== {} on {}: done, {seconds}", record.task, record.worker))
        }
        AttemptOutcome::Failed => {
            printer.style_error(&format!("== {} on {}: FAILED, {seconds}", record.task, record.worker))
        }
    }
}
