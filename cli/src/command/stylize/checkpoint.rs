//! Checkpoint of a run, so that an interrupted run can resume: `OUT.part`, a line of JSON followed by the numbers of source
//! patches.

use super::row::Row;
use crate::exit::{Failure, failed};
use femc_film::file::write_atomic;
use femc_stylize::Checkpoint;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Progress of a run.
#[derive(Debug, Serialize, Deserialize)]
pub struct RunCheckpoint {
    /// Digest of everything that determines the bytes of the current frame: style, settings, the frames up to it.
    pub key: String,
    /// Index of the current frame; those before it are painted.
    pub frame: usize,
    /// Report rows of the painted frames.
    pub rows: Vec<Row>,
    /// Source patches of the previous frame, if there is one.
    #[serde(skip)]
    pub last: Vec<u32>,
    /// State of the current frame, if a level is finished.
    #[serde(skip)]
    pub in_progress: Option<Checkpoint>,
    /// Length of `last`, and number of levels that `in_progress` has left.
    counts: (usize, Option<usize>),
    /// Digest of the patch numbers.
    #[serde(default)]
    digest: String,
}

impl RunCheckpoint {
    /// Creates the checkpoint of a run.
    pub fn new(key: String, frame: usize, rows: Vec<Row>, last: Vec<u32>, in_progress: Option<Checkpoint>) -> Self {
        let counts = (last.len(), in_progress.as_ref().map(|begun| begun.levels_left));
        let mut checkpoint = Self { key, frame, rows, last, in_progress, counts, digest: String::new() };
        checkpoint.digest = blake3::hash(&checkpoint.numbers()).to_hex().to_string();
        checkpoint
    }

    /// Returns the checkpoint's path beside a picture or a folder.
    pub fn path(out: &Path) -> PathBuf {
        let mut name = out.components().as_path().as_os_str().to_owned();
        name.push(".part");
        name.into()
    }

    /// Reads the checkpoint; `None`: it is missing or unreadable.
    pub fn read(path: &Path) -> Option<Self> {
        let bytes = std::fs::read(path).ok()?;
        let end = bytes.iter().position(|&byte| byte == b'\n')?;
        let mut checkpoint: Self = serde_json::from_slice(&bytes[..end]).ok()?;
        if blake3::hash(&bytes[end + 1..]).to_hex().as_str() != checkpoint.digest {
            return None;
        }
        let (numbers, []) = bytes[end + 1..].as_chunks::<4>() else { return None };
        let numbers: Vec<u32> = numbers.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        let (last, patches) = numbers.split_at_checked(checkpoint.counts.0)?;
        checkpoint.last = last.to_vec();
        checkpoint.in_progress =
            checkpoint.counts.1.map(|left| Checkpoint { levels_left: left, patches: patches.to_vec() });
        Some(checkpoint)
    }

    /// Writes the checkpoint atomically.
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        let mut bytes = serde_json::to_vec(self).map_err(failed)?;
        bytes.push(b'\n');
        bytes.extend(self.numbers());
        write_atomic(path, &bytes).map_err(failed)
    }

    /// Returns the numbers of source patches as bytes.
    fn numbers(&self) -> Vec<u8> {
        let begun = self.in_progress.iter().flat_map(|begun| &begun.patches);
        self.last.iter().chain(begun).flat_map(|number| number.to_le_bytes()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_comes_back_and_what_is_cut_off_does_not() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = RunCheckpoint::path(&folder.path().join("clip/"));
        assert!(path.ends_with("clip.part") && RunCheckpoint::read(&path).is_none());
        let begun = Checkpoint { levels_left: 2, patches: vec![7, 8] };
        RunCheckpoint::new("key".into(), 3, Vec::new(), vec![1, 2, 3], Some(begun.clone()))
            .write(&path)
            .expect("written");
        let checkpoint = RunCheckpoint::read(&path).expect("it is there");
        assert_eq!(
            (&*checkpoint.key, checkpoint.frame, checkpoint.last, checkpoint.in_progress),
            ("key", 3, vec![1, 2, 3], Some(begun))
        );
        let bytes = std::fs::read(&path).expect("bytes");
        for end in [0, 5, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..end]).expect("written");
            assert!(RunCheckpoint::read(&path).is_none(), "{end} bytes");
        }
        let mut damaged = bytes;
        *damaged.last_mut().expect("bytes") ^= 1;
        std::fs::write(&path, damaged).expect("written");
        assert!(RunCheckpoint::read(&path).is_none(), "a number is another one");
    }
}
