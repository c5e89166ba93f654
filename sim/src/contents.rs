//! What jobs share, by the log: a content and a build of the engine make an instance, which is begun once, is there when a frame
//! reads it, stops when nobody waits for it, and stays as long as somebody does.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::{Assignment, Control, Digest, JobId, JobSpec, Scope, Stage, TaskKey};
use femc_schedule::Fact;

use crate::audit::Violation;
use crate::chronicle::{Chronicle, Record};
use crate::faults::Fault;
use crate::tasks::{Instance, content, counted};

/// What the log says of instances.
#[derive(Debug, Default)]
pub(crate) struct Contents {
    live: BTreeMap<Instance, JobId>,
    last: u64,
    /// Instances that were done, and since when one is not there any more.
    there: BTreeMap<Instance, Option<Duration>>,
    /// What frames read of the instances that are done.
    made: BTreeMap<JobId, Vec<Digest>>,
    /// Since when nobody waits for an instance.
    unwanted: BTreeMap<JobId, Duration>,
    /// What a person has just asked for once more: what it shares is tried once more, too.
    again: BTreeSet<Digest>,
    /// So long a lease may last that nobody wants.
    pub(crate) patience: Patience,
}

/// How soon what the log says is known everywhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Patience(Duration);

impl Default for Patience {
    fn default() -> Self {
        Self(Duration::from_millis(1_250))
    }
}

impl Patience {
    /// Longer than anything is on its way.
    const LONGEST: Duration = Duration::from_secs(25);

    /// Longest time until what the log says is known everywhere.
    pub(crate) fn longest(self) -> Duration {
        self.0
    }

    /// What may hold messages up from now on, or the coordinator.
    pub(crate) fn expect(&mut self, faults: impl Iterator<Item = Fault>) {
        for fault in faults {
            match fault {
                Fault::WorkerDies(..)
                | Fault::AloneAndSick(..)
                | Fault::ArtifactHarmed(_)
                | Fault::SceneHarmed(_)
                | Fault::StoreFull(_)
                | Fault::StoreAway(_)
                | Fault::StoreSlow(..)
                | Fault::UploadTorn(..)
                | Fault::ReadsAnother(_) => {}
                Fault::CoordinatorDies(_)
                | Fault::DiesBeforeWrite(_)
                | Fault::TornWrite(_)
                | Fault::DiesAfterWrite(_)
                | Fault::LeadChanges
                | Fault::WorkerCut(..)
                | Fault::WorkerMute(..)
                | Fault::CoordinatorCut(_)
                | Fault::WorkerFreezes(..)
                | Fault::CoordinatorFreezes(_)
                | Fault::Slow(..)
                | Fault::LogFull(_)
                | Fault::ClockJumps(..)
                | Fault::ClockDrifts(..)
                | Fault::LogLost => self.0 = Self::LONGEST,
            }
        }
    }
}

impl Contents {
    /// A log begins that knows of nothing.
    pub(crate) fn anew(self) -> Self {
        Self { patience: self.patience, ..Self::default() }
    }

    /// The content that an instance is of.
    fn key_of(&self, job: JobId) -> Option<&Instance> {
        self.live.iter().find(|(_, other)| **other == job).map(|(instance, _)| instance)
    }

    /// An instance is not there any more.
    fn leaves(&mut self, job: JobId, now: Duration) {
        self.made.remove(&job);
        if let Some(instance) = self.key_of(job).cloned()
            && let Some(since) = self.there.get_mut(&instance)
        {
            since.get_or_insert(now);
        }
    }
}

/// What a record says of an instance, for the account of what came about.
pub(crate) fn fact_name(fact: &Fact) -> Option<&'static str> {
    match fact {
        Fact::Shared { .. } => Some("shared stages begun"),
        Fact::Restarted { job, .. } if job.is_shared() => Some("shared stages begun anew"),
        Fact::Controlled { job, .. } if job.is_shared() => Some("shared stages tried again"),
        Fact::Forgotten { job } if job.is_shared() => Some("shared stages forgotten"),
        _ => None,
    }
}

