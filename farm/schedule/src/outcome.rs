//! What workers report: a result or a failure, counted once and only under a lease that holds.

use femc_model::{
    Decision, Digest, Ending, Epoch, Failure, GatherResult, JobId, MergeResult, Refusal, RevokeReason, Stage,
    StageKind, TaskKey, TaskResult, Tick, Verdict, WorkerId,
};

use crate::attempts::Counted;
use crate::floor::LeaseKey;
use crate::ledger::Job;
use crate::ledger::frame::Frame;
use crate::scheduler::Scheduler;
use crate::{Command, Fact};

impl Scheduler {
    pub(crate) fn completed(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        epoch: Epoch,
        result: TaskResult,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        self.note_seen(worker, now);
        self.note_life(worker, now, out);
        let Some(lease) = self.floor.lease_of(worker, &task, epoch) else {
            return self.without_lease(worker, task, epoch, out);
        };
        let (granted, size) = (lease.granted, lease.size);
        let (seconds, counted) = (result.seconds(), Counted::of(&result));
        let sound = self.ledger.jobs.get(&task.job).map_or(Sound::default(), |job| Sound::of(job, task.stage.round));
        let fact = match (task.stage.kind, result) {
            (StageKind::Render, TaskResult::Tile(result)) if result.samples == size.samples => {
                Fact::Rendered { task, epoch, leased: granted, result }
            }
            (StageKind::Merge, TaskResult::Merge(result)) if sound.merge(&result) => {
                Fact::Merged { task, epoch, result: Box::new(result) }
            }
            (StageKind::Gather, TaskResult::Gather(result)) if sound.gather(&result) => {
                Fact::Gathered { task, epoch, result }
            }
            (StageKind::Render | StageKind::Merge | StageKind::Gather, _) => {
                let message = "the result does not fit the task".to_owned();
                let refusal = Refusal::Invalid { field: "result".into(), message: message.clone() };
                return self.refused(worker, task, epoch, Failure::Panicked { message }, refusal, now, out);
            }
        };
        let is_alone = self.floor.copies.is_empty();
        if let Some(lease) = self.release(&(task, epoch)) {
            self.note(&(task, epoch), &lease, Ending::Done, counted, out);
        }
        // A worker's clock, at most what went by here: a lease may have waited for its turn.
        let spent = ((seconds.max(0.0) * 1000.0) as u64).min(now.since(granted));
        if let Some(typical) = self.learn(&task, size, spent) {
            self.floor.pace(worker, typical, &self.config);
        }
        if let Some(worker) = self.floor.workers.get_mut(&worker) {
            worker.completed += 1;
            worker.mishaps = 0;
            worker.trouble = None;
        }
        self.note_build(task.job, task.stage.frame, worker, now, out);
        self.record(fact, now, out);
        if !is_alone {
            self.revoke_others(&task, RevokeReason::Done, out);
        }
        let instance = self.floor.instance(worker);
        if let (Some(desk), Some(job)) = (self.desks.get_mut(&task.job), self.ledger.jobs.get(&task.job)) {
            desk.avoid.remove(&task);
            desk.mishaps.forget(&task);
            instance.into_iter().for_each(|instance| desk.distrust.succeeded(instance));
            desk.completed(&task, job, &self.floor);
        }
        self.reorder(task.job);
        out.push(Command::Accept { worker, task, epoch });
        out.push(Command::Changed(task.job));
    }

    pub(crate) fn failed(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        epoch: Epoch,
        failure: Failure,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        self.note_seen(worker, now);
        self.not_done(worker, task, epoch, failure, Command::Accept { worker, task, epoch }, now, out);
    }

    /// A result that cannot count: a failure, and its worker hears that it does not.
    pub(crate) fn refused(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        epoch: Epoch,
        failure: Failure,
        refusal: Refusal,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        self.note_seen(worker, now);
        self.not_done(worker, task, epoch, failure, Command::Refuse { worker, task, epoch, refusal }, now, out);
    }

    fn not_done(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        epoch: Epoch,
        failure: Failure,
        answer: Command,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        if self.floor.lease_of(worker, &task, epoch).is_none() {
            return self.without_lease(worker, task, epoch, out);
        }
        if let Some(lease) = self.release(&(task, epoch)) {
            let ending = if failure == Failure::Cancelled { Ending::Cancelled } else { Ending::Failed };
            self.note(&(task, epoch), &lease, ending, Counted::default(), out);
        }
        match failure.verdict() {
            Verdict::Cancelled => {}
            Verdict::Infrastructure => {
                if let Some(desk) = self.desks.get_mut(&task.job) {
                    desk.mishaps.note(task, failure.to_string());
                }
                self.rest(worker, failure, now);
            }
            Verdict::Retry => self.count_failure(worker, task, failure, now, out),
            Verdict::Fatal => self.doom(task.job, failure, now, out),
            Verdict::Rebuild(digests) => self.rebuild_inputs(worker, task, &digests, failure, now, out),
        }
        self.put_back(&task);
        out.push(answer);
        out.push(Command::Changed(task.job));
    }

    /// Takes back what else does the same.
    fn revoke_others(&mut self, task: &TaskKey, reason: RevokeReason, out: &mut Vec<Command>) {
        let others: Vec<LeaseKey> = self.floor.of_task(task).map(|(key, _)| *key).collect();
        others.iter().for_each(|key| self.revoke(key, reason, out));
    }

