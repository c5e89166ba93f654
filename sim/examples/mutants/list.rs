//! Lists all mutants and draws a random sample of them.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;
use std::{fs, io};

use anyhow::{Context as _, ensure};
use rand::SeedableRng as _;
use rand::rngs::SmallRng;
use rand::seq::SliceRandom as _;
use serde::Deserialize;

use crate::group::Group;

/// Position in a file: line and column, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
pub struct Position {
    pub line: usize,
    pub column: usize,
}

/// Range in a file, from its start position to its end position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
pub struct Extent {
    pub start: Position,
    pub end: Position,
}

#[derive(Debug, Clone, Deserialize)]
struct Function {
    function_name: String,
}

/// Entry of the output of `cargo mutants --list --json`.
#[derive(Debug, Deserialize)]
struct ListEntry {
    name: String,
    package: String,
    file: String,
    function: Option<Function>,
    genre: String,
    span: Extent,
    replacement: String,
}

/// A small change to the sources.
#[derive(Debug, Clone)]
pub struct Mutant {
    /// Key without line numbers, because these change: file, function, change, and a running number among equal ones.
    pub key: String,
    pub package: String,
    pub file: String,
    pub genre: String,
    pub extent: Extent,
    pub replacement: String,
}

/// Lists all mutants of the group in the sources at `root`.
pub fn list_mutants(root: &Path, group: &Group) -> anyhow::Result<Vec<Mutant>> {
    let mut command = Command::new("cargo");
    command.args(["mutants", "--list", "--json"]).current_dir(root);
    for file in group.files {
        command.args(["--file", file]);
    }
    let output = command.output()?;
    ensure!(output.status.success(), "cargo mutants --list: {}", String::from_utf8_lossy(&output.stderr));
    let mut listed: Vec<ListEntry> = serde_json::from_slice(&output.stdout).context("the list of cargo mutants")?;
    listed.sort_by(|a, b| (&a.file, a.span, &a.replacement).cmp(&(&b.file, b.span, &b.replacement)));
    let mut times: BTreeMap<String, u32> = BTreeMap::new();
    Ok(listed.into_iter().map(|listed| mutant(listed, &mut times)).collect())
}

fn mutant(entry: ListEntry, times: &mut BTreeMap<String, u32>) -> Mutant {
    let ListEntry { name, package, file, function, genre, span, replacement } = entry;
    let change = name.splitn(4, ':').nth(3).unwrap_or(&name).trim().to_owned();
    let function = function.map_or_else(String::new, |function| function.function_name);
    let like = format!("{file}\t{function}\t{change}");
    let time = times.entry(like.clone()).or_default();
    *time += 1;
    Mutant { key: format!("{like}\t{time}"), package, file, genre, extent: span, replacement }
}

/// Draws `count` of the mutants at random.
pub fn draw(mut all: Vec<Mutant>, seed: u64, count: usize) -> Vec<Mutant> {
    all.shuffle(&mut SmallRng::seed_from_u64(seed));
    all.truncate(count);
    all.sort_by(|a, b| a.key.cmp(&b.key));
    all
}

/// Writes a list of mutants to a file.
pub fn write(path: &Path, seed: u64, mutants: &[Mutant]) -> io::Result<()> {
    let mut text =
        format!("# {} mutants, drawn with seed {seed}: file, function, change, number among its like\n", mutants.len());
    for mutant in mutants {
        // Writing into a string cannot fail.
        let _ = writeln!(text, "{}", mutant.key);
    }
    fs::write(path, text)
}

/// Reads the keys of a list.
pub fn read(path: &Path) -> anyhow::Result<Vec<String>> {
    let text = fs::read_to_string(path).with_context(|| format!("{}; `mutants draw` makes it", path.display()))?;
    Ok(text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect())
}
