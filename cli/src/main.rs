//! `femc`: scenes to frames, on this machine or a farm.
//!
//! Arguments as typed ([`args`]) become a request as meant ([`request`]); a command ([`command`]) does it with the
//! engine's and the farm's libraries; [`output`] says what came of it.

mod args;
mod attempts;
mod bench;
mod clock;
mod command;
mod config;
mod exit;
mod log;
#[cfg(feature = "openjd")]
mod openjd;
mod output;
mod report;
mod request;

use config::{Parsed, Refused};
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = match config::parse(std::env::args_os().collect()) {
        Ok(Parsed::Command(cli)) => *cli,
        Ok(Parsed::Shown(settings)) => {
            print!("{settings}");
            return exit::Exit::Done.into();
        }
        Err(Refused::Usage(error)) => error.exit(),
        Err(Refused::File(failure)) => {
            eprintln!("femc: error: {failure}");
            return failure.exit.into();
        }
    };
    let say = output::Say::new(&cli.common);
    let _logging = log::start(&cli);
    match command::run(cli, say) {
        Ok(exit) => exit.into(),
        Err(failure) => {
            say.failure(&failure);
            failure.exit.into()
        }
    }
}
