//! The commands, one a file.

mod completions;

use crate::args::{Cli, Command};
use crate::exit::{Exit, Failure};
use crate::output::Say;

/// Do what was asked.
pub fn run(cli: Cli, _say: Say) -> Result<Exit, Failure> {
    match cli.command {
        Command::Completions { shell } => completions::run(shell),
    }
}
