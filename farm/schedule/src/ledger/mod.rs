//! The durable half of the scheduler: the jobs, their finished tasks, and their failures.

mod hints;
mod job;
pub(crate) mod shape;
mod side_tables;
mod snapshot;
mod trouble;
pub(crate) mod unit;

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{Control, Digest, JobId, Tick};
use serde::{Deserialize, Serialize};

use crate::Fact;
pub(crate) use job::{Hold, Job, Shared};
pub(crate) use shape::{Place, Shape};
pub(crate) use side_tables::SideTables;
pub use snapshot::SnapshotError;
pub(crate) use unit::Unit;

/// All jobs. Only [`Ledger::apply`] changes it: the same facts give the same ledger.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    pub(crate) incarnation: u32,
    pub(crate) now: Tick,
    last_job: u64,
    last_shared: u64,
    keys: BTreeMap<String, JobId>,
    /// Submitted jobs, followed by shared jobs.
    pub(crate) jobs: BTreeMap<JobId, Job>,
    /// Shared jobs by content and build.
    shared: BTreeMap<Shared, JobId>,
    pub(crate) side: SideTables,
}

impl Ledger {
    /// Returns the number of the next job.
    pub(crate) fn next_job(&self) -> JobId {
        JobId(self.last_job + 1)
    }

    /// Returns the job that was submitted with this key.
    pub fn job_of_key(&self, key: &str) -> Option<JobId> {
        self.keys.get(key).copied()
    }

    /// Returns the highest incarnation in the facts so far.
    pub fn incarnation(&self) -> u32 {
        self.incarnation
    }

    /// Raises the incarnation: incarnations up to this one have existed, even if their facts are lost, so the next one is greater.
    pub fn outlive(&mut self, incarnation: u32) {
        self.incarnation = self.incarnation.max(incarnation);
    }

    /// Returns the time of the last fact.
    pub fn now(&self) -> Tick {
        self.now
    }

    /// Applies a fact. Returns artifacts that have lost a reference; [`Self::unreferenced`] tells which of them have no other. A
    /// fact about an unknown object changes nothing.
    pub fn apply(&mut self, fact: &Fact, now: Tick) -> Vec<Digest> {
        self.now = self.now.max(now);
        let (job, released) = match fact {
            Fact::Opened { incarnation } => {
                self.incarnation = self.incarnation.max(*incarnation);
                return Vec::new();
            }
            Fact::Submitted { job, key, spec, cut, date, announces } => {
                self.last_job = self.last_job.max(job.0);
                if let Some(key) = key {
                    self.keys.insert(key.clone(), *job);
                }
                let known = Job::new(spec.clone(), None, *cut, now).submitted_at(*date).announcing(*announces);
                self.jobs.insert(*job, known);
                return Vec::new();
            }
            Fact::Shared { job, key, engine, spec, cut } => {
                self.last_shared = self.last_shared.max(job.0 - JobId::shared(0).0);
                let shared = Shared { key: *key, engine: engine.clone() };
                self.shared.insert(shared.clone(), *job);
                self.jobs.insert(*job, Job::new(spec.clone(), Some(shared), *cut, now));
                return Vec::new();
            }
            Fact::Drained { instance, drain } => {
                self.side.drain(*instance, *drain);
                return Vec::new();
            }
            Fact::Logged(record) => {
                let is_known = self.jobs.contains_key(&record.task.job);
                return if is_known { self.side.log(record) } else { Vec::new() };
            }
            Fact::Built { job, frame, engine } => {
                if self.jobs.get(job).is_some_and(|known| known.is_open(*frame)) {
                    self.side.built(*job, *frame, engine);
                }
                return Vec::new();
            }
            Fact::Used { owners } => {
                let jobs = &self.jobs;
                self.side.note_used(owners, || jobs.values().map(|job| job.spec.owner.as_str()).collect());
                return Vec::new();
            }
            Fact::Metered { usage } => {
                self.side.meter(usage);
                return Vec::new();
            }
            Fact::Announced { job, ended } => {
                if let Some(job) = self.jobs.get_mut(job).filter(|job| job.ended == Some(*ended)) {
                    job.is_unannounced = false;
                }
                return Vec::new();
            }
            Fact::Lives { instance } => {
                self.jobs.values_mut().for_each(|job| job.lives(*instance));
                return Vec::new();
            }
            Fact::Died { task, end, casualty } => {
                (task.job, self.jobs.get_mut(&task.job).map(|job| job.died(task, *end, casualty, now)))
            }
            Fact::Forgotten { job } => {
                self.jobs.remove(job);
                self.keys.retain(|_, other| other != job);
                self.shared.retain(|_, other| other != job);
                self.side.forget(*job);
                return Vec::new();
            }
            Fact::Done { task, end, epoch, leased, result } => {
                let build = || self.side.build_of(task.job, task.stage.frame);
                let released = self.jobs.get_mut(&task.job).map(|job| {
                    let engine = if job.spec.graph.has_hints() { build() } else { None };
                    let mut released = engine.map(|it| job.note_hints(task, *end, it, result)).unwrap_or_default();
                    released.extend(job.done(task, *end, (*epoch, *leased), result, now));
                    released
                });
                if self.jobs.get(&task.job).is_some_and(|job| job.finished.contains_key(&task.stage.frame)) {
                    self.side.unbuilt(task.job, task.stage.frame);
                }
                (task.job, released)
            }
            Fact::Failed { task, until, failure } => {
                (task.job, self.jobs.get_mut(&task.job).map(|job| job.failed(task, *until, failure, now)))
            }
            Fact::Lost { task } => (task.job, self.jobs.get_mut(&task.job).map(|job| job.lost(task))),
            Fact::Restarted { job, frame } => {
                self.side.unbuilt(*job, *frame);
                let released = self.jobs.get_mut(job).map(|job| job.restarted(*frame));
                // Any build may render the frame now, and the shared job of one build is stuck.
                let key = self.jobs.get(job).and_then(|job| job.content(*frame));
                if let Some(key) = key.filter(|key| self.shared_by(key).any(|(.., shared)| shared.is_stuck()))
                    && let Some(job) = self.jobs.get_mut(job)
                {
                    job.block_for_shared(&key, |other| other == *frame, now);
                }
                (*job, released)
            }
            Fact::Doomed { job, failure } => (*job, self.jobs.get_mut(job).map(|j| j.doomed(failure))),
            Fact::Controlled { job, control } => (*job, self.jobs.get_mut(job).map(|j| j.controlled(control))),
        };
        if let Some(job) = self.jobs.get_mut(&job) {
            job.note_end(now);
        }
        if job.is_shared() {
            let is_retry = matches!(fact, Fact::Controlled { control: Control::Retry, .. });
            let of_others = self.spread_shared_state(job, is_retry, now);
            return released.into_iter().flatten().chain(of_others).collect();
        }
        released.unwrap_or_default()
    }

