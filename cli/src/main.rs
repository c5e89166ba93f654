//! `femc`: renders scenes to frames, on this machine or on a farm.
//!
//! Typed arguments ([`args`], made of [`values`]) become a resolved request ([`request`]). A command ([`command`]) executes the
//! request with the libraries of the engine and the farm. [`output`] prints the result. A module uses only modules that come before
//! it in this order: values, args, output, request, command, then the startup modules ([`config`], [`log`]). `femc-tests` checks
//! that there are no cycles.

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

use config::{ConfigError, ParsedArgs};
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = match config::parse(std::env::args_os().collect()) {
        Ok(ParsedArgs::Command(cli)) => *cli,
        Ok(ParsedArgs::Settings(settings)) => {
            print!("{settings}");
            return exit::Exit::Done.into();
        }
        Err(ConfigError::Usage(error)) => error.exit(),
        Err(ConfigError::File(failure)) => {
            eprintln!("femc: error: {failure}");
            return failure.exit.into();
        }
    };
    let printer = output::Printer::new(&cli.common);
    let _logging = log::start(&cli);
    match command::run(cli, printer) {
        Ok(exit) => exit.into(),
        Err(failure) => {
            printer.failure(&failure);
            failure.exit.into()
        }
    }
}
