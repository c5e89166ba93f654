//! Requests of users: submission and control of jobs.

use femc_model::{ChunkSize, Control, JobId, JobSpec, Refusal, RevokeReason, Stage, Tick, UsageSums};

use crate::lease_table::LeaseKey;
use crate::ledger::{Hold, Job};
use crate::scheduler::Scheduler;
use crate::{Answer, Command, Fact, Quota};

impl Scheduler {
    pub(crate) fn submit(
        &mut self,
        key: Option<String>,
        spec: Box<JobSpec>,
        date: Option<u64>,
        now: Tick,
        out: &mut Vec<Command>,
    ) -> Result<Answer, Refusal> {
        spec.check().map_err(|error| Refusal::Invalid { field: "job".into(), message: error.to_string() })?;
        if key.as_ref().is_some_and(|key| key.len() > JobSpec::MAX_NAME) {
            return Err(Refusal::TooLarge {
                what: "length of the key in bytes".into(),
                limit: JobSpec::MAX_NAME as u64,
            });
        }
        if let Some(job) = key.as_deref().and_then(|key| self.ledger.job_of_key(key)) {
            return self.repeat_submission(job, &spec);
        }
        self.check_quota(&spec)?;
        let job = self.ledger.next_job();
        self.meter.add(&spec.owner, UsageSums { jobs: 1, ..UsageSums::default() });
        let cut = ChunkSize::Units(self.config.chunk_size);
        self.record_fact(Fact::Submitted { job, key, spec, chunk_size: cut, date, announces: true }, now, out);
        self.rebuild_ready(job);
        self.retry_shared(job, |_| true, now, out);
        out.push(Command::JobChanged(job));
        Ok(Answer::Submitted(job))
    }

    /// Answers a submission whose key belongs to this job. Only a specification with equal results is a repetition.
    fn repeat_submission(&self, job: JobId, spec: &JobSpec) -> Result<Answer, Refusal> {
        if self.ledger.jobs.get(&job).is_some_and(|known| known.spec.key() == spec.key()) {
            return Ok(Answer::Submitted(job));
        }
        let message = format!("job {job} was submitted with this key and another specification; submit with a new key");
        Err(Refusal::Invalid { field: "key".into(), message })
    }

    /// Refuses a job that would exceed its owner's quota.
    fn check_quota(&self, spec: &JobSpec) -> Result<(), Refusal> {
        let Quota { jobs, frames, tasks } = self.config.quota;
        let sizes = |spec: &JobSpec| [1, spec.frames.len() as u64, spec.tasks()];
        let own = self.ledger.submitted_jobs().map(|(_, job)| job);
        let own = own.filter(|job| job.spec.owner == spec.owner && !job.has_ended());
        let sums = own.fold(sizes(spec), |[a, b, c], job| {
            let [jobs, frames, tiles] = sizes(&job.spec);
            [a + jobs, b + frames, c.saturating_add(tiles)]
        });
        let limits = [("jobs", jobs), ("frames", frames), ("tasks", tasks)];
        let beyond = limits.into_iter().zip(sums).find(|((_, limit), sum)| sum > limit);
        beyond.map_or(Ok(()), |((what, limit), _)| {
            Err(Refusal::TooLarge { what: format!("{what} of {} that have not ended", spec.owner), limit })
        })
    }

