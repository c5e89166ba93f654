//! The commands, one a file.

pub mod check;
pub mod compare;
pub mod completions;
pub mod plan;

use crate::args::{Cli, Command};
use crate::exit::{Exit, Failure};
use crate::output::Say;

/// Do what was asked.
pub fn run(cli: Cli, say: Say) -> Result<Exit, Failure> {
    match cli.command {
        Command::Plan(args) => plan::run(args, say),
        Command::Check(args) => check::run(args, say),
        Command::Compare(args) => compare::run(args, say),
        Command::Completions { shell } => completions::run(shell),
    }
}
