//! The durable half of the scheduler: what is asked for, what is done, what has failed.

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

/// All jobs. Changes by [`Ledger::apply`] alone: same facts, same ledger.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    pub(crate) incarnation: u32,
    pub(crate) now: Tick,
    last_job: u64,
    last_shared: u64,
    keys: BTreeMap<String, JobId>,
    /// Of people, and behind them what they share.
    pub(crate) jobs: BTreeMap<JobId, Job>,
    /// What jobs share, by content and build.
    shared: BTreeMap<Shared, JobId>,
    pub(crate) side: SideTables,
}

impl Ledger {
    /// The number that the next job gets.
    pub(crate) fn next_job(&self) -> JobId {
        JobId(self.last_job + 1)
    }

    /// The job that was submitted with this key.
    pub fn job_of_key(&self, key: &str) -> Option<JobId> {
        self.keys.get(key).copied()
    }

    /// The highest incarnation that a fact tells of.
    pub fn incarnation(&self) -> u32 {
        self.incarnation
    }

    /// Incarnations up to this one have been, also where the facts that told of them are lost: the next one is another.
    pub fn outlive(&mut self, incarnation: u32) {
        self.incarnation = self.incarnation.max(incarnation);
    }

    /// The time of the last fact.
    pub fn now(&self) -> Tick {
        self.now
    }

    /// Changes the ledger; returns the artifacts that it may name no longer: [`Self::unreferenced`] tells. A fact about what
    /// is not there changes nothing.
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
                // Any build may do it now, and one of them cannot.
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

    /// What jobs share cannot be done: their frames that need it are blocked; or it is tried again, and they are not. Returns what
    /// is named no longer.
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

    /// The number that what jobs share gets next.
    pub(crate) fn next_shared(&self) -> JobId {
        JobId::shared(self.last_shared + 1)
    }

    /// What was begun for a content, by each build of the engine.
    pub(crate) fn shared_by<'a>(&'a self, key: &Digest) -> impl Iterator<Item = (&'a str, JobId, &'a Job)> + use<'a> {
        let (first, key) = (Shared { key: *key, engine: String::new() }, *key);
        let all = self.shared.range(first..).take_while(move |(shared, _)| shared.key == key);
        all.filter_map(|(shared, id)| Some((&*shared.engine, *id, self.jobs.get(id)?)))
    }

    /// What was begun for a content by a build of the engine.
    pub(crate) fn shared_of<'a>(&'a self, key: &Digest, engine: &str) -> Option<(JobId, &'a Job)> {
        let (_, id, job) = self.shared_by(key).find(|(build, ..)| *build == engine)?;
        Some((id, job))
    }

    /// All that jobs share.
    pub(crate) fn all_shared(&self) -> impl Iterator<Item = (JobId, &Job)> {
        self.jobs.range(JobId::shared(0)..).map(|(&id, job)| (id, job))
    }

    /// The jobs of people.
    pub(crate) fn of_people(&self) -> impl Iterator<Item = (JobId, &Job)> {
        self.jobs.range(..JobId::shared(0)).map(|(&id, job)| (id, job))
    }

    /// The processes of which some presumed death counts.
    pub(crate) fn presumed_dead(&self) -> BTreeSet<u64> {
        self.jobs.values().flat_map(|job| job.units.values()).flat_map(Unit::presumed_dead).collect()
    }

    /// Those of `digests` that nothing names, each once. Walks all that is named: for many digests at a time.
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

    /// Every artifact that is named: what is not, may go.
    fn each_artifact(&self, mut see: impl FnMut(Digest)) {
        self.jobs.values().for_each(|job| job.each_artifact(&mut see));
        self.side.each_artifact(see);
    }

    /// Every artifact that is named: scenes, frames in work, finished frames, logs.
    pub fn references(&self) -> BTreeSet<Digest> {
        let mut all = BTreeSet::new();
        self.each_artifact(|digest| {
            all.insert(digest);
        });
        all
    }

    /// What the frames in work need that is made already, with job and frame.
    pub fn inputs(&self) -> impl Iterator<Item = (JobId, u32, Digest)> {
        let units =
            self.jobs.iter().flat_map(|(&id, job)| job.units.iter().map(move |(&number, unit)| (id, number, unit)));
        units.flat_map(|(id, number, unit)| unit.artifacts().map(move |digest| (id, number, digest)))
    }

    /// The scenes of all jobs: what each of them names belongs to the job, too.
    pub fn scenes(&self) -> BTreeSet<Digest> {
        self.jobs.values().map(|job| job.spec.bundle).collect()
    }
}