    pub(crate) fn control(
        &mut self,
        id: JobId,
        control: Control,
        now: Tick,
        out: &mut Vec<Command>,
    ) -> Result<Answer, Refusal> {
        let job = self.job(id)?;
        if id.is_shared() {
            return Err(Refusal::NoSuchJob { job: id });
        }
        let control = match control {
            Control::Delete => return self.delete_job(id, now, out),
            Control::RetryFrames(frames) => Control::RetryFrames(frames_to_retry(job, frames)?),
            other => other,
        };
        let is_done = job.is_done();
        let has_failures =
            !job.blocked.is_empty() || job.unfinished.values().any(|progress| progress.quarantined().next().is_some());
        let changes = match &control {
            Control::Pause | Control::Resume | Control::Cancel if job.has_ended() => {
                return Err(Refusal::Ended { job: id });
            }
            Control::Retry | Control::RetryFrames(_) if is_done => return Err(Refusal::Ended { job: id }),
            Control::Pause => job.hold != Hold::Paused,
            Control::Resume => job.hold != Hold::Free,
            Control::Cancel => true,
            Control::RetryFrames(_) if job.is_aborted() => {
                let message = format!("job {id} was cancelled or has failed as a whole: retry the whole job");
                return Err(Refusal::Invalid { field: "frames".into(), message });
            }
            Control::Retry => job.has_ended() || has_failures,
            Control::RetryFrames(frames) => frames.iter().any(|&frame| job.has_failures(frame)),
            Control::Priority(priority) if *priority > 100 => {
                return Err(Refusal::Invalid { field: "priority".into(), message: "at most 100".into() });
            }
            Control::Priority(priority) => job.spec.priority != *priority,
            Control::Delete => false,
        };
        let fills_gaps = job.spec.graph.has_gaps()
            && match &control {
                Control::Retry => job.frames_blocked() > 0,
                Control::RetryFrames(frames) => frames.iter().any(|frame| job.blocked.contains(frame)),
                Control::Pause | Control::Resume | Control::Cancel | Control::Priority(_) | Control::Delete => false,
            };
        if changes {
            if fills_gaps {
                self.revoke_frame(id, Stage::JOB_FRAME, out);
            }
            self.record_fact(Fact::Controlled { job: id, control: control.clone() }, now, out);
            match control {
                Control::Cancel => self.revoke_all(id, out),
                Control::Retry => {
                    self.discard_deaths(id, |_| true);
                    self.retry_shared(id, |_| true, now, out);
                }
                Control::RetryFrames(frames) => {
                    let is_meant = |frame: u32| frames.binary_search(&frame).is_ok();
                    self.discard_deaths(id, is_meant);
                    self.retry_shared(id, is_meant, now, out);
                }
                Control::Pause | Control::Resume | Control::Priority(_) | Control::Delete => {}
            }
            self.rebuild_ready(id);
            self.revoke_unwanted(out);
            out.push(Command::JobChanged(id));
        }
        Ok(Answer::Controlled(id))
    }

    /// Revokes leases that can no longer count: those of a job that has ended (its own stages may read frames that have been lost
    /// since), and, if a shared job is stuck, those of all blocked frames.
    pub(crate) fn revoke_ended(&mut self, id: JobId, out: &mut Vec<Command>) {
        let Some(job) = self.ledger.jobs.get(&id).filter(|job| job.has_ended()) else { return };
        let failed = self.ledger.submitted_jobs().filter(|_| job.is_stuck()).chain([(id, job)]);
        let is_over = |job: &Job, frame: u32| job.has_ended() || job.blocked.contains(&frame);
        let leases = failed.flat_map(|(id, job)| {
            let all = self.table.leases_of_job(id).map(|(key, _)| key);
            all.filter(|(task, _)| is_over(job, task.stage.frame)).collect::<Vec<LeaseKey>>()
        });
        leases.collect::<Vec<_>>().into_iter().for_each(|key| self.revoke_lease(&key, RevokeReason::JobEnded, out));
    }

    /// Revokes every lease of a job that has ended.
    pub(crate) fn revoke_all(&mut self, id: JobId, out: &mut Vec<Command>) {
        let keys: Vec<LeaseKey> = self.table.leases_of_job(id).map(|(key, _)| key).collect();
        for key in keys {
            self.revoke_lease(&key, RevokeReason::JobEnded, out);
        }
    }
}

/// Returns the frames to retry, ascending and without duplicates. Fails if one of them is not a frame of the job.
fn frames_to_retry(job: &Job, mut frames: Vec<u32>) -> Result<Vec<u32>, Refusal> {
    let invalid = |message| Refusal::Invalid { field: "frames".into(), message };
    frames.sort_unstable();
    frames.dedup();
    if frames.is_empty() {
        return Err(invalid("give at least one frame".to_owned()));
    }
    match frames.iter().find(|frame| job.frames().binary_search(frame).is_err()) {
        Some(frame) => Err(invalid(format!("the job has no frame {frame}"))),
        None => Ok(frames),
    }
}
