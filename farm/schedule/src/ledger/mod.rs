//! The durable half of the scheduler: what is asked for, what is done, what has failed.

mod annex;
pub(crate) mod frame;
mod job;

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{Digest, JobId, Tick};
use serde::{Deserialize, Serialize};

use crate::Fact;
pub(crate) use annex::Annex;
pub(crate) use job::{Hold, Job};

/// All jobs. Changes by [`Ledger::apply`] alone: same facts, same ledger.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    pub(crate) incarnation: u32,
    pub(crate) now: Tick,
    last_job: u64,
    keys: BTreeMap<String, JobId>,
    pub(crate) jobs: BTreeMap<JobId, Job>,
    /// What later versions have added: it follows the rest in a snapshot, and an older snapshot ends without it.
    #[serde(skip)]
    pub(crate) annex: Annex,
}

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

impl Ledger {
    /// First byte of snapshots and of facts. Those of version 1 are read too: its snapshots end before the annex.
    pub const VERSION: u8 = 2;

    /// The number that the next job gets.
    pub(crate) fn next_job(&self) -> JobId {
        JobId(self.last_job + 1)
    }

    /// The job that was submitted with this key.
    pub fn job_of_key(&self, key: &str) -> Option<JobId> {
        self.keys.get(key).copied()
    }

    /// The time of the last fact.
    pub fn now(&self) -> Tick {
        self.now
    }

    /// Changes the ledger; returns the artefacts that it names no longer. A fact about what is not there changes nothing.
    pub fn apply(&mut self, fact: &Fact, now: Tick) -> Vec<Digest> {
        self.now = self.now.max(now);
        let (job, released) = match fact {
            Fact::Opened { incarnation } => {
                self.incarnation = self.incarnation.max(*incarnation);
                return Vec::new();
            }
            Fact::Submitted { job, key, spec } => {
                self.last_job = self.last_job.max(job.0);
                if let Some(key) = key {
                    self.keys.insert(key.clone(), *job);
                }
                self.jobs.insert(*job, Job::new(spec.clone(), now));
                return Vec::new();
            }
            Fact::Drained { instance, drain } => {
                self.annex.drain(*instance, *drain);
                return Vec::new();
            }
            Fact::Logged(record) => {
                let is_known = self.jobs.contains_key(&record.task.job);
                let released = if is_known { self.annex.log(record) } else { Vec::new() };
                return self.unreferenced(released);
            }
            Fact::Forgotten { job } => {
                self.jobs.remove(job);
                self.keys.retain(|_, other| other != job);
                self.annex.forget(*job);
                return Vec::new();
            }
            Fact::Rendered { task, epoch, leased, result } => {
                let job = self.jobs.get_mut(&task.job);
                (task.job, job.map(|job| job.rendered(task, *epoch, *leased, result)))
            }
            Fact::Merged { task, epoch, result } => {
                (task.job, self.jobs.get_mut(&task.job).map(|job| job.merged(task, *epoch, result, now)))
            }
            Fact::Failed { task, failure } => {
                (task.job, self.jobs.get_mut(&task.job).map(|job| job.failed(task, failure, now)))
            }
            Fact::Lost { task } => (task.job, self.jobs.get_mut(&task.job).map(|job| job.lost(task))),
            Fact::Restarted { job, frame } => (*job, self.jobs.get_mut(job).map(|j| j.restarted(*frame))),
            Fact::Doomed { job, failure } => (*job, self.jobs.get_mut(job).map(|j| j.doomed(failure))),
            Fact::Controlled { job, control } => (*job, self.jobs.get_mut(job).map(|j| j.controlled(*control))),
        };
        if let Some(job) = self.jobs.get_mut(&job) {
            job.note_end(now);
        }
        self.unreferenced(released.unwrap_or_default())
    }

    /// Those of `digests` that no frame in work and no finished frame names.
    pub fn unreferenced(&self, digests: Vec<Digest>) -> Vec<Digest> {
        if digests.is_empty() {
            return digests;
        }
        let mut left: BTreeSet<Digest> = digests.into_iter().collect();
        self.each_artefact(|digest| {
            left.remove(&digest);
        });
        left.into_iter().collect()
    }

    /// Every artefact that is named: what is not, may go.
    fn each_artefact(&self, mut see: impl FnMut(Digest)) {
        self.jobs.values().for_each(|job| job.each_artefact(&mut see));
        self.annex.each_artefact(see);
    }

    /// Every artefact that is named: scenes, frames in work, finished frames, logs.
    pub fn references(&self) -> BTreeSet<Digest> {
        let mut all = BTreeSet::new();
        self.each_artefact(|digest| {
            all.insert(digest);
        });
        all
    }

    /// The scenes of all jobs: what each of them names belongs to the job, too.
    pub fn scenes(&self) -> BTreeSet<Digest> {
        self.jobs.values().map(|job| job.spec.bundle).collect()
    }

    /// Version and content, for a snapshot.
    pub fn encode(&self) -> Result<Vec<u8>, SnapshotError> {
        Ok(postcard::to_extend(&self.annex, encode(self)?)?)
    }

    /// What [`Self::encode`] wrote, now or in an earlier version.
    pub fn decode(bytes: &[u8]) -> Result<Self, SnapshotError> {
        let (version, content) = content(bytes)?;
        let (ledger, rest) = postcard::take_from_bytes(content)?;
        let annex = if version == 1 { Annex::default() } else { postcard::from_bytes(rest)? };
        Ok(Self { annex, ..ledger })
    }
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
