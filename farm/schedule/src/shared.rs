//! Shared jobs: stages that are done once for all frames and all jobs with the same content.
//!
//! An **instance**, or shared job, is a content and a build of the engine. It begins when a worker of that build would get a frame
//! that needs it; a frame only reads inputs of its own build. It has tasks, leases and attempts like a job, under a number of its
//! own. Its place in the order of service is that of the first job that waits for it. Its time is charged to all owners whose jobs
//! wait for it. When no job waits for it any more, its leases are revoked. It is kept for future jobs, done or not, while the total
//! size of all such instances is within a limit.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{Digest, JobId, JobSpec, RevokeReason, Scope, Stage, Tick, WaitReason, WorkerId};

use crate::builds::build_of;
use crate::lease_table::{LeaseKey, Worker};
use crate::ledger::Job;
use crate::scheduler::Scheduler;
use crate::{Command, Config, Fact};

/// Availability of a frame's content for a worker.
pub(crate) enum ContentState {
    /// The content is available, or the stage does not read it.
    Available,
    /// This shared job is not done yet.
    InProgress(JobId),
    /// Another build makes it, or should make it.
    Elsewhere,
    /// The shared job has not begun.
    Missing(Digest),
}

impl Scheduler {
    /// Returns the availability of a frame's content for a stage, for a worker of this build.
    pub(crate) fn content_state(&self, id: JobId, job: &Job, stage: &Stage, engine: &str) -> ContentState {
        if !job.spec.graph.reads_content(stage.number) {
            return ContentState::Available;
        }
        let Some(key) = job.content_key(stage.frame) else { return ContentState::Available };
        if let Some((id, shared)) = self.ledger.shared_job_of(&key, engine) {
            return if shared.is_done() { ContentState::Available } else { ContentState::InProgress(id) };
        }
        let may_continue = |worker: &Worker, shared: &Job| {
            worker.is_open() && self.is_present(worker) && self.has_tags_for(worker, shared)
        };
        let is_there = |id: JobId, shared: &Job| self.has_worker_for(id, shared, |worker| may_continue(worker, shared));
        let mut others = self.ledger.shared_jobs_of(&key).filter(|(_, _, shared)| !shared.has_ended());
        // Outputs of another build are useless for a frame of this build, and no other build continues that frame.
        let is_own = build_of(&self.ledger, &self.table, id, stage.frame) == Some(engine);
        let is_elsewhere = (!is_own && others.any(|(_, id, shared)| is_there(id, shared)))
            || !self.has_best_coverage(job, Scope::Content, engine);
        if is_elsewhere { ContentState::Elsewhere } else { ContentState::Missing(key) }
    }

    /// Checks whether some worker of a shared job's build for which `is_eligible` holds has the tags of one of its present stages.
    fn has_worker_for(&self, id: JobId, shared: &Job, is_eligible: impl Fn(&Worker) -> bool) -> bool {
        let build = shared.shared.as_ref().map(|shared| &*shared.engine);
        let ready = self.ready.get(&id).into_iter().flat_map(|ready_tasks| ready_tasks.open.ready());
        let ready = ready.flat_map(|(_, open)| open.stages()).map(|(stage, _)| stage.number);
        let stages: BTreeSet<u16> =
            ready.chain(self.table.leases_of_job(id).map(|((task, _), _)| task.stage.number)).collect();
        self.table.workers.values().any(|it| {
            let has_tags = |number: &u16| it.has_tags(shared.tags_of(*number));
            Some(&*it.registration.engine) == build && stages.iter().any(has_tags) && is_eligible(it)
        })
    }

    /// Returns the running jobs that wait for a content, in order of submission.
    pub(crate) fn jobs_waiting_for(&self, key: &Digest) -> impl Iterator<Item = &Job> {
        let key = *key;
        let jobs = self.order.jobs().filter_map(|id| self.ledger.jobs.get(&id));
        jobs.filter(move |job| job.needs_content(&key))
    }

