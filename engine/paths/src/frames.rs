//! Union of the light statistics of several frames of a job.
//!
//! Frames are keyed by seed and number. A frame that is given twice counts once. All frames have one box and one threshold. So
//! their records together are a fair subset of the samples of all frames: those with the least hashes, no more than one frame
//! keeps. The union is associative, commutative and idempotent to the byte. Counters, pixels and sketches of a frame stay
//! unchanged.
//!
//! As bytes, little-endian:
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCFRAM` |
//! | 4 | format version, 1 |
//! | 4 | number of frames |
//! | for each frame, in order | 8: number of bytes; the [bytes](crate::codec) of its statistics |

use crate::codec::PathsError;
use crate::statistics::{LightStatistics, MergeError};
use std::collections::BTreeMap;

const MAGIC: &[u8; 8] = b"FEMCFRAM";
const VERSION: u32 = 1;
const TRUNCATED: PathsError = PathsError::Corrupt("cut short");

/// Light statistics of frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameStatistics {
    by_key: BTreeMap<(u64, u32), LightStatistics>,
}

impl FrameStatistics {
    /// Unites frames, or parts of frames.
    pub fn from_statistics(all: impl IntoIterator<Item = LightStatistics>) -> Result<Self, MergeError> {
        let mut frames = Self::default();
        frames.merge(all)?;
        Ok(frames)
    }

    /// Adds frames, or parts of frames. Those that are present already count once. An error changes nothing.
    pub fn merge(&mut self, others: impl IntoIterator<Item = LightStatistics>) -> Result<(), MergeError> {
        let mut all = self.clone();
        for other in others {
            all.add(other)?;
        }
        all.unify_threshold();
        *self = all;
        Ok(())
    }

    fn add(&mut self, mut other: LightStatistics) -> Result<(), MergeError> {
        let key = (other.scope.seed, other.scope.frame);
        let boxes = self.frames().chain([&other]).map(|it| (it.scope.lower, it.scope.upper));
        let all = boxes.reduce(|(lower, upper), (low, high)| {
            (
                std::array::from_fn(|axis| low[axis].min(lower[axis])),
                std::array::from_fn(|axis| high[axis].max(upper[axis])),
            )
        });
        for it in self.by_key.values_mut().chain([&mut other]) {
            let (lower, upper) = all.unwrap_or((it.scope.lower, it.scope.upper));
            // Counts by cells of one box cannot be converted to cells of another box.
            if it.scope.has_full_histograms && (it.scope.lower, it.scope.upper) != (lower, upper) {
                return Err(MergeError::Scope);
            }
            (it.scope.lower, it.scope.upper) = (lower, upper);
        }
        match self.by_key.get_mut(&key) {
            Some(own) => own.merge(other),
            None => {
                self.by_key.insert(key, other);
                Ok(())
            }
        }
    }

    /// Sets one threshold for all frames, so that at most as many records remain as one frame keeps.
    fn unify_threshold(&mut self) {
        let keep = self.frames().map(|it| it.scope.max_records as usize).min().unwrap_or(0);
        let mut hashes: Vec<u64> = self.frames().flat_map(|it| it.paths.keys().map(|(hash, _)| *hash)).collect();
        let mut threshold = self.frames().map(|it| it.threshold).min().unwrap_or(0);
        if hashes.len() > keep {
            threshold = threshold.min(*hashes.select_nth_unstable(keep).1);
        }
        for it in self.by_key.values_mut() {
            it.threshold = threshold;
            it.trim();
        }
    }

    /// Returns the frames in order of seed and number.
    pub fn frames(&self) -> impl Iterator<Item = &LightStatistics> + Clone {
        self.by_key.values()
    }

    /// Returns the frames in order of seed and number, by value.
    pub fn into_frames(self) -> Vec<LightStatistics> {
        self.by_key.into_values().collect()
    }

    /// Checks whether bytes begin with the magic number of united frames.
    pub fn has_magic(bytes: &[u8]) -> bool {
        bytes.starts_with(MAGIC)
    }

    /// Encodes the frames as bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = [&MAGIC[..], &VERSION.to_le_bytes(), &(self.by_key.len() as u32).to_le_bytes()].concat();
        for it in self.frames() {
            let bytes = it.encode();
            out.extend((bytes.len() as u64).to_le_bytes());
            out.extend(bytes);
        }
        out
    }

    /// Decodes frames from bytes. Damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, PathsError> {
        let (front, mut rest) = bytes.split_first_chunk::<16>().ok_or(TRUNCATED)?;
        let [magic @ .., a, b, c, d, e, f, g, h] = *front;
        if magic != *MAGIC {
            return Err(PathsError::Corrupt("wrong magic number"));
        }
        let (found, count) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        if found != VERSION {
            return Err(PathsError::Version { found, expected: VERSION });
        }
        let mut frames = Self::default();
        for _ in 0..count {
            let (length, after) = rest.split_first_chunk().ok_or(TRUNCATED)?;
            let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| TRUNCATED)?;
            let (own, after) = after.split_at_checked(length).ok_or(TRUNCATED)?;
            rest = after;
            let it = LightStatistics::decode(own)?;
            let key = (it.scope.seed, it.scope.frame);
            if frames.by_key.last_key_value().is_some_and(|(last, _)| *last >= key) {
                return Err(PathsError::Corrupt("frames are out of order"));
            }
            frames.by_key.insert(key, it);
        }
        // The union of already united frames changes nothing.
        let united = Self::from_statistics(frames.frames().cloned())
            .map_err(|_| PathsError::Corrupt("frames cannot be united"))?;
        let is_whole = rest.is_empty() && united == frames;
        if is_whole { Ok(frames) } else { Err(PathsError::Corrupt("frames are not united")) }
    }
}
