//! `femc workers`: who renders.

use super::client;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::{Say, human, json};
use clap::Args;
use femc_model::WorkerStatus;
use femc_service::view::{WorkerJson, intake};

/// List the farm's workers
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc workers\n  \
    femc workers --json | jq 'map(.threads) | add'\n\n\
    Intake: open; off (the worker wants no more tasks: it is leaving, or outside its --hours); draining (`femc drain`).")]
pub struct WorkersArgs {
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

/// List.
pub fn run(args: &WorkersArgs, say: Say) -> Result<Exit, Failure> {
    let workers = client::block_on(&args.server, async |farm| farm.workers().await)?;
    if args.format.json {
        json::print(say, &workers.iter().map(WorkerJson::from).collect::<Vec<_>>())?;
    } else if workers.is_empty() {
        say.note(format!("no workers; start one with `femc worker --join {}`", args.server.server));
    } else {
        let rows: Vec<Vec<String>> = workers.iter().map(row).collect();
        say.result(human::table(
            &["worker", "name", "threads", "tags", "tasks", "done", "failed", "silent", "intake"],
            &rows,
        ));
    }
    Ok(Exit::Done)
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
        intake(worker.intake).to_owned(),
    ]
}
