//! `femc`: scenes to frames, on this machine or a farm.
//!
//! Arguments as typed ([`args`], of [`values`]) become a request as meant ([`request`]); a command ([`command`]) does it with
//! the engine's and the farm's libraries; [`output`] says what came of it. A module uses those before it alone: values, args,
//! output, request, command, then what starts them ([`config`], [`log`]); `femc-tests` looks for circles.

mod args;
mod clock;
mod command;
mod config;
mod exit;
mod log;
mod output;
mod request;
mod threads;
mod values;

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
