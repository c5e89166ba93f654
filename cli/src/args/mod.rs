//! The arguments as typed. Every command has a file under `command/`; what they share is here.

mod extras;
mod metrics;
mod select;
mod settings;
mod values;

pub use extras::ExtrasArgs;
pub use metrics::MetricsArgs;
pub use select::SelectArgs;
pub use settings::{SettingsArgs, Stats};
pub use values::{Filter, Method};

use crate::command;
use crate::exit::{Failure, failed};
use clap::{ArgAction, Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use femc_proto::Dial;
use femc_trust::{Identity, Pass};
use std::path::{Path, PathBuf};

/// The whole command line.
#[derive(Debug, Parser)]
#[command(
    name = "femc",
    version,
    about = "A physically based render farm: foggy scenes to frames, exactly",
    after_help = "Examples:\n  \
        femc render scenes/cornell-fog.mgf -o cornell.exr --spp 64\n  \
        femc render scenes/roundabout.mgf --frames 1..24 --size 160x90 --spp 8 -o drive --video drive.mp4\n  \
        femc coordinator & femc worker --join http://127.0.0.1:7878 & femc submit scene.mgf\n\n\
        Exit codes: 0 done, 1 the work failed or a check found a fault, 2 wrong usage, \
        3 interrupted (the same command goes on), 4 the server could not be reached.",
    arg_required_else_help = true,
    infer_subcommands = false
)]
pub struct Cli {
    /// What all commands share.
    #[command(flatten)]
    pub common: CommonArgs,
    /// The command.
    #[command(subcommand)]
    pub command: Command,
}

/// Flags of every command.
#[derive(Clone, Debug, Args)]
#[command(next_display_order = 900)]
pub struct CommonArgs {
    /// Say less: no progress, no notes, only errors and the result
    #[arg(long, short, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Say more; up to three times
    #[arg(long, short, global = true, action = ArgAction::Count)]
    pub verbose: u8,
    /// Colors: on a terminal, always, or never (NO_COLOR is heeded)
    #[arg(long, global = true, value_enum, default_value_t = ColorChoice::Auto, value_name = "WHEN")]
    pub color: ColorChoice,
    /// The log on stderr: text for people, or a JSON object a line
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text, value_name = "FORMAT", env = "FEMC_LOG_FORMAT")]
    pub log_format: LogFormat,
    /// File of settings [default: femc.toml here, in ~/.config/femc or in /etc/femc, the first that is there]
    #[arg(long, global = true, value_name = "FILE", env = "FEMC_CONFIG")]
    pub config: Option<PathBuf>,
    /// Print the command's settings as they hold (flag, then environment, then file, then default), each with where it comes
    /// from, and do nothing
    #[arg(long, global = true)]
    pub print_config: bool,
}

/// The form of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// For machines.
    Json,
}

/// When to use colors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorChoice {
    /// On a terminal, unless NO_COLOR is set.
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// The output form of a command that lists or measures.
#[derive(Clone, Copy, Debug, Args)]
pub struct FormatArgs {
    /// Print JSON on stdout, for machines
    #[arg(long)]
    pub json: bool,
}

/// The address of the farm, for every client command.
#[derive(Clone, Debug, Args)]
pub struct ServerArgs {
    /// The farm's coordinator; of several, with commas between, the one that answers
    #[arg(long, env = "FEMC_SERVER", value_name = "URL,..", default_value = "http://127.0.0.1:7878")]
    pub server: String,
    #[command(flatten)]
    pub identity: IdentityArgs,
}

/// Who this program says that it is.
#[derive(Clone, Debug, Args)]
pub struct IdentityArgs {
    /// File that says who you are, for addresses that begin with https://; `femc ca issue` makes one
    #[arg(long, env = "FEMC_IDENTITY", value_name = "FILE")]
    pub identity: Option<PathBuf>,
    /// File with a token that says who you are, instead; `femc ca token` makes one. It is sent to https:// addresses and to
    /// this machine, nowhere else
    #[arg(long, env = "FEMC_TOKEN_FILE", value_name = "FILE", conflicts_with = "identity")]
    pub token_file: Option<PathBuf>,
}

impl IdentityArgs {
    /// How to reach a coordinator with it.
    pub fn dial(&self) -> Result<Dial, Failure> {
        let dial = match &self.identity {
            None => Dial::tcp(),
            Some(path) => Dial::tcp().with(identity(path)?),
        };
        let Some(path) = &self.token_file else { return Ok(dial) };
        let pass = Pass::read(path).map_err(|error| failed(format!("--token-file: {error}")))?;
        Ok(dial.bearing(pass))
    }
}

/// Read one.
pub fn identity(path: &Path) -> Result<Identity, Failure> {
    Identity::read(path).map_err(|error| failed(format!("--identity: {error}")))
}

/// The commands, in the order of `--help`.
#[derive(Debug, Subcommand)]
pub enum Command {
    Render(command::render::RenderArgs),
    Plan(command::plan::PlanArgs),
    Check(command::check::CheckArgs),
    Bench(command::bench::BenchArgs),
    Compare(command::compare::CompareArgs),
    Fireflies(command::fireflies::FirefliesArgs),
    Field(command::field::FieldArgs),
    Paths(command::paths::PathsArgs),
    Bottlenecks(command::bottlenecks::BottlenecksArgs),
    Coordinator(command::coordinator::CoordinatorArgs),
    Worker(command::worker::WorkerArgs),
    Submit(command::submit::SubmitArgs),
    Sweep(command::sweep::SweepArgs),
    #[cfg(feature = "openjd")]
    Openjd(command::openjd::OpenjdArgs),
    Jobs(command::jobs::JobsArgs),
    Status(command::status::StatusArgs),
    Watch(command::watch::WatchArgs),
    Fetch(command::fetch::FetchArgs),
    Logs(command::logs::LogsArgs),
    Stats(command::stats::StatsArgs),
    Report(command::report::ReportArgs),
    Workers(command::workers::WorkersArgs),
    Drain(command::drain::DrainArgs),
    Gc(command::gc::GcArgs),
    Backup(command::backup::BackupArgs),
    Ca(command::ca::CaArgs),
    /// Hold jobs: running tasks end, no new ones begin
    #[command(after_help = "Examples:\n  femc pause 7\n  femc pause --owner ann")]
    Pause(command::control::JobsArgs),
    /// End a pause
    #[command(after_help = "Examples:\n  femc resume 7 8")]
    Resume(command::control::JobsArgs),
    /// End jobs now; their finished frames stay
    #[command(after_help = "Examples:\n  femc cancel 7\n  femc cancel 5 6 7\n  femc cancel --owner ann --name 'fog-*'")]
    Cancel(command::control::JobsArgs),
    /// Try again what failed of jobs, or what a cancel left undone
    #[command(after_help = "Examples:\n  femc retry 7\n  femc retry 7 --frames 3,7..9\n\n\
        Of a job that is done, and of the frames that are named, the images are read: frames whose image is damaged or gone are\n\
        rendered again.")]
    Retry(command::control::RetryArgs),
    /// Change a job's priority
    Priority(command::control::PriorityArgs),
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
    /// What it is to those who collect spans.
    #[cfg(feature = "otel")]
    pub fn service(&self) -> &'static str {
        match self {
            Self::Coordinator(_) => "coordinator",
            Self::Worker(_) => "worker",
            _ => "client",
        }
    }

    /// Whether the command runs until it is stopped, and so tells what it does as it goes.
    pub fn is_service(&self) -> bool {
        matches!(self, Self::Coordinator(_) | Self::Worker(_))
    }
}