    /// Returns the jobs whose status may have changed when this job has changed: itself, and all jobs that share it.
    pub fn affected_jobs(&self, job: JobId) -> Vec<JobId> {
        let Some(shared) = self.ledger.jobs.get(&job).and_then(|known| known.shared.as_ref()) else { return vec![job] };
        let names = |known: &Job| known.spec.contents.iter().any(|(_, key)| *key == shared.key);
        let sharing = self.ledger.submitted_jobs().filter(|(_, known)| names(known)).map(|(id, _)| id);
        sharing.chain([job]).collect()
    }

    /// Checks whether a worker has the tags of the job. For a shared job, checks the tags of the jobs that wait for it, one of
    /// which must match.
    pub(crate) fn has_tags_for(&self, worker: &Worker, job: &Job) -> bool {
        match &job.shared {
            None => worker.has_tags(&job.spec.tags),
            Some(shared) => self.jobs_waiting_for(&shared.key).any(|job| may_begin(worker, job)),
        }
    }

    /// Begins the shared job that a frame of a job needs.
    pub(crate) fn begin_shared(
        &mut self,
        job: JobId,
        frame: u32,
        key: Digest,
        worker: WorkerId,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        let (Some(known), Some(worker)) = (self.ledger.jobs.get(&job), self.table.workers.get(&worker)) else { return };
        let (id, cut, engine) = (self.ledger.next_shared(), known.chunk_size(), worker.registration.engine.clone());
        let (frames, contents) = (vec![frame], vec![(1, key)]);
        let spec = Box::new(JobSpec { frames, contents, ..(*known.spec).clone() });
        self.record_fact(Fact::SharedJobBegun { job: id, key, engine, spec, chunk_size: cut }, now, out);
        self.rebuild_ready(id);
    }

    /// Splits milliseconds of a shared job among the owners whose jobs wait for it, by their weights. The remainder goes to the
    /// first owner by name.
    pub(crate) fn split_charge(&self, shared: &Job, milliseconds: u64) -> Vec<(String, u64)> {
        let key = shared.shared.as_ref().map(|shared| shared.key);
        let waiting = key.iter().flat_map(|key| self.jobs_waiting_for(key)).map(|job| job.spec.owner.clone());
        let mut owners: Vec<String> = waiting.collect();
        if owners.is_empty() {
            owners.push(shared.spec.owner.clone());
        }
        owners.sort_unstable();
        owners.dedup();
        let weight = |owner: &String| u128::from(self.config.weight(owner).max(1));
        let sum: u128 = owners.iter().map(weight).sum();
        let part = |owner: &String| (u128::from(milliseconds) * weight(owner) / sum) as u64;
        let parts: Vec<u64> = owners.iter().map(part).collect();
        let remainder = milliseconds - parts.iter().sum::<u64>();
        let with_rest = |(index, part): (usize, u64)| if index == 0 { part + remainder } else { part };
        owners.into_iter().zip(parts.into_iter().enumerate().map(with_rest)).collect()
    }

    /// Checks whether a running job waits for this shared job.
    pub(crate) fn is_wanted(&self, shared: &Job) -> bool {
        let key = shared.shared.as_ref().map(|shared| shared.key);
        key.is_some_and(|key| !shared.has_ended() && self.jobs_waiting_for(&key).next().is_some())
    }

    /// Revokes the leases of shared jobs that no job waits for any more.
    pub(crate) fn revoke_unwanted(&mut self, out: &mut Vec<Command>) {
        let idle = self.ledger.shared_jobs().filter(|(_, shared)| !self.is_wanted(shared));
        let idle: Vec<JobId> = idle.map(|(id, _)| id).collect();
        for id in idle {
            let keys: Vec<LeaseKey> = self.table.leases_of_job(id).map(|(key, _)| key).collect();
            for key in keys {
                self.revoke_lease(&key, RevokeReason::JobEnded, out);
                self.refresh_task(&key.0);
            }
        }
    }

