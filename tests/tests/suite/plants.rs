//! Planted bugs: `tests/plants/run` and `sim/plants/run` show that tests find them.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns the patches below a folder.
fn patches(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut out = Vec::new();
    for path in entries.map(|entry| entry.expect("an entry").path()) {
        if path.is_dir() {
            out.extend(patches(&path));
        } else if path.extension().is_some_and(|extension| extension == "patch") {
            out.push(path);
        }
    }
    out.sort();
    out
}

/// A change of the sources must update the patches that no longer apply. Otherwise, the long test of planted bugs fails much later.
#[test]
fn planted_bugs_apply_to_the_sources() {
    if Command::new("git").arg("--version").output().is_err() {
        println!("git is not available: skipped");
        return;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let all: Vec<PathBuf> = ["sim/plants", "tests/plants"].iter().flat_map(|name| patches(&root.join(name))).collect();
    assert!(all.len() > 50, "{} planted bugs", all.len());
    let failing: Vec<String> = all
        .iter()
        .filter_map(|patch| {
            let output = Command::new("git").args(["apply", "--check"]).arg(patch).current_dir(&root).output();
            let output = output.expect("git");
            (!output.status.success()).then(|| String::from_utf8_lossy(&output.stderr).into_owned())
        })
        .collect();
    assert!(failing.is_empty(), "{}", failing.join("\n"));
}
