//! Checkpoint of a run, so that an interrupted run can resume: `OUT.part`, a line of JSON followed by the numbers of source
//! patches.

use super::row::Row;
use crate::exit::{Failure, failed};
use femc_film::file::write_atomic;
use femc_stylize::Begun;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Progress of a run.
#[derive(Debug, Serialize, Deserialize)]
pub struct Kept {
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
    pub begun: Option<Begun>,
    /// Length of `last`, and number of levels that `begun` has left.
    counts: (usize, Option<usize>),
    /// Digest of the patch numbers.
    #[serde(default)]
    digest: String,
}

impl Kept {
    /// Creates the checkpoint of a run.
    pub fn new(key: String, frame: usize, rows: Vec<Row>, last: Vec<u32>, begun: Option<Begun>) -> Self {
        let counts = (last.len(), begun.as_ref().map(|begun| begun.left));
        let mut kept = Self { key, frame, rows, last, begun, counts, digest: String::new() };
        kept.digest = blake3::hash(&kept.numbers()).to_hex().to_string();
        kept
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
        let mut kept: Self = serde_json::from_slice(&bytes[..end]).ok()?;
        if blake3::hash(&bytes[end + 1..]).to_hex().as_str() != kept.digest {
            return None;
        }
        let (numbers, []) = bytes[end + 1..].as_chunks::<4>() else { return None };
        let numbers: Vec<u32> = numbers.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        let (last, patches) = numbers.split_at_checked(kept.counts.0)?;
        kept.last = last.to_vec();
        kept.begun = kept.counts.1.map(|left| Begun { left, patches: patches.to_vec() });
        Some(kept)
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
        let begun = self.begun.iter().flat_map(|begun| &begun.patches);
        self.last.iter().chain(begun).flat_map(|number| number.to_le_bytes()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_comes_back_and_what_is_cut_off_does_not() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = Kept::path(&folder.path().join("clip/"));
        assert!(path.ends_with("clip.part") && Kept::read(&path).is_none());
        let begun = Begun { left: 2, patches: vec![7, 8] };
        Kept::new("key".into(), 3, Vec::new(), vec![1, 2, 3], Some(begun.clone())).write(&path).expect("written");
        let kept = Kept::read(&path).expect("it is there");
        assert_eq!((&*kept.key, kept.frame, kept.last, kept.begun), ("key", 3, vec![1, 2, 3], Some(begun)));
        let bytes = std::fs::read(&path).expect("bytes");
        for end in [0, 5, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..end]).expect("written");
            assert!(Kept::read(&path).is_none(), "{end} bytes");
        }
        let mut damaged = bytes;
        *damaged.last_mut().expect("bytes") ^= 1;
        std::fs::write(&path, damaged).expect("written");
        assert!(Kept::read(&path).is_none(), "a number is another one");
    }
}