    /// Retries the stuck shared jobs of a job that a person retries or submits.
    /// - `is_meant`: selects the frames of the job.
    pub(crate) fn retry_shared(
        &mut self,
        job: JobId,
        is_meant: impl Fn(u32) -> bool,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        let Some(job) = self.ledger.jobs.get(&job) else { return };
        let contents = job.contents_of(is_meant);
        let shared = contents.iter().flat_map(|key| self.ledger.shared_jobs_of(key));
        let stuck_shared: Vec<JobId> = shared.filter(|(_, _, shared)| shared.is_stuck()).map(|(_, id, _)| id).collect();
        if stuck_shared.is_empty() {
            return;
        }
        for id in stuck_shared {
            self.discard_deaths(id, |_| true);
            self.revoke_made_with_gaps(id, out);
            self.record_fact(Fact::Controlled { job: id, control: femc_model::Control::Retry }, now, out);
            self.rebuild_ready(id);
        }
        self.rebuild_ready_of_contents();
    }

    /// Revokes the leases of jobs' own stages that leave out frames blocked by the shared job: those frames are about to be
    /// retried.
    fn revoke_made_with_gaps(&mut self, shared: JobId, out: &mut Vec<Command>) {
        let Some(key) = self.ledger.jobs.get(&shared).and_then(|job| Some(job.shared.as_ref()?.key)) else { return };
        let has_gaps = |job: &Job| job.spec.graph.has_gaps() && job.frames_blocked_by_shared(&key).next().is_some();
        let jobs: Vec<JobId> =
            self.ledger.submitted_jobs().filter(|(_, job)| has_gaps(job)).map(|(id, _)| id).collect();
        jobs.into_iter().for_each(|job| self.revoke_frame(job, Stage::JOB_FRAME, out));
    }

    /// Rederives the ready tasks of all jobs that have contents, after a shared job has changed.
    pub(crate) fn rebuild_ready_of_contents(&mut self) {
        let jobs: Vec<JobId> = self
            .ledger
            .submitted_jobs()
            .filter(|(_, job)| job.spec.graph.has_content_stages())
            .map(|(id, _)| id)
            .collect();
        jobs.into_iter().for_each(|job| self.rebuild_ready(job));
    }

