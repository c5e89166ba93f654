//! `femc`: scenes to frames, on this machine or a farm.
//!
//! Arguments as typed ([`args`]) become a request as meant ([`request`]); a command ([`command`]) does it with the
//! engine's and the farm's libraries; [`output`] says what came of it.

mod args;
mod attempts;
mod clock;
mod command;
mod exit;
mod log;
#[cfg(feature = "openjd")]
mod openjd;
mod output;
mod report;
mod request;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = args::Cli::parse();
    let say = output::Say::new(&cli.common);
    log::start(&cli);
    match command::run(cli, say) {
        Ok(exit) => exit.into(),
        Err(failure) => {
            say.failure(&failure);
            failure.exit.into()
        }
    }
}
