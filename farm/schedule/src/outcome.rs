//! Outcomes of attempts: a result or a failure, counted once and only under a lease that holds.

use femc_model::{
    Decision, Digest, Ending, Epoch, Failure, JobId, Need, Output, Refusal, RevokeReason, Role, Round, Stage, TaskKey,
    TaskResult, Template, Tick, Verdict, WorkerId,
};

use crate::attempts::Counted;
use crate::lease_table::LeaseKey;
use crate::ledger::{Job, Shape};
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
        self.note_alive(worker, now, out);
        let Some(lease) = self.table.lease_of(worker, &task, epoch) else {
            return self.answer_stale_report(worker, task, epoch, out);
        };
        let (granted, size, end) = (lease.granted, lease.size, lease.run(&task).end);
        let (seconds, counted) = (result.seconds, Counted::of(&result));
        let job = self.ledger.jobs.get(&task.job);
        if !job.is_some_and(|job| is_sound(job, &task.stage, size.units, &result)) {
            let message = "the result does not fit the task".to_owned();
            let refusal = Refusal::Invalid { field: "result".into(), message: message.clone() };
            return self.refused(worker, task, epoch, Failure::Panicked { message }, refusal, now, out);
        }
        let round = job.and_then(|job| job.units.get(&task.stage.frame)).map_or(0, |unit| unit.round);
        let fact = Fact::Done { task, end, epoch, leased: granted, result: Box::new(result) };
        let is_alone = self.table.copies.is_empty();
        if let Some(lease) = self.release(&(task, epoch)) {
            self.note(&(task, epoch), &lease, Ending::Done, counted, out);
        }
        // The worker measured the time, and a lease may have waited for its turn. The time since the grant is an upper bound.
        let taken = ((seconds.max(0.0) * 1000.0) as u64).min(now.since(granted));
        self.learn(&task, size, taken);
        if let Some(worker) = self.table.workers.get_mut(&worker) {
            worker.completed += 1;
            worker.mishaps = 0;
            worker.trouble = None;
        }
        self.note_hint_source(worker, &task);
        self.note_build(task.job, task.stage.frame, worker, now, out);
        let samples = counted.samples();
        self.record(fact, now, out);
        self.meter_task(&task, samples);
        if !is_alone {
            self.revoke_others(&task, RevokeReason::Done, out);
        }
        self.revoke_ended(task.job, out);
        let instance = self.table.instance(worker);
        if let (Some(ready_tasks), Some(job)) = (self.ready.get_mut(&task.job), self.ledger.jobs.get(&task.job)) {
            ready_tasks.avoid.remove(&task);
            ready_tasks.mishaps.forget(&task);
            instance.into_iter().for_each(|instance| ready_tasks.quarantine.succeeded(instance));
            ready_tasks.completed(&task, round, job, &self.table);
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
        self.attempt_failed(worker, task, epoch, failure, Command::Accept { worker, task, epoch }, now, out);
    }

    /// Counts an invalid result as a failure, and refuses the worker's report.
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
        self.attempt_failed(worker, task, epoch, failure, Command::Refuse { worker, task, epoch, refusal }, now, out);
    }

    fn attempt_failed(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        epoch: Epoch,
        failure: Failure,
        answer: Command,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        if self.table.lease_of(worker, &task, epoch).is_none() {
            return self.answer_stale_report(worker, task, epoch, out);
        }
        if let Some(lease) = self.release(&(task, epoch)) {
            let ending = if failure == Failure::Cancelled { Ending::Cancelled } else { Ending::Failed };
            self.note(&(task, epoch), &lease, ending, Counted::default(), out);
        }
        match failure.verdict() {
            Verdict::Cancelled => {}
            Verdict::Infrastructure => {
                if let Some(ready_tasks) = self.ready.get_mut(&task.job) {
                    ready_tasks.mishaps.note(task, failure.to_string());
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

    /// Revokes the remaining leases of a task.
    fn revoke_others(&mut self, task: &TaskKey, reason: RevokeReason, out: &mut Vec<Command>) {
        let others: Vec<LeaseKey> = self.table.of_task(task).map(|(key, _)| key).collect();
        others.iter().for_each(|key| self.revoke(key, reason, out));
    }

    /// Answers a report whose lease is over: with the recorded answer if it is a repetition, otherwise with a refusal.
    fn answer_stale_report(&mut self, worker: WorkerId, task: TaskKey, epoch: Epoch, out: &mut Vec<Command>) {
        let refusal = match self.job(task.job) {
            Ok(job) if job.holds(&task, epoch) => return out.push(Command::Accept { worker, task, epoch }),
            Ok(_) => Refusal::StaleEpoch,
            Err(refusal) => refusal,
        };
        self.note_stale(task.job);
        out.push(Command::Refuse { worker, task, epoch, refusal });
    }

    fn note_seen(&mut self, worker: WorkerId, now: Tick) {
        if let Some(worker) = self.table.workers.get_mut(&worker) {
            worker.seen = now;
        }
    }

    /// Notes that the worker has completed a task whose outputs are hints for the next frame.
    fn note_hint_source(&mut self, worker: WorkerId, task: &TaskKey) {
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        let mut hints = job.spec.graph.stages.iter().flat_map(|template| &template.hints);
        if hints.any(|hint| hint.stage == task.stage.number)
            && let Some(item) = job.item(&task.stage, task.index)
            && let Some(worker) = self.table.workers.get_mut(&worker)
        {
            worker.locality.add_hint_source(task.job, task.stage.number, item);
        }
    }

    fn rest(&mut self, worker: WorkerId, trouble: Failure, now: Tick) {
        let Some(worker) = self.table.workers.get_mut(&worker) else { return };
        let rest = self.config.rest.saturating_mul(1 << worker.mishaps.min(20)).min(self.config.longest_rest);
        worker.rests_until = now.after(rest);
        worker.mishaps += 1;
        worker.trouble = Some(trouble);
    }

    /// Counts a failure as an attempt, unless another worker still holds a lease of the task.
    pub(crate) fn count_failure(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        failure: Failure,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        if let Some(worker) = self.table.workers.get_mut(&worker) {
            worker.failed += 1;
        }
        if let Some(ready_tasks) = self.ready.get_mut(&task.job) {
            ready_tasks.avoid.insert(task, worker);
            if let Some(instance) = self.table.instance(worker) {
                ready_tasks.quarantine.failed(instance, task, &self.config, now);
            }
        }
        if self.table.of_task(&task).next().is_none() {
            let until = Epoch::new(self.ledger.incarnation, self.leases);
            self.record(Fact::Failed { task, until, failure }, now, out);
            self.revoke_ended(task.job, out);
        }
    }

    fn doom(&mut self, job: JobId, failure: Failure, now: Tick, out: &mut Vec<Command>) {
        self.record(Fact::Doomed { job, failure }, now, out);
        self.revoke_ended(job, out);
        self.revoke_unwanted(out);
    }

    /// Reruns the tasks that made lost inputs. This counts as an attempt of the task that missed them, so that a store which loses
    /// everything ends the frame instead of causing reruns all night.
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
        // A copy would miss the same inputs.
        self.revoke_others(&task, RevokeReason::Expired, out);
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        let frame = task.stage.frame;
        let mut repairs = repairs(&task, job, digests);
        let key = job.content(frame);
        let shared = key.iter().flat_map(|key| self.ledger.shared_by(key));
        let lost = shared.filter(|(_, _, shared)| digests.iter().any(|digest| shared.made_by(digest).next().is_some()));
        repairs.extend(lost.map(|(_, job, _)| Fact::Restarted { job, frame: Stage::OF_JOB }));
        self.count_failure(worker, task, failure, now, out);
        let is_open = self.ledger.jobs.get(&task.job).is_some_and(|job| job.is_open(frame));
        if is_open {
            for repair in repairs {
                let others = if let Fact::Restarted { job, .. } = &repair { Some(*job) } else { None };
                self.record(repair, now, out);
                others.into_iter().for_each(|job| self.rebuild(job));
            }
            if self.ledger.jobs.get(&task.job).is_some_and(|job| !job.is_open(frame)) {
                self.revoke_frame(task.job, frame, out);
                self.revoke_ended(task.job, out);
            }
        }
    }

    /// Restarts the finished frames that have lost this result, whatever the state of their job, because their records are no
    /// longer true. Lost inputs of tasks are handled when a task misses them.
    pub(crate) fn lost(&mut self, digest: &Digest, now: Tick, out: &mut Vec<Command>) {
        let frames = self.ledger.jobs.iter().flat_map(|(&id, job)| job.made_by(digest).map(move |frame| (id, frame)));
        for (job, frame) in frames.collect::<Vec<_>>() {
            self.record(Fact::Restarted { job, frame }, now, out);
            self.rebuild(job);
            out.push(Command::Changed(job));
        }
    }

    /// Revokes the leases of a frame that restarts: they belong to another round.
    pub(crate) fn revoke_frame(&mut self, job: JobId, frame: u32, out: &mut Vec<Command>) {
        let leases = self.table.of_job(job).map(|(key, _)| key);
        let leases: Vec<LeaseKey> = leases.filter(|(task, _)| task.stage.frame == frame).collect();
        for key in leases {
            self.revoke(&key, RevokeReason::Expired, out);
            if let Some(ready_tasks) = self.ready.get_mut(&job) {
                ready_tasks.quarantine.released(&key.0);
            }
        }
    }
}

/// Returns the facts that make the lost inputs of a task again.
fn repairs(task: &TaskKey, job: &Job, lost: &[Digest]) -> Vec<Fact> {
    let (id, frame, shape) = (task.job, task.stage.frame, job.shape(task.stage.frame));
    let again = |(round, number), index| {
        let stage = Stage { frame, round, number, kind: shape.template(number)?.kind };
        Some(Fact::Lost { task: TaskKey { job: id, stage, index } })
    };
    let own = job.units.get(&frame).map(|unit| unit.producers(lost)).unwrap_or_default();
    let own = own.into_iter().filter_map(|(place, first)| again(place, first));
    if frame != Stage::OF_JOB {
        return own.collect();
    }
    let others = lost.iter().flat_map(|digest| job.made_by(digest)).map(|frame| Fact::Restarted { job: id, frame });
    own.chain(others).collect()
}

/// Checks that a result fits its task: all required outputs and no other, its units of work, and a decision if it closes a loop.
fn is_sound(job: &Job, stage: &Stage, units: u64, result: &TaskResult) -> bool {
    let shape = job.shape(stage.frame);
    let Some(template) = shape.template(stage.number) else { return false };
    let outputs = &result.outputs;
    let has = |outputs: &[Output], role: Role| outputs.iter().any(|output| output.role == role);
    let is_known = |(place, output): (usize, &Output)| {
        template.makes.contains(&output.role) && !has(&outputs[..place], output.role)
    };
    let goes_on = match (&result.decision, template.closes) {
        (None, None) => shape.graph.is_looped(stage.number) && shape.may_go_on(stage.round),
        (Some(Decision::Done), Some(_)) => false,
        (Some(Decision::Continue), Some(_)) if shape.may_go_on(stage.round) => true,
        (Some(Decision::Steps(steps)), Some(_)) if shape.may_go_on(stage.round) && are_steps(&shape, steps) => true,
        _ => return false,
    };
    let fits = |role: &Role| match is_output_required(&shape, stage.number, template, *role, goes_on) {
        Some(true) => has(outputs, *role),
        Some(false) => !has(outputs, *role),
        None => true,
    };
    result.outputs.len() <= TaskResult::MAX_OUTPUTS
        && outputs.iter().enumerate().all(is_known)
        && template.makes.iter().all(fits)
        && result.units == if template.kind.is_cut() { units } else { 0 }
}

/// Returns whether an output is required or forbidden; `None`: it is optional.
/// - `goes_on`: whether another round follows, or may follow if that is not decided yet.
fn is_output_required(shape: &Shape<'_>, number: u16, template: &Template, role: Role, goes_on: bool) -> Option<bool> {
    let readers = || shape.graph.readers(number).filter(|(_, need)| need.role == role);
    let is_before = |(_, need): (u16, &Need)| need.round == Round::Before;
    if readers().any(is_before) {
        // An output that is also read after the loop is required in every round.
        return (goes_on || !readers().all(is_before)).then_some(true);
    }
    if role.row().is_optional && !goes_on {
        return None;
    }
    // Outputs for stages after the loop, or for people, are made by the task that ends the loop.
    Some(!(template.closes.is_some() && goes_on))
}

/// Checks that these can be the steps at the end of a round: one number for each task, at most that planned for the last round.
fn are_steps(shape: &Shape<'_>, steps: &[u32]) -> bool {
    let main = shape.graph.of(shape.scope).find(|(_, template)| template.kind.is_cut()).map(|(_, template)| template);
    let most = main.and_then(|template| template.steps.last().copied()).unwrap_or(0);
    main.is_some_and(|template| steps.len() == template.tasks() as usize) && steps.iter().all(|&it| it <= most)
}
