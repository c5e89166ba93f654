//! Shared stages of jobs, according to the log. A content and an engine build make an instance. An instance is begun only once. It
//! is done before a frame reads it, stops when no job waits for it, and is kept while a job needs it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::{Assignment, Control, Digest, JobId, JobSpec, Scope, Stage, TaskKey};
use femc_schedule::Fact;

use crate::audit::Violation;
use crate::faults::Fault;
use crate::history::{History, JobHistory};
use crate::tasks::{InstanceKey, counted_result, frame_content};

/// Instances according to the log.
#[derive(Debug, Default)]
pub(crate) struct SharedStages {
    instances: BTreeMap<InstanceKey, JobId>,
    last: u64,
    /// Instances that were done, each with the time since which it is missing.
    finished: BTreeMap<InstanceKey, Option<Duration>>,
    /// Digests that frames read, by finished instance.
    outputs: BTreeMap<JobId, Vec<Digest>>,
    /// Time since which no job waits for an instance.
    unwanted_since: BTreeMap<JobId, Duration>,
    /// Contents of the job that a person has just submitted or retried. Their shared stages are retried, too.
    retried: BTreeSet<Digest>,
    /// Longest time for which an unwanted lease may last.
    pub(crate) propagation_delay: PropagationDelay,
}

/// Time until every host knows what the log says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct PropagationDelay(Duration);

impl Default for PropagationDelay {
    fn default() -> Self {
        Self(Duration::from_millis(1_250))
    }
}

impl PropagationDelay {
    /// Longer than any message travels.
    const MAX: Duration = Duration::from_secs(25);

    /// Returns the longest time until every host knows what the log says.
    pub(crate) fn get(self) -> Duration {
        self.0
    }

    /// Prepares for faults that may delay messages or the coordinator.
    pub(crate) fn allow_for(&mut self, faults: impl Iterator<Item = Fault>) {
        for fault in faults {
            match fault {
                Fault::WorkerDies(..)
                | Fault::LoneWorkerFails(..)
                | Fault::ArtifactDamaged(_)
                | Fault::SceneDamaged(_)
                | Fault::StoreFull(_)
                | Fault::StoreUnavailable(_)
                | Fault::StoreSlow(..)
                | Fault::UploadTorn(..)
                | Fault::WrongRead(_) => {}
                Fault::CoordinatorDies(_)
                | Fault::DiesBeforeWrite(_)
                | Fault::TornWrite(_)
                | Fault::DiesAfterWrite(_)
                | Fault::LeaderChanges
                | Fault::WorkerPartitioned(..)
                | Fault::WorkerMute(..)
                | Fault::CoordinatorPartitioned(_)
                | Fault::WorkerFreezes(..)
                | Fault::CoordinatorFreezes(_)
                | Fault::SlowNetwork(..)
                | Fault::LogFull(_)
                | Fault::ClockJumps(..)
                | Fault::ClockDrifts(..)
                | Fault::LogLost => self.0 = Self::MAX,
            }
        }
    }
}

impl SharedStages {
    /// Begins an empty log.
    pub(crate) fn reset(self) -> Self {
        Self { propagation_delay: self.propagation_delay, ..Self::default() }
    }

    /// Returns the content and the build of a job's instance.
    fn instance_key(&self, job: JobId) -> Option<&InstanceKey> {
        self.instances.iter().find(|(_, other)| **other == job).map(|(instance, _)| instance)
    }

    /// Notes that an instance is missing from now on.
    fn mark_missing(&mut self, job: JobId, now: Duration) {
        self.outputs.remove(&job);
        if let Some(instance) = self.instance_key(job).cloned()
            && let Some(since) = self.finished.get_mut(&instance)
        {
            since.get_or_insert(now);
        }
    }
}

/// Returns the name of a record about an instance, for the statistics of the run.
pub(crate) fn shared_fact_name(fact: &Fact) -> Option<&'static str> {
    match fact {
        Fact::SharedJobBegun { .. } => Some("shared stages begun"),
        Fact::Restarted { job, .. } if job.is_shared() => Some("shared stages restarted"),
        Fact::Controlled { job, .. } if job.is_shared() => Some("shared stages retried"),
        Fact::JobRemoved { job } if job.is_shared() => Some("shared stages expired"),
        _ => None,
    }
}