    /// Returns the jobs whose frames need a shared job, whether they run or not.
    fn jobs_needing<'a>(&'a self, shared: &Job) -> impl Iterator<Item = &'a Job> + use<'a> {
        let key = shared.shared.as_ref().map(|shared| shared.key);
        let needs = move |job: &&Job| key.is_some_and(|key| job.needs_content(&key) && !job.is_aborted());
        self.ledger.submitted_jobs().map(|(_, job)| job).filter(needs)
    }

    /// Checks whether a present worker, drained or not, could continue a shared job for a job that needs it. If no job needs it,
    /// checks whether a worker of its build is present.
    fn is_attended(&self, id: JobId, shared: &Job) -> bool {
        let is_there = |worker: &Worker| self.now.since(worker.last_message) < self.config.orphaned_after;
        let needing: Vec<&Job> = self.jobs_needing(shared).collect();
        if needing.is_empty() {
            let build = shared.shared.as_ref().map(|shared| &*shared.engine);
            return self.table.workers.values().any(|it| Some(&*it.registration.engine) == build && is_there(it));
        }
        self.has_worker_for(id, shared, |worker| is_there(worker) && needing.iter().any(|job| may_begin(worker, job)))
    }

    /// Removes unfinished shared jobs that have had no worker for too long. Of the shared jobs that no job needs, done or not,
    /// removes the oldest until the rest is within the size limit.
    pub(crate) fn evict_shared(&mut self, now: Tick, out: &mut Vec<Command>) {
        let before = std::mem::take(&mut self.unattended);
        let (mut unattended, mut forgotten) = (BTreeMap::new(), Vec::new());
        let (mut kept, mut bytes) = (Vec::new(), 0u64);
        for (id, shared) in self.ledger.shared_jobs() {
            if shared.is_stuck() {
                // It is the reason why frames are blocked, and is kept while there are such frames.
                let key = shared.shared.as_ref().map(|shared| shared.key);
                let has_blocked = |job: &Job| key.is_some_and(|key| job.has_blocked_frames_of(&key));
                if !self.ledger.submitted_jobs().any(|(_, job)| has_blocked(job)) {
                    forgotten.push(id);
                }
                continue;
            }
            if !shared.is_done() && self.table.leases_of_job(id).next().is_none() && !self.is_attended(id, shared) {
                let since = before.get(&id).copied().unwrap_or(now);
                if now.since(since) >= self.config.orphaned_after {
                    forgotten.push(id);
                    continue;
                }
                unattended.insert(id, since);
            }
            if self.jobs_needing(shared).next().is_none() {
                let size = shared.bytes().saturating_add(Config::SHARED_OVERHEAD);
                bytes = bytes.saturating_add(size);
                kept.push((shared.end_or_submission(), id, size));
            }
        }
        self.unattended = unattended;
        kept.sort_unstable();
        for (_, id, size) in kept {
            if bytes <= self.config.shared_bytes {
                break;
            }
            bytes = bytes.saturating_sub(size);
            forgotten.push(id);
        }
        for job in forgotten {
            self.revoke_all(job, out);
            self.record_fact(Fact::JobRemoved { job }, now, out);
            self.ready.remove(&job);
            self.joinable.remove(&job);
        }
    }

    /// Reports frames of a job that are blocked because a shared job is stuck.
    pub(crate) fn stuck_waits(&self, job: &Job) -> Vec<WaitReason> {
        let wait = |(id, shared): (JobId, &Job)| {
            let key = shared.shared.as_ref().map(|shared| shared.key);
            let frames = job.blocked.iter().filter(|&&frame| job.content_key(frame) == key).count() as u32;
            let tasks = shared.unfinished.values().map(|progress| progress.quarantined().count() as u32).sum();
            (frames > 0).then_some(WaitReason::SharedQuarantined { shared: id, frames, tasks })
        };
        self.stuck_shared(job).filter_map(wait).collect()
    }

    /// Reports the shared jobs that frames of a job wait for, each with its present stage.
    pub(crate) fn shared_waits(&self, job: &Job) -> Vec<WaitReason> {
        let mut waits = Vec::new();
        for key in job.contents() {
            for (_, id, shared) in self.ledger.shared_jobs_of(&key).filter(|(_, _, shared)| !shared.has_ended()) {
                let (progress, view) = (shared.progress(Stage::JOB_FRAME), shared.graph_view(Stage::JOB_FRAME));
                let stage_round = progress.stage_rounds(&view).find(|&place| !progress.is_complete(&view, place));
                let Some((place, template)) =
                    stage_round.and_then(|stage_round| Some((stage_round, view.template(stage_round.1)?)))
                else {
                    continue;
                };
                waits.push(WaitReason::SharedStage {
                    shared: id,
                    stage: template.kind,
                    done: progress.tasks_done(place),
                    tasks: template.tasks(),
                    jobs: self.jobs_waiting_for(&key).count() as u32,
                });
            }
        }
        waits
    }
}

/// Checks whether a worker has the tags of a job and of one of its frame stages that read the content. Such a worker gets tasks of
/// the shared job, too.
fn may_begin(worker: &Worker, job: &Job) -> bool {
    let mut frames = job.spec.graph.stages_of(Scope::Frame);
    worker.has_tags(&job.spec.tags)
        && frames.any(|(number, template)| worker.has_tags(&template.tags) && job.spec.graph.reads_content(number))
}
