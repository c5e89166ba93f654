//! Shared stages of jobs, according to the log. A content and an engine build make an instance. An instance is begun only once. It
//! is done before a frame reads it, stops when no job waits for it, and is kept while a job needs it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::{Assignment, Control, Digest, JobId, JobSpec, Scope, Stage, TaskKey};
use femc_schedule::Fact;

use crate::audit::Violation;
use crate::chronicle::{Chronicle, Record};
use crate::faults::Fault;
use crate::tasks::{Instance, content, counted};

/// Instances according to the log.
#[derive(Debug, Default)]
pub(crate) struct Contents {
    live: BTreeMap<Instance, JobId>,
    last: u64,
    /// Instances that were done, each with the time since which it is missing.
    there: BTreeMap<Instance, Option<Duration>>,
    /// Digests that frames read, by finished instance.
    made: BTreeMap<JobId, Vec<Digest>>,
    /// Time since which no job waits for an instance.
    unwanted: BTreeMap<JobId, Duration>,
    /// Contents of the job that a person has just submitted or retried. Their shared stages are retried, too.
    again: BTreeSet<Digest>,
    /// Longest time for which an unwanted lease may last.
    pub(crate) patience: Patience,
}

/// Time until every host knows what the log says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Patience(Duration);

impl Default for Patience {
    fn default() -> Self {
        Self(Duration::from_millis(1_250))
    }
}

impl Patience {
    /// Longer than any message travels.
    const LONGEST: Duration = Duration::from_secs(25);

    /// Returns the longest time until every host knows what the log says.
    pub(crate) fn longest(self) -> Duration {
        self.0
    }

    /// Prepares for faults that may delay messages or the coordinator.
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
    /// Begins an empty log.
    pub(crate) fn anew(self) -> Self {
        Self { patience: self.patience, ..Self::default() }
    }

    /// Returns the content and the build of a job's instance.
    fn key_of(&self, job: JobId) -> Option<&Instance> {
        self.live.iter().find(|(_, other)| **other == job).map(|(instance, _)| instance)
    }

    /// Notes that an instance is missing from now on.
    fn leaves(&mut self, job: JobId, now: Duration) {
        self.made.remove(&job);
        if let Some(instance) = self.key_of(job).cloned()
            && let Some(since) = self.there.get_mut(&instance)
        {
            since.get_or_insert(now);
        }
    }
}

/// Returns the name of a record about an instance, for the statistics of the run.
pub(crate) fn fact_name(fact: &Fact) -> Option<&'static str> {
    match fact {
        Fact::Shared { .. } => Some("shared stages begun"),
        Fact::Restarted { job, .. } if job.is_shared() => Some("shared stages restarted"),
        Fact::Controlled { job, .. } if job.is_shared() => Some("shared stages retried"),
        Fact::Forgotten { job } if job.is_shared() => Some("shared stages expired"),
        _ => None,
    }
}

/// Checks whether a job has shared stages.
fn shares(spec: &JobSpec) -> bool {
    spec.graph.of(Scope::Content).next().is_some()
}

impl Chronicle {
    /// Returns the jobs of people that have an unfinished frame with this content and no quarantined task in that frame.
    fn needing(&self, key: Digest) -> impl Iterator<Item = &Record> {
        let is_left = move |record: &Record| {
            let mut left = record.frames.iter().filter(|&&frame| record.is_left(frame));
            left.any(|&frame| content(&record.spec, frame) == Some(key))
        };
        self.jobs.range(..JobId::shared(0)).map(|(_, record)| record).filter(move |record| is_left(record))
    }

    /// Checks whether an instance of the content, of any build, has a quarantined task and needs a retry.
    fn is_stuck(&self, key: Digest) -> bool {
        let of_key = self.contents.live.iter().filter(|((other, _), _)| *other == key);
        of_key.filter_map(|(_, job)| self.jobs.get(job)).any(Record::is_in_trouble)
    }

    /// Checks whether a job needs a retry to proceed: each unfinished frame has a quarantined task, of its own or in its shared
    /// stages.
    pub(crate) fn is_blocked(&self, record: &Record) -> bool {
        let is_starved = |frame| content(&record.spec, frame).is_some_and(|key| self.is_stuck(key));
        record.frames.iter().all(|&frame| !record.is_left(frame) || is_starved(frame))
    }

    /// Returns the owners who pay for a worker's time on a task of a job: the job's owner, or for shared stages the owners of all
    /// waiting jobs.
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

    /// Returns the payers of all instances.
    pub(crate) fn payers_of_shared(&self) -> BTreeMap<JobId, Vec<String>> {
        let live = self.contents.live.values();
        live.filter_map(|&job| Some((job, self.payers(job)?))).collect()
    }

    /// Returns the outputs of finished instances that frames read now or in future jobs.
    pub(crate) fn shared_inputs(&self) -> Vec<(JobId, u32, Digest)> {
        let made = self.contents.made.iter();
        made.flat_map(|(&job, made)| made.iter().map(move |&digest| (job, Stage::OF_JOB, digest))).collect()
    }

    /// Checks a record about an instance before it is applied.
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
            // A job needs its shared stages whether it runs or not.
            Fact::Forgotten { job } if job.is_shared() => {
                let (key, _) = *self.contents.key_of(*job)?;
                let is_done = self.jobs.get(job).is_some_and(Record::has_ended);
                let is_needed = || self.needing(key).any(|record| !record.is_over()) && !self.is_stuck(key);
                (is_done && is_needed()).then_some(Violation::ForgottenEarly { job: *job })
            }
            _ => None,
        }
    }

    /// Updates the instances after a record was applied.
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

    /// Checks a lease of a frame's task: the shared stages that it reads must be done by the worker's build.
    /// - `incarnation`: number of the coordinator that grants the lease.
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
            // An instance that disappeared a moment ago may have existed when the lease was granted.
            Some(gone) => gone.is_none_or(|since| now.saturating_sub(since) <= self.contents.patience.0),
        };
        (!is_there).then_some(Violation::Unserved { task: lease.task, epoch: lease.epoch })
    }

    /// Finds a lease of a worker whose shared stage has been unwanted for too long.
    /// - `joined`: time since which the worker can be informed.
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
