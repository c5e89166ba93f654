//! Store of a worker's unacknowledged results.

use femc_worker::{IfTaken, OutboxConfig, OutboxPlace};
use std::path::PathBuf;

/// Largest size of results on disk in bytes.
const LIMIT: u64 = 4 << 30;

/// Value of `--outbox`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outbox {
    /// Results are kept in memory only.
    Memory,
    /// Results are kept in this folder.
    Folder(PathBuf),
}

/// Parses a folder, or `memory`.
pub fn parse(text: &str) -> Result<Outbox, String> {
    match text {
        "" => Err("give a folder, or memory".to_owned()),
        "memory" => Ok(Outbox::Memory),
        folder => Ok(Outbox::Folder(PathBuf::from(folder))),
    }
}

/// Returns the requested outbox, or one for this coordinator and name under the user's state folder; `None` if there is no such
/// folder.
pub fn config(asked: Option<Outbox>, join: &str, name: &str) -> Option<OutboxPlace> {
    let (folder, if_taken) = match asked {
        Some(Outbox::Memory) => return None,
        Some(Outbox::Folder(folder)) => (folder, IfTaken::Fail),
        None => (state()?.join("femc").join("outbox").join(plain(join, name)), IfTaken::NextFree),
    };
    Some(OutboxPlace::Folder(OutboxConfig { folder, limit: LIMIT, if_taken }))
}

/// Returns a file name for a coordinator and a worker.
fn plain(join: &str, name: &str) -> String {
    let address = join.split_once("://").map_or(join, |(_, address)| address);
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '.' || c == '-';
    format!("{address}-{name}").chars().map(|c| if is_plain(c) { c } else { '_' }).take(100).collect()
}

/// Returns the user's folder for program state.
fn state() -> Option<PathBuf> {
    let folder = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    folder("XDG_STATE_HOME")
        .or_else(|| folder("LOCALAPPDATA"))
        .or_else(|| folder("HOME").map(|home| home.join(".local").join("state")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_named_after_the_coordinator_and_the_worker() {
        assert_eq!(plain("http://farm:7878", "lab 3/a"), "farm_7878-lab_3_a");
        assert_eq!(plain("farm", "..x"), "farm-..x");
    }

    #[test]
    fn an_outbox_is_a_folder_or_memory() {
        assert_eq!(parse("memory"), Ok(Outbox::Memory));
        assert_eq!(parse("a/b"), Ok(Outbox::Folder("a/b".into())));
        assert!(parse("").is_err());
        assert!(config(Some(Outbox::Memory), "http://farm:1", "w").is_none());
    }
}
