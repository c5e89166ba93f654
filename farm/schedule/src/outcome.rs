//! Outcomes of attempts: a result or a failure, counted once and only under a lease that holds.

use femc_model::{
    Decision, Digest, Epoch, Failure, FailureVerdict, JobId, LeaseEnding, Need, Output, Refusal, RevokeReason, Role,
    Round, Stage, StageTemplate, TaskKey, TaskResult, Tick, WorkerId,
};

use crate::attempts::ResultSummary;
use crate::lease_table::LeaseKey;
use crate::ledger::{GraphView, Job};
use crate::scheduler::Scheduler;
use crate::{Command, Fact};

impl Scheduler {
    pub(crate) fn handle_completed(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        epoch: Epoch,
        result: TaskResult,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        self.record_message(worker, now);
        self.record_alive(worker, now, out);
        let Some(lease) = self.table.lease_held_by(worker, &task, epoch) else {
            return self.answer_stale_report(worker, task, epoch, out);
        };
        let (granted, size, end) = (lease.granted, lease.size, lease.run(&task).end);
        let (seconds, summary) = (result.seconds, ResultSummary::from_result(&result));
        let job = self.ledger.jobs.get(&task.job);
        if !job.is_some_and(|job| is_valid_result(job, &task.stage, size.units, &result)) {
            let message = "the result does not fit the task".to_owned();
            let refusal = Refusal::Invalid { field: "result".into(), message: message.clone() };
            return self.reject_result(worker, (task, epoch), Failure::Panicked { message }, refusal, now, out);
        }
        let round = job.and_then(|job| job.unfinished.get(&task.stage.frame)).map_or(0, |progress| progress.round);
        let fact = Fact::Done { task, end, epoch, leased: granted, result: Box::new(result) };
        let has_no_copies = self.table.copies.is_empty();
        if let Some(lease) = self.release_lease(&(task, epoch)) {
            self.record_lease_end(&(task, epoch), &lease, LeaseEnding::Done, summary, out);
        }
        // The worker measured the time, and a lease may have waited for its turn. The time since the grant is an upper bound.
        let taken = ((seconds.max(0.0) * 1000.0) as u64).min(now.since(granted));
        self.update_pace(&task, size, taken);
        if let Some(worker) = self.table.workers.get_mut(&worker) {
            worker.completed += 1;
            worker.infrastructure_failures = 0;
            worker.last_infrastructure_failure = None;
        }
        self.record_hint_source(worker, &task);
        self.note_build(task.job, task.stage.frame, worker, now, out);
        let samples = summary.samples();
        self.record_fact(fact, now, out);
        self.meter_task(&task, samples);
        if !has_no_copies {
            self.revoke_task_leases(&task, RevokeReason::Done, out);
        }
        self.revoke_ended(task.job, out);
        let instance = self.table.instance(worker);
        if let (Some(ready_tasks), Some(job)) = (self.ready.get_mut(&task.job), self.ledger.jobs.get(&task.job)) {
            ready_tasks.last_failed_on.remove(&task);
            ready_tasks.infrastructure_failures.remove(&task);
            instance.into_iter().for_each(|instance| ready_tasks.quarantine.record_success(instance));
            ready_tasks.update_after(&task, round, job, &self.table);
        }
        self.update_order(task.job);
        out.push(Command::Accept { worker, task, epoch });
        out.push(Command::JobChanged(task.job));
    }

    pub(crate) fn handle_failed(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        epoch: Epoch,
        failure: Failure,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        self.record_message(worker, now);
        self.end_failed_attempt(worker, (task, epoch), failure, Command::Accept { worker, task, epoch }, now, out);
    }

    /// Counts an invalid result as a failure, and refuses the worker's report.
    pub(crate) fn reject_result(
        &mut self,
        worker: WorkerId,
        (task, epoch): LeaseKey,
        failure: Failure,
        refusal: Refusal,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        self.record_message(worker, now);
        let answer = Command::Refuse { worker, task, epoch, refusal };
        self.end_failed_attempt(worker, (task, epoch), failure, answer, now, out);
    }

    fn end_failed_attempt(
        &mut self,
        worker: WorkerId,
        (task, epoch): LeaseKey,
        failure: Failure,
        answer: Command,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        if self.table.lease_held_by(worker, &task, epoch).is_none() {
            return self.answer_stale_report(worker, task, epoch, out);
        }
        if let Some(lease) = self.release_lease(&(task, epoch)) {
            let ending = if failure == Failure::Cancelled { LeaseEnding::Cancelled } else { LeaseEnding::Failed };
            self.record_lease_end(&(task, epoch), &lease, ending, ResultSummary::default(), out);
        }
        match failure.verdict() {
            FailureVerdict::Cancelled => {}
            FailureVerdict::Infrastructure => {
                if let Some(ready_tasks) = self.ready.get_mut(&task.job) {
                    ready_tasks.infrastructure_failures.insert(task, failure.to_string());
                }
                self.back_off(worker, failure, now);
            }
            FailureVerdict::Retry => self.count_failure(worker, task, failure, now, out),
            FailureVerdict::Fatal => self.fail_job(task.job, failure, now, out),
            FailureVerdict::Rebuild(digests) => self.rebuild_inputs(worker, task, &digests, failure, now, out),
        }
        self.refresh_task(&task);
        out.push(answer);
        out.push(Command::JobChanged(task.job));
    }

