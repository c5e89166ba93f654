//! The ledger and its facts as bytes.
//!
//! A snapshot is a version and one section after the other, each in postcard: jobs and their frames, the annex, and groups of
//! tiles, of the jobs that have any.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use femc_model::{JobId, Tick};
use serde::{Deserialize, Serialize};

use super::group::Groups;
use super::{Job, Ledger};
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
    /// First byte of snapshots and of facts; those of other versions are refused.
    pub const VERSION: u8 = 5;

    /// Version and content, for a snapshot.
    pub fn encode(&self) -> Result<Vec<u8>, SnapshotError> {
        let groups = self.jobs.iter().filter_map(|(&job, work)| Some((job, groups(work)?)));
        let bytes = postcard::to_extend(&self.annex, encode(self)?)?;
        Ok(postcard::to_extend(&groups.collect::<BTreeMap<JobId, _>>(), bytes)?)
    }

    /// What [`Self::encode`] wrote.
    pub fn decode(bytes: &[u8]) -> Result<Self, SnapshotError> {
        let (mut ledger, rest) = postcard::take_from_bytes::<Self>(content(bytes)?)?;
        let (annex, rest) = postcard::take_from_bytes(rest)?;
        ledger.annex = annex;
        ledger.put_groups(postcard::from_bytes(rest)?);
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
    Ok(postcard::from_bytes(content(bytes)?)?)
}

/// What follows the version.
fn content(bytes: &[u8]) -> Result<&[u8], SnapshotError> {
    match bytes.split_first() {
        Some((&Ledger::VERSION, content)) => Ok(content),
        Some((&found, _)) => Err(SnapshotError::Version { found }),
        None => Err(SnapshotError::Empty),
    }
}