/// Whether a job's frames share something.
fn shares(spec: &JobSpec) -> bool {
    spec.graph.of(Scope::Content).next().is_some()
}

impl Chronicle {
    /// The jobs of people whose frames with this content are to be finished and can be.
    fn needing(&self, key: Digest) -> impl Iterator<Item = &Record> {
        let is_left = move |record: &Record| {
            let mut left = record.frames.iter().filter(|&&frame| record.is_left(frame));
            left.any(|&frame| content(&record.spec, frame) == Some(key))
        };
        self.jobs.range(..JobId::shared(0)).map(|(_, record)| record).filter(move |record| is_left(record))
    }

    /// Whether what the frames of a content share, some build's, cannot be done without a retry.
    fn is_stuck(&self, key: Digest) -> bool {
        let of_key = self.contents.live.iter().filter(|((other, _), _)| *other == key);
        of_key.filter_map(|(_, job)| self.jobs.get(job)).any(Record::is_in_trouble)
    }

    /// Whether nothing of a job can move without a retry: of each frame that is not finished a task is put aside, of itself or of
    /// what it shares.
    pub(crate) fn is_blocked(&self, record: &Record) -> bool {
        let is_starved = |frame| content(&record.spec, frame).is_some_and(|key| self.is_stuck(key));
        record.frames.iter().all(|&frame| !record.is_left(frame) || is_starved(frame))
    }

    /// Whose the time is that a worker spends on a task of a job: its owner's, or of those who wait for what is shared.
    pub(crate) fn payers(&self, job: JobId) -> Option<Vec<String>> {
        let record = self.jobs.get(&job)?;
        let key = self.contents.key_of(job).map(|(key, _)| *key);
        let waiting = key.into_iter().flat_map(|key| self.needing(key)).filter(|record| record.may_run());
        let mut owners: Vec<String> = waiting.map(|record| record.spec.owner.clone()).collect();
        if owners.is_empty() {
            owners.push(record.spec.owner.clone());
        }
        owners.sort_unstable();
        owners.dedup();
        Some(owners)
    }

    /// Those of all instances.
    pub(crate) fn payers_of_shared(&self) -> BTreeMap<JobId, Vec<String>> {
        let live = self.contents.live.values();
        live.filter_map(|&job| Some((job, self.payers(job)?))).collect()
    }

    /// What frames read of the instances that are done, or jobs to come.
    pub(crate) fn shared_inputs(&self) -> Vec<(JobId, u32, Digest)> {
        let made = self.contents.made.iter();
        made.flat_map(|(&job, made)| made.iter().map(move |&digest| (job, Stage::OF_JOB, digest))).collect()
    }

    /// What is wrong with a record that is being written, before it is taken in.
    pub(crate) fn judge_shared(&mut self, fact: &Fact) -> Option<Violation> {
        match fact {
            Fact::Shared { job, key, engine, .. } => {
                let is_new = job.is_shared() && job.0 > self.contents.last;
                let before = self.contents.live.get(&(*key, engine.clone()));
                let again = before.map(|&before| Violation::BegunAgain { jobs: [before, *job] });
                again.or((!is_new).then_some(Violation::Renumbered { job: *job }))
            }
            Fact::Controlled { job, control } if job.is_shared() => {
                let key = self.contents.key_of(*job).map(|(key, _)| *key);
                let is_asked_for = key.is_some_and(|key| self.contents.again.contains(&key));
                (!is_asked_for).then_some(Violation::Unasked { job: *job, control: control.clone() })
            }
            // A job needs what its frames are made of, whether it runs or not.
            Fact::Forgotten { job } if job.is_shared() => {
                let (key, _) = *self.contents.key_of(*job)?;
                let is_done = self.jobs.get(job).is_some_and(Record::has_ended);
                let is_needed = || self.needing(key).any(|record| !record.is_over()) && !self.is_stuck(key);
                (is_done && is_needed()).then_some(Violation::ForgottenEarly { job: *job })
            }
            _ => None,
        }
    }

