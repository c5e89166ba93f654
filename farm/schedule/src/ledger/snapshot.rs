//! The ledger and its facts as bytes.
//!
//! A snapshot is a version and one section after the other, each in postcard; later versions have added sections at the
//! end:
//!
//! | since | section |
//! | --- | --- |
//! | 1 | jobs and their frames |
//! | 2 | the annex, to which version 3 has added how tiles are cut, and version 4 the builds of frames |
//! | 3 | groups of tiles, of the jobs that have any |

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use femc_model::{JobId, Tick};
use serde::{Deserialize, Serialize};

use super::group::Groups;
use super::{Annex, Job, Ledger};
use crate::Fact;

/// A snapshot that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotError {
    /// Written by another version.
    #[error("snapshot of version {found}, this program reads {}", Ledger::VERSION)]
    Version {
        /// What its first byte says.
        found: u8,
    },
    /// Not what [`Ledger::encode`] writes.
    #[error("snapshot or fact is damaged: {0}")]
    Damaged(#[from] postcard::Error),
    /// No bytes at all.
    #[error("snapshot or fact is empty")]
    Empty,
}

/// The groups of a job: tiles of each, and what there is of them in its frames in work.
type JobGroups<G> = (NonZeroU32, BTreeMap<u32, G>);

impl Ledger {
    /// First byte of snapshots and of facts; those of every version before are read, too.
    pub const VERSION: u8 = 4;

    /// Version and content, for a snapshot.
    pub fn encode(&self) -> Result<Vec<u8>, SnapshotError> {
        let groups = self.jobs.iter().filter_map(|(&job, work)| Some((job, groups(work)?)));
        let bytes = postcard::to_extend(&self.annex, encode(self)?)?;
        Ok(postcard::to_extend(&groups.collect::<BTreeMap<JobId, _>>(), bytes)?)
    }

    /// What [`Self::encode`] wrote, now or in an earlier version.
    pub fn decode(bytes: &[u8]) -> Result<Self, SnapshotError> {
        let (version, content) = content(bytes)?;
        let (mut ledger, rest) = postcard::take_from_bytes::<Self>(content)?;
        let (annex, rest) = Annex::take(version, rest)?;
        ledger.annex = annex;
        if version >= 3 {
            ledger.put_groups(postcard::from_bytes(rest)?);
        }
        for (&id, job) in &mut ledger.jobs {
            job.cut(ledger.annex.cut_of(id));
        }
        Ok(ledger)
    }

    fn put_groups(&mut self, groups: BTreeMap<JobId, JobGroups<Groups>>) {
        for (job, (tiles, frames)) in groups {
            let Some(job) = self.jobs.get_mut(&job) else { continue };
            job.group = Some(tiles);
            for (number, groups) in frames {
                job.frames.entry(number).and_modify(|frame| frame.groups = groups);
            }
        }
    }
}

fn groups(job: &Job) -> Option<JobGroups<&Groups>> {
    Some((job.group?, job.frames.iter().map(|(&number, frame)| (number, &frame.groups)).collect()))
}

impl Fact {
    /// Version, time and content, for the log.
    pub fn encode(&self, now: Tick) -> Result<Vec<u8>, SnapshotError> {
        encode(&(now, self))
    }

    /// What [`Self::encode`] wrote.
    pub fn decode(bytes: &[u8]) -> Result<(Tick, Self), SnapshotError> {
        decode(bytes)
    }
}

fn encode(value: &impl Serialize) -> Result<Vec<u8>, SnapshotError> {
    Ok(postcard::to_extend(value, vec![Ledger::VERSION])?)
}

fn decode<T: for<'a> Deserialize<'a>>(bytes: &[u8]) -> Result<T, SnapshotError> {
    Ok(postcard::from_bytes(content(bytes)?.1)?)
}

/// The version, and what follows it.
fn content(bytes: &[u8]) -> Result<(u8, &[u8]), SnapshotError> {
    match bytes.split_first() {
        Some((&version @ 1..=Ledger::VERSION, content)) => Ok((version, content)),
        Some((&found, _)) => Err(SnapshotError::Version { found }),
        None => Err(SnapshotError::Empty),
    }
}

#[cfg(test)]
mod tests {
    use femc_model::Drain;

    use super::*;

    #[test]
    fn a_snapshot_of_before_the_groups_is_read() {
        let mut ledger = Ledger::default();
        ledger.apply(&Fact::Opened { incarnation: 7 }, Tick(3));
        ledger.apply(&Fact::Drained { instance: 5, drain: Drain::Begin }, Tick(4));
        let mut old = postcard::to_extend(&ledger.annex, postcard::to_extend(&ledger, vec![2]).unwrap()).unwrap();
        // The annex of version 2 ends before the cuts and the builds, of which there are none.
        assert_eq!(old.split_off(old.len() - 2), [0, 0]);
        assert_eq!(Ledger::decode(&old), Ok(ledger.clone()));
        let new = ledger.encode().unwrap();
        assert_eq!((Ledger::decode(&new), new[0]), (Ok(ledger), 4));
        assert!(Ledger::decode(&new[..new.len() - 1]).is_err());
    }
}
