//! Mutants: does the proof see small errors? Every mutant of a list that was drawn at random is tried against the tests of its
//! crate, and if these see nothing, against simulated farms.
//!
//! ```sh
//! cargo install cargo-mutants --locked
//! cargo run --release -p femc-sim --example mutants -- draw --seed 11 --count 300    # writes sim/mutants/list
//! tests/postgres cargo run --release -p femc-sim --example mutants -- run            # goes on where it was stopped
//! ```
//!
//! `cargo mutants --list` says what may be changed. All mutants of the list are built at once, each behind a switch that the
//! environment variable `FEMC_MUTANT` throws ([`weave`]): one build instead of three hundred. That happens in a worktree under
//! the target directory; the checkout stays as it is.

mod list;
mod trial;
mod weave;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Parser, Subcommand};

/// Tries mutants of the farm against its tests and simulated worlds
#[derive(Debug, Parser)]
struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Draw a list of mutants at random and write it
    Draw {
        /// Decides which
        #[arg(long, default_value_t = 11)]
        seed: u64,
        /// How many
        #[arg(long, default_value_t = 300)]
        count: usize,
    },
    /// Try the mutants of the list that have no verdict yet
    Run(trial::Asked),
}

fn main() -> anyhow::Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().context("a workspace")?.to_owned();
    let list = root.join("sim/mutants/list");
    match Args::parse().action {
        Action::Draw { seed, count } => {
            let drawn = list::draw(list::all(&root)?, seed, count);
            std::fs::create_dir_all(root.join("sim/mutants"))?;
            list::write(&list, seed, &drawn)?;
            println!("{} mutants in {}", drawn.len(), list.display());
            Ok(())
        }
        Action::Run(asked) => trial::run(&root, &list, &asked),
    }
}

/// Where everything is built and kept.
fn target(root: &Path) -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from)
}