    /// A report whose lease is over: the recorded answer if it is a repetition, a refusal otherwise.
    fn without_lease(&mut self, worker: WorkerId, task: TaskKey, epoch: Epoch, out: &mut Vec<Command>) {
        let refusal = match self.job(task.job) {
            Ok(job) if job.holds(&task, epoch) => return out.push(Command::Accept { worker, task, epoch }),
            Ok(_) => Refusal::StaleEpoch,
            Err(refusal) => refusal,
        };
        self.note_stale(task.job);
        out.push(Command::Refuse { worker, task, epoch, refusal });
    }

    fn note_seen(&mut self, worker: WorkerId, now: Tick) {
        if let Some(worker) = self.floor.workers.get_mut(&worker) {
            worker.seen = now;
        }
    }

    fn rest(&mut self, worker: WorkerId, trouble: Failure, now: Tick) {
        let Some(worker) = self.floor.workers.get_mut(&worker) else { return };
        let rest = self.config.rest.saturating_mul(1 << worker.mishaps.min(20)).min(self.config.longest_rest);
        worker.rests_until = now.after(rest);
        worker.mishaps += 1;
        worker.trouble = Some(trouble);
    }

    /// A failure counts as an attempt unless another worker does the same.
    pub(crate) fn count_failure(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        failure: Failure,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        if let Some(worker) = self.floor.workers.get_mut(&worker) {
            worker.failed += 1;
        }
        if let Some(desk) = self.desks.get_mut(&task.job) {
            desk.avoid.insert(task, worker);
            if let Some(instance) = self.floor.instance(worker) {
                desk.distrust.failed(instance, task, &self.config, now);
            }
        }
        if self.floor.of_task(&task).next().is_none() {
            let until = Epoch::new(self.ledger.incarnation, self.leases);
            self.record(Fact::Failed { task, until, failure }, now, out);
        }
    }

    fn doom(&mut self, job: JobId, failure: Failure, now: Tick, out: &mut Vec<Command>) {
        self.record(Fact::Doomed { job, failure }, now, out);
        self.revoke_all(job, out);
    }

    /// Inputs are gone: what made them is to run again. Counts as an attempt of the task that missed it, so that a
    /// store which loses everything ends the frame and not the night.
    fn rebuild_inputs(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        digests: &[Digest],
        failure: Failure,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        if digests.contains(&job.spec.bundle) {
            return self.doom(task.job, failure, now, out);
        }
        // It would miss the same.
        self.revoke_others(&task, RevokeReason::Expired, out);
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        let frame = task.stage.frame;
        let repairs = job.frames.get(&frame).map(|work| repairs(&task, work, digests)).unwrap_or_default();
        self.count_failure(worker, task, failure, now, out);
        let is_open = self.ledger.jobs.get(&task.job).is_some_and(|job| job.is_open(frame));
        if is_open {
            for repair in repairs {
                if let Fact::Restarted { .. } = repair {
                    self.revoke_frame(task.job, frame, out);
                }
                self.record(repair, now, out);
            }
        }
    }

    /// The finished frames whose image or preview this is begin anew, whatever has become of their job: what was said of them is
    /// not true any more. Inputs of tasks are their tasks' business.
    pub(crate) fn lost(&mut self, digest: &Digest, now: Tick, out: &mut Vec<Command>) {
        let frames =
            self.ledger.jobs.iter().flat_map(|(&id, job)| job.pictured_by(digest).map(move |frame| (id, frame)));
        for (job, frame) in frames.collect::<Vec<_>>() {
            self.record(Fact::Restarted { job, frame }, now, out);
            self.rebuild(job);
            out.push(Command::Changed(job));
        }
    }

    /// Takes back the leases of a frame that begins anew: they are of another round.
    pub(crate) fn revoke_frame(&mut self, job: JobId, frame: u32, out: &mut Vec<Command>) {
        let leases = self.floor.of_job(job).map(|(key, _)| *key);
        let leases: Vec<LeaseKey> = leases.filter(|(task, _)| task.stage.frame == frame).collect();
        for key in leases {
            self.revoke(&key, RevokeReason::Expired, out);
            if let Some(desk) = self.desks.get_mut(&job) {
                desk.distrust.released(&key.0);
            }
        }
    }
}

/// What is to be done again so that the lost inputs of a task are there.
fn repairs(task: &TaskKey, work: &Frame, lost: &[Digest]) -> Vec<Fact> {
    let (job, frame) = (task.job, task.stage.frame);
    if work.sums.is_some_and(|sums| lost.contains(&sums.digest)) || work.groups.has_lost_sums(lost) {
        return vec![Fact::Restarted { job, frame }];
    }
    let again = |kind, index| Fact::Lost { task: TaskKey { job, stage: Stage { kind, ..task.stage }, index } };
    let tiles = work.tiles.iter().filter(|(_, tile)| lost.contains(&tile.result.tile.digest));
    let tiles = tiles.map(|(&index, _)| again(StageKind::Render, index));
    tiles.chain(work.groups.lost(lost).map(|group| again(StageKind::Gather, group))).collect()
}

/// Which results say what they must.
#[derive(Debug, Clone, Copy, Default)]
struct Sound {
    /// Another round may follow this one.
    may_go_on: bool,
    /// The merge reads groups, which have the sums.
    is_grouped: bool,
}

impl Sound {
    fn of(job: &Job, round: u32) -> Self {
        Self { may_go_on: (round as usize + 1) < job.spec.rounds.len(), is_grouped: job.layout(round).groups() > 0 }
    }

    /// An image at the end, sums on the way, an end after the last round.
    fn merge(self, result: &MergeResult) -> bool {
        match result.decision {
            Decision::Done => result.image.is_some(),
            Decision::Continue => self.may_go_on && (self.is_grouped || result.sums.is_some()),
        }
    }

    /// Sums, unless this round is the last.
    fn gather(self, result: &GatherResult) -> bool {
        result.sums.is_some() || !self.may_go_on
    }
}
