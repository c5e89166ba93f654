//! The command line, and the commands, one per file.

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
pub mod fireflies;
pub mod gc;
mod interrupt;
pub mod jobs;
mod live_preview;
pub mod logs;
pub mod measure;
mod metrics;
mod open_files;
#[cfg(feature = "openjd")]
pub mod openjd;
mod outbox;
pub mod paths;
pub mod plan;
mod preview;
mod readings;
pub mod render;
pub mod report;
mod site;
pub mod stats;
pub mod status;
pub mod stylize;
mod subject;
pub mod submit;
pub mod sweep;
pub mod usage;
pub mod view;
pub mod watch;
pub mod worker;
pub mod workers;

use crate::args::CommonArgs;
use crate::exit::{Exit, Failure};
use crate::output::Printer;
use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use femc_model::Control;

/// The whole command line.
#[derive(Debug, Parser)]
#[command(
    name = "femc",
    version,
    about = "A render farm for physically based light",
    after_help = "Examples:\n  \
        femc render scenes/cornell-fog.mgf -o cornell.exr --spp 64\n  \
        femc render scenes/roundabout.mgf --frames 1..24 --size 160x90 --spp 8 -o drive --video drive.mp4\n  \
        femc coordinator & femc worker --join http://127.0.0.1:7878 & femc submit scene.mgf\n\n\
        Exit codes: 0 done, 1 the work failed or a check found a fault, 2 wrong usage, \
        3 interrupted (rerun the command to resume), 4 cannot reach the server.",
    arg_required_else_help = true,
    infer_subcommands = false
)]
pub struct Cli {
    /// Arguments that all commands share.
    #[command(flatten)]
    pub common: CommonArgs,
    /// The command.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands, in the order of `--help`.
#[derive(Debug, Subcommand)]
pub enum Command {
    Render(render::RenderArgs),
    Plan(plan::PlanArgs),
    Check(check::CheckArgs),
    Bench(bench::BenchArgs),
    Compare(compare::CompareArgs),
    Fireflies(fireflies::FirefliesArgs),
    Field(field::FieldArgs),
    Measure(measure::MeasureArgs),
    Paths(paths::PathsArgs),
    Bottlenecks(bottlenecks::BottlenecksArgs),
    View(view::ViewArgs),
    Stylize(stylize::StylizeArgs),
    Coordinator(coordinator::CoordinatorArgs),
    Worker(worker::WorkerArgs),
    Submit(submit::SubmitArgs),
    Sweep(sweep::SweepArgs),
    #[cfg(feature = "openjd")]
    Openjd(openjd::OpenjdArgs),
    Jobs(jobs::JobsArgs),
    Status(status::StatusArgs),
    Watch(watch::WatchArgs),
    Fetch(fetch::FetchArgs),
    Logs(logs::LogsArgs),
    Stats(stats::StatsArgs),
    Report(report::ReportArgs),
    Usage(usage::UsageArgs),
    Workers(workers::WorkersArgs),
    Drain(drain::DrainArgs),
    Gc(gc::GcArgs),
    Backup(backup::BackupArgs),
    Ca(ca::CaArgs),
    /// Pause jobs: running tasks finish, no new ones start
    #[command(after_help = "Examples:\n  femc pause 7\n  femc pause --owner ann")]
    Pause(control::ControlArgs),
    /// Resume paused jobs
    #[command(after_help = "Examples:\n  femc resume 7 8")]
    Resume(control::ControlArgs),
    /// Cancel jobs at once; their finished frames stay
    #[command(after_help = "Examples:\n  femc cancel 7\n  femc cancel 5 6 7\n  femc cancel --owner ann --name 'fog-*'")]
    Cancel(control::ControlArgs),
    /// Retry failed tasks of jobs, or the unfinished tasks of cancelled jobs
    #[command(after_help = "Examples:\n  femc retry 7\n  femc retry 7 --frames 3,7..9\n\n\
        The images of jobs that are done, and of frames given with --frames, are read: frames whose image is damaged or missing are\n\
        rendered again.")]
    Retry(control::RetryArgs),
    /// Delete jobs that have ended, with their frames and logs
    #[command(after_help = "Examples:\n  femc delete 7\n  femc delete --owner ann --name 'test-*'\n\n\
        `femc gc` later removes files that no other job uses. `femc usage` still counts deleted jobs.")]
    Delete(control::ControlArgs),
    /// Change a job's priority
    Priority(control::PriorityArgs),
    /// Print a completion script for a shell
    #[command(after_help = "Examples:\n  \
        femc completions bash > ~/.local/share/bash-completion/completions/femc\n  \
        femc completions zsh > \"${fpath[1]}/_femc\"")]
    Completions {
        /// The shell
        shell: Shell,
    },
}

impl Command {
    /// Name of the service in exported spans.
    #[cfg(feature = "otel")]
    pub fn service(&self) -> &'static str {
        match self {
            Self::Coordinator(_) => "coordinator",
            Self::Worker(_) => "worker",
            _ => "client",
        }
    }

    /// Returns whether the command runs until it is stopped, and so logs its progress.
    pub fn is_service(&self) -> bool {
        matches!(self, Self::Coordinator(_) | Self::Worker(_))
    }
}

/// Runs the command.
pub fn run(cli: Cli, printer: Printer) -> Result<Exit, Failure> {
    match cli.command {
        Command::Render(args) => render::run(args, printer),
        Command::Plan(args) => plan::run(args, printer),
        Command::Check(args) => check::run(&args, printer),
        Command::Bench(args) => bench::run(&args, printer),
        Command::Compare(args) => compare::run(&args, printer),
        Command::Fireflies(args) => fireflies::run(&args, printer),
        Command::Field(args) => field::run(args, printer),
        Command::Measure(args) => measure::run(&args, printer),
        Command::Paths(args) => paths::run(&args, printer),
        Command::Bottlenecks(args) => bottlenecks::run(&args, printer),
        Command::Stylize(args) => stylize::run(&args, printer),
        Command::Coordinator(args) => coordinator::run(args, printer),
        Command::Worker(args) => worker::run(args, printer),
        Command::View(args) => view::run(&args, printer),
        Command::Submit(args) => submit::run(args, printer),
        Command::Sweep(args) => sweep::run(&args, printer),
        #[cfg(feature = "openjd")]
        Command::Openjd(args) => openjd::run(&args, printer),
        Command::Jobs(args) => jobs::run(&args, printer),
        Command::Status(args) => status::run(&args, printer),
        Command::Watch(args) => watch::run(&args, printer),
        Command::Fetch(args) => fetch::run(&args, printer),
        Command::Usage(args) => usage::run(&args, printer),
        Command::Workers(args) => workers::run(&args, printer),
        Command::Report(args) => report::run(&args, printer),
        Command::Stats(args) => stats::run(&args, printer),
        Command::Logs(args) => logs::run(&args, printer),
        Command::Drain(args) => drain::run(&args, printer),
        Command::Gc(args) => gc::run(&args, printer),
        Command::Backup(args) => backup::run(&args, printer),
        Command::Ca(args) => ca::run(args, printer),
        Command::Pause(args) => control::run(&args, &Control::Pause, printer),
        Command::Resume(args) => control::run(&args, &Control::Resume, printer),
        Command::Cancel(args) => control::run(&args, &Control::Cancel, printer),
        Command::Retry(args) => control::retry(&args, printer),
        Command::Delete(args) => control::run(&args, &Control::Delete, printer),
        Command::Priority(args) => control::prioritize(&args, printer),
        Command::Completions { shell } => completions::run(shell, Cli::command()),
    }
}
