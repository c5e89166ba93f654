//! Store of a worker's unacknowledged results.

use femc_worker::{OutboxConfig, OutboxConflict, OutboxStorage};
use std::path::PathBuf;

/// Largest size of results on disk in bytes.
const MAX_BYTES: u64 = 4 << 30;

/// Value of `--outbox`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OutboxArg {
    /// Results are kept in memory only.
    Memory,
    /// Results are kept in this folder.
    Folder(PathBuf),
}

/// Parses a folder, or `memory`.
pub fn parse(text: &str) -> Result<OutboxArg, String> {
    match text {
        "" => Err("give a folder, or memory".to_owned()),
        "memory" => Ok(OutboxArg::Memory),
        folder => Ok(OutboxArg::Folder(PathBuf::from(folder))),
    }
}

/// Returns the requested outbox, or one for this coordinator and name under the user's state folder; `None` if there is no such
/// folder.
pub fn config(requested: Option<OutboxArg>, join: &str, name: &str) -> Option<OutboxStorage> {
    let (folder, if_taken) = match requested {
        Some(OutboxArg::Memory) => return None,
        Some(OutboxArg::Folder(folder)) => (folder, OutboxConflict::Fail),
        None => (state_folder()?.join("femc").join("outbox").join(folder_name(join, name)), OutboxConflict::NextFree),
    };
    Some(OutboxStorage::Folder(OutboxConfig { folder, limit: MAX_BYTES, on_conflict: if_taken }))
}

/// Returns a file name for a coordinator and a worker.
fn folder_name(join: &str, name: &str) -> String {
    let address = join.split_once("://").map_or(join, |(_, address)| address);
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '.' || c == '-';
    format!("{address}-{name}").chars().map(|c| if is_plain(c) { c } else { '_' }).take(100).collect()
}

/// Returns the user's folder for program state.
fn state_folder() -> Option<PathBuf> {
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
        assert_eq!(folder_name("http://farm:7878", "lab 3/a"), "farm_7878-lab_3_a");
        assert_eq!(folder_name("farm", "..x"), "farm-..x");
    }

    #[test]
    fn an_outbox_is_a_folder_or_memory() {
        assert_eq!(parse("memory"), Ok(OutboxArg::Memory));
        assert_eq!(parse("a/b"), Ok(OutboxArg::Folder("a/b".into())));
        assert!(parse("").is_err());
        assert!(config(Some(OutboxArg::Memory), "http://farm:1", "w").is_none());
    }
}
