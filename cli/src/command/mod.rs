//! The commands, one a file.

pub mod backup;
pub mod bench;
pub mod bottlenecks;
pub mod ca;
pub mod check;
mod client;
pub mod compare;
mod completions;
pub mod control;
pub mod coordinator;
pub mod drain;
mod embedded;
pub mod fetch;
pub mod field;
mod files;
pub mod fireflies;
pub mod gc;
mod interrupt;
pub mod jobs;
pub mod logs;
mod lookout;
mod metrics;
#[cfg(feature = "openjd")]
pub mod openjd;
mod outbox;
pub mod paths;
pub mod plan;
mod preview;
pub mod render;
pub mod report;
pub mod stats;
pub mod status;
mod subject;
pub mod submit;
pub mod sweep;
pub mod watch;
pub mod worker;
pub mod workers;

use crate::args::{Cli, Command};
use crate::exit::{Exit, Failure};
use crate::output::Say;
use femc_coordinator::{Files, Site};
use femc_model::Control;

/// Do what was asked.
pub fn run(cli: Cli, say: Say) -> Result<Exit, Failure> {
    match cli.command {
        Command::Render(args) => render::run(args, say),
        Command::Plan(args) => plan::run(args, say),
        Command::Check(args) => check::run(&args, say),
        Command::Bench(args) => bench::run(&args, say),
        Command::Compare(args) => compare::run(&args, say),
        Command::Fireflies(args) => fireflies::run(&args, say),
        Command::Field(args) => field::run(args, say),
        Command::Paths(args) => paths::run(&args, say),
        Command::Bottlenecks(args) => bottlenecks::run(&args, say),
        Command::Coordinator(args) => coordinator::run(args, say),
        Command::Worker(args) => worker::run(args, say),
        Command::Submit(args) => submit::run(args, say),
        Command::Sweep(args) => sweep::run(&args, say),
        #[cfg(feature = "openjd")]
        Command::Openjd(args) => openjd::run(&args, say),
        Command::Jobs(args) => jobs::run(&args, say),
        Command::Status(args) => status::run(&args, say),
        Command::Watch(args) => watch::run(&args, say),
        Command::Fetch(args) => fetch::run(&args, say),
        Command::Workers(args) => workers::run(&args, say),
        Command::Report(args) => report::run(&args, say),
        Command::Stats(args) => stats::run(&args, say),
        Command::Logs(args) => logs::run(&args, say),
        Command::Drain(args) => drain::run(&args, say),
        Command::Gc(args) => gc::run(&args, say),
        Command::Backup(args) => backup::run(&args, say),
        Command::Ca(args) => ca::run(args, say),
        Command::Pause(args) => control::run(&args, &Control::Pause, say),
        Command::Resume(args) => control::run(&args, &Control::Resume, say),
        Command::Cancel(args) => control::run(&args, &Control::Cancel, say),
        Command::Retry(args) => control::retry(&args, say),
        Command::Priority(args) => control::prioritize(&args, say),
        Command::Completions { shell } => completions::run(shell),
    }
}

/// What browsers are shown of a farm.
fn site() -> Site {
    #[cfg(feature = "ui")]
    let files = Files(femc_web::FILES);
    #[cfg(not(feature = "ui"))]
    let files = Files::default();
    Site { files, engine: femc_worker::engine().to_owned(), draw: Some(femc_pictures::draw) }
}
