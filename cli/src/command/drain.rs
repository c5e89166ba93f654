//! `femc drain WORKER`: stops giving tasks to a worker.

use super::client;
use crate::args::ServerArgs;
use crate::exit::{Exit, Failure};
use crate::output::Printer;
use clap::Args;
use femc_model::{Drain, WorkerId, WorkerSelector};

/// Give a worker no more tasks; it finishes its current tasks and stays connected
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc drain 3\n  \
    femc drain lab-7             # every worker of this name\n  \
    femc drain lab-7 --undo      # let it take tasks again\n\n\
    A drain lasts until the worker's process ends, even if the worker loses its coordinator or the coordinator restarts. \
    `femc workers` shows which workers are draining, and their running tasks.")]
pub struct DrainArgs {
    /// Worker number or name, as shown by `femc workers`
    #[arg(value_name = "WORKER")]
    worker: String,
    /// Give it tasks again
    #[arg(long)]
    undo: bool,
    #[command(flatten)]
    server: ServerArgs,
}

/// Runs `femc drain`.
pub fn run(args: &DrainArgs, printer: Printer) -> Result<Exit, Failure> {
    let worker = match args.worker.parse() {
        Ok(number) => WorkerSelector::Number(WorkerId(number)),
        Err(_) => WorkerSelector::Name(args.worker.clone()),
    };
    let drain = if args.undo { Drain::Undo } else { Drain::Begin };
    let workers = client::block_on(&args.server, async |farm| farm.drain(worker, drain).await)?;
    for worker in workers {
        printer.note(match drain {
            Drain::Begin => format!("worker {worker} gets no new tasks; `femc drain {worker} --undo` ends the drain"),
            Drain::Undo => format!("worker {worker} gets tasks again"),
        });
    }
    Ok(Exit::Done)
}