    /// Takes in what a record that was taken in says of instances.
    pub(crate) fn note_shared(&mut self, fact: &Fact, now: Duration) {
        let contents = &mut self.contents;
        match fact {
            Fact::Shared { job, key, engine, .. } => {
                contents.live.insert((*key, engine.clone()), *job);
                contents.last = contents.last.max(job.0);
            }
            Fact::Restarted { job, .. } if job.is_shared() => contents.leaves(*job, now),
            Fact::Forgotten { job } if job.is_shared() => {
                contents.leaves(*job, now);
                contents.live.retain(|_, other| other != job);
            }
            _ => {}
        }
        let asked = match fact {
            Fact::Submitted { job, .. }
            | Fact::Controlled { job, control: Control::Retry | Control::RetryFrames(_) } => Some(job),
            _ => None,
        };
        if asked.is_none_or(|job| !job.is_shared()) {
            let spec = asked.and_then(|job| self.jobs.get(job)).map(|record| &record.spec);
            contents.again = spec.iter().flat_map(|spec| &spec.contents).map(|(_, key)| *key).collect();
        }
        if let Some(result) = counted(fact).filter(|result| result.task.job.is_shared())
            && let Some(record) = self.jobs.get(&result.task.job).filter(|_| result.task.job.is_shared())
            && result.finishes(&record.spec)
            && let Some(instance) = contents.key_of(result.task.job).cloned()
        {
            let made = result.result.outputs.iter().map(|output| output.artifact.digest);
            contents.made.insert(result.task.job, made.collect());
            contents.there.insert(instance, None);
        }
        let live: Vec<(JobId, Digest)> = self.contents.live.iter().map(|((key, _), job)| (*job, *key)).collect();
        let is_wanted = |key| self.needing(key).any(Record::may_run);
        let idle: BTreeSet<JobId> = live.into_iter().filter(|(_, key)| !is_wanted(*key)).map(|(job, _)| job).collect();
        self.contents.unwanted.retain(|job, _| idle.contains(job));
        for job in idle {
            self.contents.unwanted.entry(job).or_insert(now);
        }
    }

    /// What is wrong with a lease of a frame that a worker of this build gets: what it reads of its content is not there.
    /// - `incarnation`: of the coordinator that gives it out.
    pub(crate) fn may_read(
        &self,
        engine: &str,
        lease: &Assignment,
        incarnation: u32,
        now: Duration,
    ) -> Option<Violation> {
        let TaskKey { job, stage, .. } = lease.task;
        let record = self.jobs.get(&job).filter(|_| incarnation == self.incarnation())?;
        if job.is_shared() || !shares(&record.spec) || !record.spec.graph.reads_content(stage.number) {
            return None;
        }
        let instance = (content(&record.spec, stage.frame)?, engine.to_owned());
        let is_there = match self.contents.there.get(&instance) {
            None => false,
            // What was there a moment ago may have been so when the lease began.
            Some(gone) => gone.is_none_or(|since| now.saturating_sub(since) <= self.contents.patience.0),
        };
        (!is_there).then_some(Violation::Unserved { task: lease.task, epoch: lease.epoch })
    }

    /// A lease, of these that a worker holds, of what is shared and nobody has waited for, for too long.
    /// - `joined`: since when the worker can be told.
    pub(crate) fn unwanted<'a>(
        &self,
        held: impl Iterator<Item = &'a TaskKey>,
        joined: Duration,
        now: Duration,
    ) -> Option<Violation> {
        let is_unwanted = |task: &&TaskKey| {
            let since = self.contents.unwanted.get(&task.job).map(|&since| since.max(joined));
            since.is_some_and(|since| now.saturating_sub(since) > self.contents.patience.0)
        };
        held.into_iter().find(is_unwanted).map(|&task| Violation::Unwanted { task })
    }
}