    /// Revokes the remaining leases of a task.
    fn revoke_task_leases(&mut self, task: &TaskKey, reason: RevokeReason, out: &mut Vec<Command>) {
        let others: Vec<LeaseKey> = self.table.leases_of_task(task).map(|(key, _)| key).collect();
        others.iter().for_each(|key| self.revoke_lease(key, reason, out));
    }

    /// Answers a report whose lease is over: with the recorded answer if it is a repetition, otherwise with a refusal.
    fn answer_stale_report(&mut self, worker: WorkerId, task: TaskKey, epoch: Epoch, out: &mut Vec<Command>) {
        let refusal = match self.job(task.job) {
            Ok(job) if job.has_completion(&task, epoch) => return out.push(Command::Accept { worker, task, epoch }),
            Ok(_) => Refusal::StaleEpoch,
            Err(refusal) => refusal,
        };
        self.count_stale(task.job);
        out.push(Command::Refuse { worker, task, epoch, refusal });
    }

    fn record_message(&mut self, worker: WorkerId, now: Tick) {
        if let Some(worker) = self.table.workers.get_mut(&worker) {
            worker.last_message = now;
        }
    }

    /// Notes that the worker has completed a task whose outputs are hints for the next frame.
    fn record_hint_source(&mut self, worker: WorkerId, task: &TaskKey) {
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        let mut hints = job.spec.graph.stages.iter().flat_map(|template| &template.hints);
        if hints.any(|hint| hint.stage == task.stage.number)
            && let Some(item) = job.task_of_key(&task.stage, task.index)
            && let Some(worker) = self.table.workers.get_mut(&worker)
        {
            worker.locality.add_hint_source(task.job, task.stage.number, item);
        }
    }

    fn back_off(&mut self, worker: WorkerId, failure: Failure, now: Tick) {
        let Some(worker) = self.table.workers.get_mut(&worker) else { return };
        let back_off = self
            .config
            .back_off
            .saturating_mul(1 << worker.infrastructure_failures.min(20))
            .min(self.config.max_back_off);
        worker.back_off_until = now.after(back_off);
        worker.infrastructure_failures += 1;
        worker.last_infrastructure_failure = Some(failure);
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
            ready_tasks.last_failed_on.insert(task, worker);
            if let Some(instance) = self.table.instance(worker) {
                ready_tasks.quarantine.record_failure(instance, task, &self.config, now);
            }
        }
        if self.table.leases_of_task(&task).next().is_none() {
            let until = Epoch::new(self.ledger.incarnation, self.granted_leases);
            self.record_fact(Fact::Failed { task, until, failure }, now, out);
            self.revoke_ended(task.job, out);
        }
    }

    fn fail_job(&mut self, job: JobId, failure: Failure, now: Tick, out: &mut Vec<Command>) {
        self.record_fact(Fact::JobFailed { job, failure }, now, out);
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
            return self.fail_job(task.job, failure, now, out);
        }
        // A copy would miss the same inputs.
        self.revoke_task_leases(&task, RevokeReason::Expired, out);
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        let frame = task.stage.frame;
        let mut facts = repair_facts(&task, job, digests);
        let key = job.content_key(frame);
        let shared = key.iter().flat_map(|key| self.ledger.shared_jobs_of(key));
        let lost = shared
            .filter(|(_, _, shared)| digests.iter().any(|digest| shared.frames_with_artifact(digest).next().is_some()));
        facts.extend(lost.map(|(_, job, _)| Fact::Restarted { job, frame: Stage::JOB_FRAME }));
        self.count_failure(worker, task, failure, now, out);
        let is_open = self.ledger.jobs.get(&task.job).is_some_and(|job| job.is_open(frame));
        if is_open {
            for repair in facts {
                let others = if let Fact::Restarted { job, .. } = &repair { Some(*job) } else { None };
                self.record_fact(repair, now, out);
                others.into_iter().for_each(|job| self.rebuild_ready(job));
            }
            if self.ledger.jobs.get(&task.job).is_some_and(|job| !job.is_open(frame)) {
                self.revoke_frame(task.job, frame, out);
                self.revoke_ended(task.job, out);
            }
        }
    }

    /// Restarts the finished frames that have lost this result, whatever the state of their job, because their records are no
    /// longer true. Lost inputs of tasks are handled when a task misses them.
    pub(crate) fn handle_lost_artifact(&mut self, digest: &Digest, now: Tick, out: &mut Vec<Command>) {
        let frames = self
            .ledger
            .jobs
            .iter()
            .flat_map(|(&id, job)| job.frames_with_artifact(digest).map(move |frame| (id, frame)));
        for (job, frame) in frames.collect::<Vec<_>>() {
            self.record_fact(Fact::Restarted { job, frame }, now, out);
            self.rebuild_ready(job);
            out.push(Command::JobChanged(job));
        }
    }

    /// Revokes the leases of a frame that restarts: they belong to another round.
    pub(crate) fn revoke_frame(&mut self, job: JobId, frame: u32, out: &mut Vec<Command>) {
        let leases = self.table.leases_of_job(job).map(|(key, _)| key);
        let leases: Vec<LeaseKey> = leases.filter(|(task, _)| task.stage.frame == frame).collect();
        for key in leases {
            self.revoke_lease(&key, RevokeReason::Expired, out);
            if let Some(ready_tasks) = self.ready.get_mut(&job) {
                ready_tasks.quarantine.record_release(&key.0);
            }
        }
    }
}

