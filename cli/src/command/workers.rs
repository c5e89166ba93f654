//! `femc workers`: lists the farm's workers.

use super::client;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::{Printer, human, json};
use clap::Args;
use femc_model::{OfflineWorker, WorkerList, WorkerStatus};
use femc_service::view::{OfflineJson, WorkerJson, intake_name};
use serde::Serialize;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// List the farm's workers
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc workers\n  \
    femc workers --json | jq 'map(.threads) | add'\n\n\
    Intake: open; off (the worker takes no tasks: it is stopping, or outside of its --hours); draining (`femc drain`); offline (the\n\
    worker has disconnected; silent shows how long ago).")]
pub struct WorkersArgs {
    /// Also list former workers in JSON; the table always shows them
    #[arg(long, requires = "json")]
    offline: bool,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// Runs `femc workers`.
pub fn run(args: &WorkersArgs, printer: Printer) -> Result<Exit, Failure> {
    let WorkerList { connected, offline } = client::block_on(&args.server, async |farm| farm.workers().await)?;
    if args.format.json {
        let offline = offline.iter().filter(|_| args.offline).map(OfflineJson::from).map(WorkerLine::Offline);
        let lines: Vec<WorkerLine> =
            connected.iter().map(WorkerJson::from).map(WorkerLine::Connected).chain(offline).collect();
        json::print(printer, &lines)?;
    } else if connected.is_empty() && offline.is_empty() {
        printer.note(format!("no workers; start one with `femc worker --join {}`", args.server.server));
    } else {
        let rows: Vec<Vec<String>> = connected.iter().map(row).chain(offline.iter().map(offline_row)).collect();
        printer.result(human::table(
            &["worker", "name", "threads", "tags", "tasks", "done", "failed", "silent", "intake"],
            &rows,
        ));
    }
    Ok(Exit::Done)
}

/// A worker in the list.
#[derive(Serialize)]
#[serde(untagged)]
enum WorkerLine {
    Connected(WorkerJson),
    Offline(OfflineJson),
}

fn row(worker: &WorkerStatus) -> Vec<String> {
    vec![
        worker.worker.to_string(),
        worker.name.clone(),
        worker.threads.to_string(),
        worker.tags.join(","),
        worker.tasks.len().to_string(),
        worker.completed.to_string(),
        worker.failed.to_string(),
        human::seconds(worker.silent as f64 / 1000.0),
        intake_name(worker.intake).to_owned(),
    ]
}

fn offline_row(worker: &OfflineWorker) -> Vec<String> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let silent = now.saturating_sub(Duration::from_millis(worker.last_contact));
    let none = || "-".to_owned();
    vec![
        none(),
        worker.name.clone(),
        worker.threads.to_string(),
        worker.tags.join(","),
        none(),
        none(),
        none(),
        human::seconds(silent.as_secs_f64()),
        OfflineJson::OFFLINE.to_owned(),
    ]
}
