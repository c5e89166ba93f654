//! `femc completions SHELL`.

use crate::exit::{Exit, Failure, failed};
use clap::Command;
use clap_complete::Shell;
use std::io::{self, Write};

/// Prints the script.
/// - `command`: the whole command line.
pub fn run(shell: Shell, mut command: Command) -> Result<Exit, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, "femc", &mut script);
    match io::stdout().write_all(&script) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(failed(format!("stdout: {e}"))),
        _ => Ok(Exit::Done),
    }
}