/// Returns the facts that make the lost inputs of a task again.
fn repair_facts(task: &TaskKey, job: &Job, lost: &[Digest]) -> Vec<Fact> {
    let (id, frame, view) = (task.job, task.stage.frame, job.graph_view(task.stage.frame));
    let lost_task = |(round, number), index| {
        let stage = Stage { frame, round, number, kind: view.template(number)?.kind };
        Some(Fact::OutputsLost { task: TaskKey { job: id, stage, index } })
    };
    let own = job.unfinished.get(&frame).map(|progress| progress.producers(lost)).unwrap_or_default();
    let own = own.into_iter().filter_map(|(stage_round, first)| lost_task(stage_round, first));
    if frame != Stage::JOB_FRAME {
        return own.collect();
    }
    let others =
        lost.iter().flat_map(|digest| job.frames_with_artifact(digest)).map(|frame| Fact::Restarted { job: id, frame });
    own.chain(others).collect()
}

/// Checks that a result fits its task: all required outputs and no other, its units of work, and a decision if it closes a loop.
fn is_valid_result(job: &Job, stage: &Stage, units: u64, result: &TaskResult) -> bool {
    let view = job.graph_view(stage.frame);
    let Some(template) = view.template(stage.number) else { return false };
    let outputs = &result.outputs;
    let has = |outputs: &[Output], role: Role| outputs.iter().any(|output| output.role == role);
    let is_known = |(index, output): (usize, &Output)| {
        template.outputs.contains(&output.role) && !has(&outputs[..index], output.role)
    };
    let continues = match (&result.decision, template.closes) {
        (None, None) => view.graph.is_looped(stage.number) && view.may_continue(stage.round),
        (Some(Decision::Done), Some(_)) => false,
        (Some(Decision::Continue), Some(_)) if view.may_continue(stage.round) => true,
        (Some(Decision::Steps(steps)), Some(_)) if view.may_continue(stage.round) && are_valid_steps(&view, steps) => {
            true
        }
        _ => return false,
    };
    let fits = |role: &Role| match is_output_required(&view, stage.number, template, *role, continues) {
        Some(true) => has(outputs, *role),
        Some(false) => !has(outputs, *role),
        None => true,
    };
    result.outputs.len() <= TaskResult::MAX_OUTPUTS
        && outputs.iter().enumerate().all(is_known)
        && template.outputs.iter().all(fits)
        && result.units == if template.kind.is_divided() { units } else { 0 }
}

/// Returns whether an output is required or forbidden; `None`: it is optional.
/// - `continues`: whether another round follows, or may follow if that is not decided yet.
fn is_output_required(
    view: &GraphView<'_>,
    number: u16,
    template: &StageTemplate,
    role: Role,
    continues: bool,
) -> Option<bool> {
    let readers = || view.graph.readers(number).filter(|(_, need)| need.role == role);
    let is_before = |(_, need): (u16, &Need)| need.round == Round::Previous;
    if readers().any(is_before) {
        // An output that is also read after the loop is required in every round.
        return (continues || !readers().all(is_before)).then_some(true);
    }
    if role.properties().is_optional && !continues {
        return None;
    }
    // Outputs for stages after the loop, or for people, are made by the task that ends the loop.
    Some(!(template.closes.is_some() && continues))
}

/// Checks that these can be the steps at the end of a round: one number for each task, at most that planned for the last round.
fn are_valid_steps(view: &GraphView<'_>, steps: &[u32]) -> bool {
    let main =
        view.graph.stages_of(view.scope).find(|(_, template)| template.kind.is_divided()).map(|(_, template)| template);
    let most = main.and_then(|template| template.steps.last().copied()).unwrap_or(0);
    main.is_some_and(|template| steps.len() == template.tasks() as usize) && steps.iter().all(|&it| it <= most)
}
