//! Compares the table of crates in ARCHITECTURE.md with the manifests.
//!
//! The column "may use" of a row names crates of the workspace by the last part of their folder, groups of crates (`farm`: those in
//! `farm/`; `all of the above`; `everything`), and notable external packages. The table does not list dependencies of tests.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use toml::Table;

type Names = BTreeSet<String>;

/// A member of the workspace, with its folder.
pub(crate) struct Member {
    pub(crate) folder: String,
    /// Direct dependencies: without and with those of tests.
    pub(crate) direct: Names,
    with_tests: Names,
}

/// A row of the table.
struct Row {
    folder: String,
    may_use: Vec<String>,
}

pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn manifest(folder: &Path) -> Table {
    let path = folder.join("Cargo.toml");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    text.parse().unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Returns the names in the tables `kinds`, including target-specific tables.
fn dependencies(manifest: &Table, kinds: &[&str]) -> Names {
    let machines = manifest.get("target").and_then(|target| target.as_table()).into_iter().flat_map(Table::values);
    let tables = machines.filter_map(|machine| machine.as_table()).chain([manifest]);
    let named = tables.flat_map(|table| kinds.iter().filter_map(|kind| table.get(*kind)?.as_table()));
    named.flat_map(Table::keys).cloned().collect()
}

/// Returns all members by package name.
pub(crate) fn members() -> BTreeMap<String, Member> {
    let workspace = manifest(&root());
    let folders = workspace["workspace"]["members"].as_array().expect("members");
    let member = |folder: &toml::Value| {
        let folder = folder.as_str().expect("a folder").to_owned();
        let manifest = manifest(&root().join(&folder));
        let name = manifest["package"]["name"].as_str().expect("a name").to_owned();
        let direct = dependencies(&manifest, &["dependencies", "build-dependencies"]);
        let with_tests = dependencies(&manifest, &["dependencies", "build-dependencies", "dev-dependencies"]);
        (name, Member { folder, direct, with_tests })
    };
    folders.iter().map(member).collect()
}

fn table() -> Vec<Row> {
    let page = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let (_, section) = page.split_once("\n## Crates\n").expect("a section on crates");
    let (section, _) = section.split_once("\n## ").unwrap_or((section, ""));
    let row = |line: &str| {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let [_, folder, _, may_use, _] = cells[..] else { panic!("a row of three columns: {line}") };
        let may_use = may_use.split(',').map(str::trim).filter(|word| !word.is_empty());
        Row { folder: folder.trim_matches('`').to_owned(), may_use: may_use.map(str::to_owned).collect() }
    };
    section.lines().filter(|line| line.starts_with("| `")).map(row).collect()
}

fn short(folder: &str) -> &str {
    folder.rsplit('/').next().unwrap_or(folder)
}

/// Returns the folders of a group named in row `at`; `None`: the word is not a group.
fn group(rows: &[Row], at: usize, word: &str) -> Option<Names> {
    let all = rows.iter().map(|row| row.folder.clone());
    match word {
        "everything" => Some(all.collect()),
        "all of the above" => Some(all.take(at).collect()),
        "farm" => Some(all.filter(|folder| folder.starts_with("farm/")).collect()),
        _ => None,
    }
}

/// Adds to `allowed` the folders that row `at` may use directly or indirectly.
fn allow(rows: &[Row], at: usize, allowed: &mut Names) {
    for word in &rows[at].may_use {
        let named = || rows.iter().filter(|row| short(&row.folder) == word).map(|row| row.folder.clone()).collect();
        for folder in group(rows, at, word).unwrap_or_else(named) {
            if allowed.insert(folder.clone()) {
                let next = rows.iter().position(|row| row.folder == folder).expect("a row");
                allow(rows, next, allowed);
            }
        }
    }
}

#[test]
fn every_member_is_in_the_table_once_and_nothing_else_is() {
    let mut rows: Vec<String> = table().into_iter().map(|row| row.folder).collect();
    let mut folders: Vec<String> = members().into_values().map(|member| member.folder).collect();
    rows.sort();
    folders.sort();
    assert_eq!(rows, folders);
}

#[test]
fn what_a_row_names_is_a_direct_dependency() {
    let (members, rows) = (members(), table());
    for (at, row) in rows.iter().enumerate() {
        let member = members.values().find(|member| member.folder == row.folder).expect("a member");
        let used: Names = member
            .direct
            .iter()
            .map(|name| members.get(name).map_or(name.as_str(), |used| short(&used.folder)).to_owned())
            .collect();
        for word in row.may_use.iter().filter(|word| group(&rows, at, word).is_none()) {
            assert!(used.contains(word), "{} does not depend on {word}, which its row names", row.folder);
        }
    }
}

#[test]
fn crate_uses_only_its_row_and_rows_of_its_dependencies() {
    let (members, rows) = (members(), table());
    for (at, row) in rows.iter().enumerate() {
        let mut allowed = Names::new();
        allow(&rows, at, &mut allowed);
        let member = members.values().find(|member| member.folder == row.folder).expect("a member");
        for used in member.direct.iter().filter_map(|name| members.get(name)) {
            assert!(allowed.contains(&used.folder), "{} may not use {}, by its row", row.folder, used.folder);
        }
    }
}

#[test]
fn engine_and_farm_never_meet_below_shells_or_in_tests() {
    let members = members();
    let is_engine = |folder: &str| folder.starts_with("engine/");
    let is_farm = |folder: &str| folder.starts_with("farm/") || folder == "proto";
    for member in members.values().filter(|member| is_engine(&member.folder) || is_farm(&member.folder)) {
        let (mut reached, mut todo) = (BTreeSet::new(), vec![member]);
        while let Some(next) = todo.pop() {
            if reached.insert(&next.folder) {
                todo.extend(next.with_tests.iter().filter_map(|name| members.get(name)));
            }
        }
        let other =
            reached.iter().find(|folder| if is_engine(&member.folder) { is_farm(folder) } else { is_engine(folder) });
        assert_eq!(other, None, "{} depends on it", member.folder);
    }
}

/// Searching documentation for examples and compiling each takes a second per crate. Libraries have no such examples. Tests replace
/// them.
#[test]
fn no_library_is_searched_for_examples_and_none_has_any() {
    fn examples(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                examples(&path, found);
            } else if path.extension().is_some_and(|is| is == "rs") {
                let text = std::fs::read_to_string(&path).expect("text");
                let fences = text.lines().filter_map(|line| {
                    let said = line.trim_start();
                    said.strip_prefix("/// ```").or_else(|| said.strip_prefix("//! ```"))
                });
                // The first fence of each pair names the language of the block. Without a name it is Rust.
                if fences.step_by(2).any(|is| matches!(is, "" | "rust")) {
                    found.push(path);
                }
            }
        }
    }
    let mut found = Vec::new();
    for Member { folder, .. } in members().into_values() {
        let folder = root().join(folder);
        if folder.join("src/lib.rs").exists() {
            let library = manifest(&folder);
            let searched = library.get("lib").and_then(|lib| lib.get("doctest")?.as_bool());
            assert_eq!(searched, Some(false), "{}", folder.display());
            examples(&folder.join("src"), &mut found);
        }
    }
    assert!(found.is_empty(), "these have examples: {found:?}");
}
