//! State beside the output until the output is finished: the farm's log and artifacts, the identity of the run, and a lock.

use crate::exit::{Failure, failed};
use serde::{Deserialize, Serialize};
use std::fs::{self, File, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Identity of a run. Two runs with equal identities render the same bytes, so one may resume from the state of the other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunIdentity {
    /// Build of the engine.
    pub engine: String,
    /// Content hash of the scene's files.
    pub bundle: String,
    /// Render settings.
    pub settings: serde_json::Value,
}

/// Treatment of an existing state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExistingState {
    /// Resume from it, if its identity is the same.
    Keep,
    /// Remove it.
    Discard,
}

/// Result of the search for a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StateMatch {
    /// No state exists.
    Absent,
    /// A state with the same identity exists: resume from it.
    Same,
    /// A state with another identity existed and was removed.
    Other,
}

/// The folder of the state. It is locked against other processes until this value is dropped.
#[derive(Debug)]
pub struct RunState {
    folder: PathBuf,
    _lock: File,
}

impl RunState {
    /// Opens the state in `folder`, which is created if missing. A state with another identity is removed.
    pub fn open(folder: &Path, identity: &RunIdentity, existing: ExistingState) -> Result<(Self, StateMatch), Failure> {
        let at = |what: &str, e: &dyn std::fmt::Display| failed(format!("{}: {what}: {e}", folder.display()));
        fs::create_dir_all(folder).map_err(|e| at("cannot be created", &e))?;
        let lock = File::create(folder.join("lock")).map_err(|e| at("cannot be written", &e))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(failed(format!(
                    "{}: another femc is rendering there; wait for it, or give another OUT",
                    folder.display()
                )));
            }
            Err(TryLockError::Error(e)) => return Err(at("cannot be locked", &e)),
        }
        let state = Self { folder: folder.to_owned(), _lock: lock };
        let file = folder.join("identity.json");
        let state_match = match fs::read(&file) {
            Ok(text) if existing == ExistingState::Keep && is_same_identity(&text, identity) => StateMatch::Same,
            Ok(_) => {
                state.clear().map_err(|e| at("cannot be emptied", &e))?;
                StateMatch::Other
            }
            Err(_) => StateMatch::Absent,
        };
        if state_match != StateMatch::Same {
            let text = serde_json::to_vec_pretty(identity).map_err(failed)?;
            let written = File::create(&file).and_then(|mut file| file.write_all(&text).and_then(|()| file.sync_all()));
            written.map_err(|e| at("cannot be written", &e))?;
        }
        Ok((state, state_match))
    }

    /// Returns the path of the embedded farm's log.
    pub fn log(&self) -> PathBuf {
        self.folder.join("farm.db")
    }

    /// Returns the folder of the embedded farm's artifacts.
    pub fn artifacts(&self) -> PathBuf {
        self.folder.join("artifacts")
    }

    /// Returns the frames of the job in the log; `None` if no job was submitted yet.
    pub fn frames(&self) -> Option<Vec<u32>> {
        serde_json::from_slice(&fs::read(self.folder.join("frames.json")).ok()?).ok()
    }

    /// Stores the frames of the job, before it is submitted.
    pub fn save_frames(&self, frames: &[u32]) -> Result<(), Failure> {
        let text = serde_json::to_vec(frames).map_err(failed)?;
        femc_film::file::write_atomic(&self.folder.join("frames.json"), &text).map_err(failed)
    }

    /// Removes the state after the work is done.
    pub fn remove(self) -> std::io::Result<()> {
        fs::remove_dir_all(&self.folder)
    }

    /// Removes everything but the lock.
    fn clear(&self) -> std::io::Result<()> {
        for entry in fs::read_dir(&self.folder)? {
            let entry = entry?;
            if entry.file_type()?.is_dir() {
                fs::remove_dir_all(entry.path())?;
            } else if entry.file_name() != "lock" {
                fs::remove_file(entry.path())?;
            }
        }
        Ok(())
    }
}

fn is_same_identity(text: &[u8], identity: &RunIdentity) -> bool {
    serde_json::from_slice::<RunIdentity>(text).is_ok_and(|found| found == *identity)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity(seed: u64) -> RunIdentity {
        RunIdentity { engine: "1".into(), bundle: "b".into(), settings: serde_json::json!({ "seed": seed }) }
    }

    #[test]
    fn state_is_reused_for_same_identity_and_cleared_for_another() {
        let temp = tempfile::tempdir().expect("a folder");
        let folder = temp.path().join("out/.femc");
        let open = |seed| RunState::open(&folder, &identity(seed), ExistingState::Keep).expect("a state");
        let (state, found) = open(1);
        assert_eq!(found, StateMatch::Absent);
        fs::write(state.log(), "log").expect("written");
        fs::create_dir(state.artifacts()).expect("made");
        drop(state);
        let (state, found) = open(1);
        assert_eq!((found, state.log().exists()), (StateMatch::Same, true));
        drop(state);
        let (state, found) = open(2);
        assert_eq!((found, state.log().exists(), state.artifacts().exists()), (StateMatch::Other, false, false));
        state.remove().expect("removed");
        assert!(!folder.exists() && temp.path().join("out").exists());
    }

    #[test]
    fn a_state_is_discarded_on_demand() {
        let temp = tempfile::tempdir().expect("a folder");
        let open = |old| RunState::open(temp.path(), &identity(1), old).expect("a state");
        let (state, _) = open(ExistingState::Keep);
        fs::write(state.log(), "log").expect("written");
        drop(state);
        let (state, found) = open(ExistingState::Discard);
        assert_eq!((found, state.log().exists()), (StateMatch::Other, false));
    }

    #[test]
    fn a_state_in_use_is_refused() {
        let temp = tempfile::tempdir().expect("a folder");
        let first = RunState::open(temp.path(), &identity(1), ExistingState::Keep).expect("a state");
        let second = RunState::open(temp.path(), &identity(1), ExistingState::Keep).expect_err("a refusal");
        assert!(second.message.contains("another femc"), "{second}");
        drop(first);
    }

    #[test]
    fn a_damaged_identity_is_another_one() {
        let temp = tempfile::tempdir().expect("a folder");
        fs::write(temp.path().join("identity.json"), "{").expect("written");
        assert_eq!(
            RunState::open(temp.path(), &identity(1), ExistingState::Keep).expect("a state").1,
            StateMatch::Other
        );
    }
}
