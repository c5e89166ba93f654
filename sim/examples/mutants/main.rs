//! Mutation testing: checks whether tests and simulation detect small errors. There are several groups of sources ([`group`]). Each
//! mutant of a group's randomly drawn list is run against the tests of its crate. In the group `farm`, simulated farms run the
//! mutants that these tests do not detect.
//!
//! ```sh
//! cargo install cargo-mutants --locked
//! cargo run --release -p femc-sim --example mutants -- draw farm --seed 11 --count 300    # writes sim/mutants/farm
//! tests/postgres cargo run --release -p femc-sim --example mutants -- run farm            # resumes after an interruption
//! ```
//!
//! `cargo mutants --list` lists the possible changes. All mutants of the list are compiled in one build instead of three hundred:
//! each sits behind a switch that the environment variable `FEMC_MUTANT` turns on ([`weave`]). The build uses a worktree under the
//! target directory. The checkout does not change.

mod group;
mod list;
mod trial;
mod weave;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Parser, Subcommand};
use group::Group;

/// Runs small changes of the sources against tests and simulated farms
#[derive(Debug, Parser)]
struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Draw a list of mutants at random and write it
    Draw {
        /// Group of sources: farm, light, views or commands
        #[arg(value_parser = Group::from_name)]
        group: &'static Group,
        /// Seed of the draw
        #[arg(long, default_value_t = 11)]
        seed: u64,
        /// Number of mutants
        #[arg(long, default_value_t = 300)]
        count: usize,
    },
    /// Run the mutants of the list that have no verdict yet
    Run(trial::RunArgs),
}

fn main() -> anyhow::Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().context("a workspace")?.to_owned();
    let list = |group: &Group| root.join("sim/mutants").join(group.name);
    match Args::parse().action {
        Action::Draw { group, seed, count } => {
            let list = list(group);
            let drawn = list::draw(list::list_mutants(&root, group)?, seed, count);
            std::fs::create_dir_all(root.join("sim/mutants"))?;
            list::write(&list, seed, &drawn)?;
            println!("{} mutants in {}", drawn.len(), list.display());
            Ok(())
        }
        Action::Run(args) => trial::run(&root, &list(args.group), &args),
    }
}

/// Returns the folder for builds and results.
fn target(root: &Path) -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from)
}