    /// Blocks the frames that need a shared job if it is stuck, or unblocks them when it is retried. Returns artifacts that have
    /// lost a reference.
    fn spread_shared_state(&mut self, id: JobId, is_retry: bool, now: Tick) -> Vec<Digest> {
        let mut released = Vec::new();
        let Some(job) = self.jobs.get(&id) else { return released };
        let Some(Shared { key, engine }) = job.shared.clone() else { return released };
        let (is_stuck, side) = (job.is_stuck(), &self.side);
        for (&other, job) in self.jobs.range_mut(..JobId::shared(0)).filter(|_| is_stuck || is_retry) {
            if is_stuck {
                let is_of_build = |frame| side.build_of(other, frame).is_none_or(|build| build == engine);
                job.block_for_shared(&key, is_of_build, now);
            } else {
                released.extend(job.unblock_for_shared(&key));
            }
        }
        released
    }

    /// Returns the number of the next shared job.
    pub(crate) fn next_shared(&self) -> JobId {
        JobId::shared(self.last_shared + 1)
    }

    /// Returns the shared jobs of a content, with their builds of the engine.
    pub(crate) fn shared_by<'a>(&'a self, key: &Digest) -> impl Iterator<Item = (&'a str, JobId, &'a Job)> + use<'a> {
        let (first, key) = (Shared { key: *key, engine: String::new() }, *key);
        let all = self.shared.range(first..).take_while(move |(shared, _)| shared.key == key);
        all.filter_map(|(shared, id)| Some((&*shared.engine, *id, self.jobs.get(id)?)))
    }

    /// Returns the shared job of a content and a build of the engine.
    pub(crate) fn shared_of<'a>(&'a self, key: &Digest, engine: &str) -> Option<(JobId, &'a Job)> {
        let (_, id, job) = self.shared_by(key).find(|(build, ..)| *build == engine)?;
        Some((id, job))
    }

    /// Returns all shared jobs.
    pub(crate) fn all_shared(&self) -> impl Iterator<Item = (JobId, &Job)> {
        self.jobs.range(JobId::shared(0)..).map(|(&id, job)| (id, job))
    }

    /// Returns the submitted jobs, without shared jobs.
    pub(crate) fn of_people(&self) -> impl Iterator<Item = (JobId, &Job)> {
        self.jobs.range(..JobId::shared(0)).map(|(&id, job)| (id, job))
    }

    /// Returns the processes with a presumed death that counts.
    pub(crate) fn presumed_dead(&self) -> BTreeSet<u64> {
        self.jobs.values().flat_map(|job| job.units.values()).flat_map(Unit::presumed_dead).collect()
    }

    /// Returns those of `digests` that are not referenced, without duplicates. Visits all references, so call it for many digests
    /// at a time.
    pub fn unreferenced(&self, digests: Vec<Digest>) -> Vec<Digest> {
        if digests.is_empty() {
            return digests;
        }
        let mut left: BTreeSet<Digest> = digests.into_iter().collect();
        self.each_artifact(|digest| {
            left.remove(&digest);
        });
        left.into_iter().collect()
    }

    /// Visits every referenced artifact. All others may be removed.
    fn each_artifact(&self, mut see: impl FnMut(Digest)) {
        self.jobs.values().for_each(|job| job.each_artifact(&mut see));
        self.side.each_artifact(see);
    }

    /// Returns every referenced artifact: scenes, outputs of frames in progress, finished frames, logs.
    pub fn references(&self) -> BTreeSet<Digest> {
        let mut all = BTreeSet::new();
        self.each_artifact(|digest| {
            all.insert(digest);
        });
        all
    }

    /// Returns the existing artifacts that frames in progress need, with job and frame.
    pub fn inputs(&self) -> impl Iterator<Item = (JobId, u32, Digest)> {
        let units =
            self.jobs.iter().flat_map(|(&id, job)| job.units.iter().map(move |(&number, unit)| (id, number, unit)));
        units.flat_map(|(id, number, unit)| unit.artifacts().map(move |digest| (id, number, digest)))
    }

    /// Returns the scenes of all jobs. The artifacts that a scene lists belong to the job, too.
    pub fn scenes(&self) -> BTreeSet<Digest> {
        self.jobs.values().map(|job| job.spec.bundle).collect()
    }
}
