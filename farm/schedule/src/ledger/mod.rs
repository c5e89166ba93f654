//! The durable half of the scheduler: the jobs, their finished tasks, and their failures.

pub(crate) mod graph_view;
mod hints;
mod job;
pub(crate) mod progress;
mod side_tables;
mod snapshot;
mod task_failures;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use femc_model::{Control, Digest, JobId, Tick};
use serde::{Deserialize, Serialize};

use crate::Fact;
pub(crate) use graph_view::{GraphView, StageRound};
pub(crate) use job::{Hold, Job, SharedKey};
pub(crate) use progress::Progress;
pub(crate) use side_tables::SideTables;
pub use snapshot::SnapshotError;

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
    shared: BTreeMap<SharedKey, JobId>,
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
    pub fn raise_incarnation(&mut self, incarnation: u32) {
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
        let fact = &*self.updated(fact);
        let (job, released) = match fact {
            Fact::CoordinatorStarted { incarnation } => {
                self.incarnation = self.incarnation.max(*incarnation);
                return Vec::new();
            }
            Fact::Submitted { job, key, spec, chunk_size: cut, date, announces } => {
                self.last_job = self.last_job.max(job.0);
                if let Some(key) = key {
                    self.keys.insert(key.clone(), *job);
                }
                let known = Job::new(spec.clone(), None, *cut, now).with_date(*date).with_announcements(*announces);
                self.jobs.insert(*job, known);
                return Vec::new();
            }
            Fact::SharedJobBegun { job, key, engine, spec, chunk_size: cut } => {
                self.last_shared = self.last_shared.max(job.0 - JobId::shared(0).0);
                let shared = SharedKey { key: *key, engine: engine.clone() };
                self.shared.insert(shared.clone(), *job);
                self.jobs.insert(*job, Job::new(spec.clone(), Some(shared), *cut, now));
                return Vec::new();
            }
            Fact::Drained { instance, drain } => {
                self.side.set_drain(*instance, *drain);
                return Vec::new();
            }
            Fact::Logged(record) => {
                let is_known = self.jobs.contains_key(&record.task.job);
                return if is_known { self.side.add_log(record) } else { Vec::new() };
            }
            Fact::BuildAssigned { job, frame, engine } => {
                if self.jobs.get(job).is_some_and(|known| known.is_open(*frame)) {
                    self.side.set_build(*job, *frame, engine);
                }
                return Vec::new();
            }
            Fact::TimeCharged { owners } => {
                let jobs = &self.jobs;
                self.side.set_used_times(owners, || jobs.values().map(|job| job.spec.owner.as_str()).collect());
                return Vec::new();
            }
            Fact::Metered { usage } => {
                self.side.set_usage(usage);
                return Vec::new();
            }
            Fact::Announced { job, ended } => {
                if let Some(job) = self.jobs.get_mut(job).filter(|job| job.ended == Some(*ended)) {
                    job.is_unannounced = false;
                }
                return Vec::new();
            }
            Fact::WorkerReturned { instance } => {
                self.jobs.values_mut().for_each(|job| job.withdraw_deaths(*instance));
                return Vec::new();
            }
            Fact::WorkerDied { task, end, death: casualty } => {
                (task.job, self.jobs.get_mut(&task.job).map(|job| job.apply_death(task, *end, casualty, now)))
            }
            Fact::JobRemoved { job } => {
                self.jobs.remove(job);
                self.keys.retain(|_, other| other != job);
                self.shared.retain(|_, other| other != job);
                self.side.remove_job(*job);
                return Vec::new();
            }
            Fact::Done { task, end, epoch, leased, result } => {
                let build = || self.side.build_of(task.job, task.stage.frame);
                let released = self.jobs.get_mut(&task.job).map(|job| {
                    let engine = if job.spec.graph.has_hints() { build() } else { None };
                    let mut released = engine.map(|it| job.add_hints(task, *end, it, result)).unwrap_or_default();
                    released.extend(job.apply_result(task, *end, (*epoch, *leased), result, now));
                    released
                });
                if self.jobs.get(&task.job).is_some_and(|job| job.finished.contains_key(&task.stage.frame)) {
                    self.side.remove_build(task.job, task.stage.frame);
                }
                (task.job, released)
            }
            Fact::Failed { task, until, failure } => {
                (task.job, self.jobs.get_mut(&task.job).map(|job| job.apply_failure(task, *until, failure, now)))
            }
            Fact::OutputsLost { task } => (task.job, self.jobs.get_mut(&task.job).map(|job| job.apply_loss(task))),
            Fact::Restarted { job, frame } => {
                self.side.remove_build(*job, *frame);
                let released = self.jobs.get_mut(job).map(|job| job.restart_frame(*frame));
                // Any build may render the frame now, and the shared job of one build is stuck.
                let key = self.jobs.get(job).and_then(|job| job.content_key(*frame));
                if let Some(key) = key.filter(|key| self.shared_jobs_of(key).any(|(.., shared)| shared.is_stuck()))
                    && let Some(job) = self.jobs.get_mut(job)
                {
                    job.block_for_shared(&key, |other| other == *frame, now);
                }
                (*job, released)
            }
            Fact::JobFailed { job, failure } => (*job, self.jobs.get_mut(job).map(|j| j.fail(failure))),
            Fact::Controlled { job, control } => (*job, self.jobs.get_mut(job).map(|j| j.apply_control(control))),
        };
        if let Some(job) = self.jobs.get_mut(&job) {
            job.update_ended(now);
        }
        if job.is_shared() {
            let is_retry = matches!(fact, Fact::Controlled { control: Control::Retry, .. });
            let of_others = self.spread_shared_state(job, is_retry, now);
            return released.into_iter().flatten().chain(of_others).collect();
        }
        released.unwrap_or_default()
    }

    /// Returns the fact with the present kind of its task: facts of earlier versions name the kind that did the work then.
    fn updated<'a>(&self, fact: &'a Fact) -> Cow<'a, Fact> {
        let present = fact.task().and_then(|task| {
            let template = self.jobs.get(&task.job)?.spec.graph.stage(task.stage.number)?;
            (template.kind.earlier() == Some(task.stage.kind)).then_some(template.kind)
        });
        let Some(kind) = present else { return Cow::Borrowed(fact) };
        let mut fact = fact.clone();
        if let Some(task) = fact.task_mut() {
            task.stage.kind = kind;
        }
        Cow::Owned(fact)
    }

    /// Blocks the frames that need a shared job if it is stuck, or unblocks them when it is retried. Returns artifacts that have
    /// lost a reference.
    fn spread_shared_state(&mut self, id: JobId, is_retry: bool, now: Tick) -> Vec<Digest> {
        let mut released = Vec::new();
        let Some(job) = self.jobs.get(&id) else { return released };
        let Some(SharedKey { key, engine }) = job.shared.clone() else { return released };
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
    pub(crate) fn shared_jobs_of<'a>(
        &'a self,
        key: &Digest,
    ) -> impl Iterator<Item = (&'a str, JobId, &'a Job)> + use<'a> {
        let (first, key) = (SharedKey { key: *key, engine: String::new() }, *key);
        let all = self.shared.range(first..).take_while(move |(shared, _)| shared.key == key);
        all.filter_map(|(shared, id)| Some((&*shared.engine, *id, self.jobs.get(id)?)))
    }

    /// Returns the shared job of a content and a build of the engine.
    pub(crate) fn shared_job_of<'a>(&'a self, key: &Digest, engine: &str) -> Option<(JobId, &'a Job)> {
        let (_, id, job) = self.shared_jobs_of(key).find(|(build, ..)| *build == engine)?;
        Some((id, job))
    }

    /// Returns all shared jobs.
    pub(crate) fn shared_jobs(&self) -> impl Iterator<Item = (JobId, &Job)> {
        self.jobs.range(JobId::shared(0)..).map(|(&id, job)| (id, job))
    }

    /// Returns the submitted jobs, without shared jobs.
    pub(crate) fn submitted_jobs(&self) -> impl Iterator<Item = (JobId, &Job)> {
        self.jobs.range(..JobId::shared(0)).map(|(&id, job)| (id, job))
    }

    /// Returns the processes with a presumed death that counts.
    pub(crate) fn presumed_dead(&self) -> BTreeSet<u64> {
        self.jobs.values().flat_map(|job| job.unfinished.values()).flat_map(Progress::presumed_dead).collect()
    }

    /// Returns those of `digests` that are not referenced, without duplicates. Visits all references, so call it for many digests
    /// at a time.
    pub fn unreferenced(&self, digests: Vec<Digest>) -> Vec<Digest> {
        if digests.is_empty() {
            return digests;
        }
        let mut left: BTreeSet<Digest> = digests.into_iter().collect();
        self.for_each_artifact(|digest| {
            left.remove(&digest);
        });
        left.into_iter().collect()
    }

    /// Visits every referenced artifact. All others may be removed.
    fn for_each_artifact(&self, mut visit: impl FnMut(Digest)) {
        self.jobs.values().for_each(|job| job.for_each_artifact(&mut visit));
        self.side.for_each_artifact(visit);
    }

    /// Returns every referenced artifact: scenes, outputs of frames in progress, finished frames, logs.
    pub fn references(&self) -> BTreeSet<Digest> {
        let mut all = BTreeSet::new();
        self.for_each_artifact(|digest| {
            all.insert(digest);
        });
        all
    }

    /// Returns the existing artifacts that frames in progress need, with job and frame.
    pub fn inputs(&self) -> impl Iterator<Item = (JobId, u32, Digest)> {
        let units = self
            .jobs
            .iter()
            .flat_map(|(&id, job)| job.unfinished.iter().map(move |(&number, progress)| (id, number, progress)));
        units.flat_map(|(id, number, progress)| progress.artifacts().map(move |digest| (id, number, digest)))
    }

    /// Returns the scenes of all jobs. The artifacts that a scene lists belong to the job, too.
    pub fn scenes(&self) -> BTreeSet<Digest> {
        self.jobs.values().map(|job| job.spec.bundle).collect()
    }
}