/// Checks whether a job has shared stages.
fn has_shared_stages(spec: &JobSpec) -> bool {
    spec.graph.stages_of(Scope::Content).next().is_some()
}

impl History {
    /// Returns the jobs of people that have an unfinished frame with this content and no quarantined task in that frame.
    fn jobs_needing(&self, key: Digest) -> impl Iterator<Item = &JobHistory> {
        let is_left = move |record: &JobHistory| {
            let mut left = record.frames.iter().filter(|&&frame| record.is_pending(frame));
            left.any(|&frame| frame_content(&record.spec, frame) == Some(key))
        };
        self.jobs.range(..JobId::shared(0)).map(|(_, record)| record).filter(move |record| is_left(record))
    }

    /// Checks whether an instance of the content, of any build, has a quarantined task and needs a retry.
    fn needs_retry(&self, key: Digest) -> bool {
        let of_key = self.shared_stages.instances.iter().filter(|((other, _), _)| *other == key);
        of_key.filter_map(|(_, job)| self.jobs.get(job)).any(JobHistory::has_quarantined_task)
    }

    /// Checks whether a job needs a retry to proceed: each unfinished frame has a quarantined task, of its own or in its shared
    /// stages.
    pub(crate) fn is_blocked(&self, record: &JobHistory) -> bool {
        let is_starved = |frame| frame_content(&record.spec, frame).is_some_and(|key| self.needs_retry(key));
        record.frames.iter().all(|&frame| !record.is_pending(frame) || is_starved(frame))
    }

    /// Returns the owners who pay for a worker's time on a task of a job: the job's owner, or for shared stages the owners of all
    /// waiting jobs.
    pub(crate) fn payers(&self, job: JobId) -> Option<Vec<String>> {
        let record = self.jobs.get(&job)?;
        let key = self.shared_stages.instance_key(job).map(|(key, _)| *key);
        let waiting = key.into_iter().flat_map(|key| self.jobs_needing(key)).filter(|record| record.may_run());
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
        let live = self.shared_stages.instances.values();
        live.filter_map(|&job| Some((job, self.payers(job)?))).collect()
    }

    /// Returns the outputs of finished instances that frames read now or in future jobs.
    pub(crate) fn shared_inputs(&self) -> Vec<(JobId, u32, Digest)> {
        let made = self.shared_stages.outputs.iter();
        made.flat_map(|(&job, made)| made.iter().map(move |&digest| (job, Stage::JOB_FRAME, digest))).collect()
    }

    /// Checks a record about an instance before it is applied.
    pub(crate) fn check_shared_stages(&mut self, fact: &Fact) -> Option<Violation> {
        match fact {
            Fact::SharedJobBegun { job, key, engine, .. } => {
                let is_new = job.is_shared() && job.0 > self.shared_stages.last;
                let before = self.shared_stages.instances.get(&(*key, engine.clone()));
                let again = before.map(|&before| Violation::DuplicateSharedStages { jobs: [before, *job] });
                again.or((!is_new).then_some(Violation::JobNumberReused { job: *job }))
            }
            Fact::Controlled { job, control } if job.is_shared() => {
                let key = self.shared_stages.instance_key(*job).map(|(key, _)| *key);
                let is_asked_for = key.is_some_and(|key| self.shared_stages.retried.contains(&key));
                (!is_asked_for).then_some(Violation::UnrequestedControl { job: *job, control: control.clone() })
            }
            // A job needs its shared stages whether it runs or not.
            Fact::JobRemoved { job } if job.is_shared() => {
                let (key, _) = *self.shared_stages.instance_key(*job)?;
                let is_done = self.jobs.get(job).is_some_and(JobHistory::has_ended);
                let is_needed =
                    || self.jobs_needing(key).any(|record| !record.is_cancelled_or_failed()) && !self.needs_retry(key);
                (is_done && is_needed()).then_some(Violation::ExpiredEarly { job: *job })
            }
            _ => None,
        }
    }

