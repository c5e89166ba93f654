//! `femc completions SHELL`.

use crate::args::Cli;
use crate::exit::{Exit, Failure, failed};
use clap::CommandFactory;
use clap_complete::Shell;
use std::io::{self, Write};

/// Print the script.
pub fn run(shell: Shell) -> Result<Exit, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "femc", &mut script);
    match io::stdout().write_all(&script) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(failed(format!("stdout: {e}"))),
        _ => Ok(Exit::Done),
    }
}
