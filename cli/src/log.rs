//! The log on stderr. `FEMC_LOG` (the syntax of tracing's env-filter) overrules the flags.

use crate::args::{Cli, ColorChoice};
use std::io::{self, IsTerminal};
use tracing_subscriber::EnvFilter;

/// Start logging as the flags say.
pub fn start(cli: &Cli) {
    let level = match (cli.common.quiet, cli.common.verbose) {
        (true, _) => "error",
        (_, 0) if cli.command.is_service() => "warn,femc=info,femc_coordinator=info,femc_worker=info",
        (_, 0) => "error",
        (_, 1) => "warn,femc=info,femc_coordinator=info,femc_worker=info,femc_schedule=info",
        (_, 2) => "info,femc=debug,femc_coordinator=debug,femc_worker=debug,femc_schedule=debug",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_env("FEMC_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    let colored = match cli.common.color {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        ColorChoice::Auto => io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none(),
    };
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .with_ansi(colored)
        .with_target(false)
        .init();
}