    /// Updates the instances after a record was applied.
    pub(crate) fn update_shared_stages(&mut self, fact: &Fact, now: Duration) {
        let contents = &mut self.shared_stages;
        match fact {
            Fact::SharedJobBegun { job, key, engine, .. } => {
                contents.instances.insert((*key, engine.clone()), *job);
                contents.last = contents.last.max(job.0);
            }
            Fact::Restarted { job, .. } if job.is_shared() => contents.mark_missing(*job, now),
            Fact::JobRemoved { job } if job.is_shared() => {
                contents.mark_missing(*job, now);
                contents.instances.retain(|_, other| other != job);
            }
            _ => {}
        }
        let requested = match fact {
            Fact::Submitted { job, .. }
            | Fact::Controlled { job, control: Control::Retry | Control::RetryFrames(_) } => Some(job),
            _ => None,
        };
        if requested.is_none_or(|job| !job.is_shared()) {
            let spec = requested.and_then(|job| self.jobs.get(job)).map(|record| &record.spec);
            contents.retried = spec.iter().flat_map(|spec| &spec.contents).map(|(_, key)| *key).collect();
        }
        if let Some(result) = counted_result(fact).filter(|result| result.task.job.is_shared())
            && let Some(record) = self.jobs.get(&result.task.job).filter(|_| result.task.job.is_shared())
            && result.finishes(&record.spec)
            && let Some(instance) = contents.instance_key(result.task.job).cloned()
        {
            let made = result.result.outputs.iter().map(|output| output.artifact.digest);
            contents.outputs.insert(result.task.job, made.collect());
            contents.finished.insert(instance, None);
        }
        let live: Vec<(JobId, Digest)> =
            self.shared_stages.instances.iter().map(|((key, _), job)| (*job, *key)).collect();
        let is_wanted = |key| self.jobs_needing(key).any(JobHistory::may_run);
        let idle: BTreeSet<JobId> = live.into_iter().filter(|(_, key)| !is_wanted(*key)).map(|(job, _)| job).collect();
        self.shared_stages.unwanted_since.retain(|job, _| idle.contains(job));
        for job in idle {
            self.shared_stages.unwanted_since.entry(job).or_insert(now);
        }
    }

    /// Checks a lease of a frame's task: the shared stages that it reads must be done by the worker's build.
    /// - `incarnation`: number of the coordinator that grants the lease.
    pub(crate) fn check_shared_inputs(
        &self,
        engine: &str,
        lease: &Assignment,
        incarnation: u32,
        now: Duration,
    ) -> Option<Violation> {
        let TaskKey { job, stage, .. } = lease.task;
        let record = self.jobs.get(&job).filter(|_| incarnation == self.incarnation())?;
        if job.is_shared() || !has_shared_stages(&record.spec) || !record.spec.graph.reads_content(stage.number) {
            return None;
        }
        let instance = (frame_content(&record.spec, stage.frame)?, engine.to_owned());
        let is_there = match self.shared_stages.finished.get(&instance) {
            None => false,
            // An instance that disappeared a moment ago may have existed when the lease was granted.
            Some(gone) => gone.is_none_or(|since| now.saturating_sub(since) <= self.shared_stages.propagation_delay.0),
        };
        (!is_there).then_some(Violation::SharedStagesMissing { task: lease.task, epoch: lease.epoch })
    }

    /// Finds a lease of a worker whose shared stage has been unwanted for too long.
    /// - `joined`: time since which the worker can be informed.
    pub(crate) fn find_unwanted<'a>(
        &self,
        held: impl Iterator<Item = &'a TaskKey>,
        joined: Duration,
        now: Duration,
    ) -> Option<Violation> {
        let is_unwanted = |task: &&TaskKey| {
            let since = self.shared_stages.unwanted_since.get(&task.job).map(|&since| since.max(joined));
            since.is_some_and(|since| now.saturating_sub(since) > self.shared_stages.propagation_delay.0)
        };
        held.into_iter().find(is_unwanted).map(|&task| Violation::UnwantedLease { task })
    }
}
