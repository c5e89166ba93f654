//! The state machine: handles events, and leases ready tasks to workers with room.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{
    ChunkSize, Digest, Epoch, Failure, HeldLease, Intake, JobId, JobSpec, LeaseEnding, Refusal, Registration,
    ResourceUsage, RevokeReason, TaskKey, TaskProgress, Tick, WorkerId,
};

use crate::attempts::ResultSummary;
use crate::builds::{OrphanedFrames, is_of_other_build};
use crate::deaths::PendingDeaths;
use crate::lease_table::{Lease, LeaseKey, LeaseTable, Worker};
use crate::ledger::{Job, Progress};
use crate::logs::RecentLogs;
use crate::meter::Meter;
use crate::order::ServiceOrder;
use crate::ready_tasks::ReadyTasks;
use crate::shared::ContentState;
use crate::{Command, Config, Event, Fact, Ledger};

/// The complete state of the scheduler.
#[derive(Debug, Clone)]
pub struct Scheduler {
    pub(crate) config: Config,
    pub(crate) ledger: Ledger,
    pub(crate) table: LeaseTable,
    /// Ready tasks of each job, including jobs that do not run.
    pub(crate) ready: BTreeMap<JobId, ReadyTasks>,
    /// Jobs whose tasks may be leased.
    pub(crate) order: ServiceOrder,
    /// Jobs that may run and have ready join tasks.
    pub(crate) joinable: BTreeSet<JobId>,
    /// Number of leases granted in this incarnation.
    pub(crate) granted_leases: u64,
    pub(crate) stale_messages: u64,
    pub(crate) recent_logs: RecentLogs,
    /// Reported usage of a lease whose outcome is about to arrive.
    pub(crate) reported_usage: Option<(LeaseKey, ResourceUsage)>,
    /// Usage by owner that is not durable yet.
    pub(crate) meter: Meter,
    /// Time of the present event.
    pub(crate) now: Tick,
    pub(crate) orphaned_frames: OrphanedFrames,
    /// Shared jobs that no worker could continue, with the time since when.
    pub(crate) unattended: BTreeMap<JobId, Tick>,
    pub(crate) pending_deaths: PendingDeaths,
    /// Time of the next check of ended jobs.
    pub(crate) next_retention_check: Tick,
    /// Time from which used time is made durable next.
    pub(crate) next_charge: Tick,
    /// Time before which nothing is dispatched and no lease expires: after a restart the workers reconnect one by one, with the
    /// tasks that they still work on.
    pub(crate) dispatch_from: Tick,
}

impl Scheduler {
    /// Resumes from `ledger`: leased tasks are ready again. Returns also the fact that must be durable before anything else is
    /// done.
    pub fn new(config: Config, mut ledger: Ledger) -> (Self, Fact) {
        let opened = Fact::CoordinatorStarted { incarnation: ledger.incarnation + 1 };
        let now = ledger.now();
        ledger.apply(&opened, now);
        let mut scheduler = Self {
            config,
            table: LeaseTable::default(),
            ready: BTreeMap::new(),
            order: ServiceOrder::new(ledger.side.used_times()),
            joinable: BTreeSet::new(),
            granted_leases: 0,
            stale_messages: 0,
            recent_logs: RecentLogs::default(),
            reported_usage: None,
            meter: Meter::default(),
            now,
            orphaned_frames: OrphanedFrames::default(),
            unattended: BTreeMap::new(),
            pending_deaths: PendingDeaths::from_ledger(&ledger),
            next_retention_check: Tick(0),
            next_charge: now.after(Self::CHARGE_INTERVAL),
            dispatch_from: Tick(0),
            ledger,
        };
        for (id, job) in scheduler.ledger.submitted_jobs().filter(|(_, job)| job.is_runnable()) {
            scheduler.order.insert_unleveled(id, job.spec.priority, &job.spec.owner);
        }
        let jobs: Vec<JobId> = scheduler.ledger.jobs.keys().copied().collect();
        jobs.into_iter().for_each(|job| scheduler.rebuild_ready(job));
        if scheduler.order.jobs().next().is_some() {
            scheduler.dispatch_from = now.after(scheduler.config.regroup);
        }
        (scheduler, opened)
    }

    /// Returns the configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Returns the durable half, for a snapshot.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Returns the specification of a job.
    pub fn spec(&self, job: JobId) -> Option<&JobSpec> {
        self.ledger.jobs.get(&job).map(|job| &*job.spec)
    }

    /// Returns the granularity at which a job's tasks are divided.
    pub fn chunk_size(&self, job: JobId) -> ChunkSize {
        self.ledger.jobs.get(&job).map_or(ChunkSize::Whole, Job::chunk_size)
    }

    /// Returns those of `digests` that are no longer referenced, without duplicates. Call it for many digests at a time.
    pub fn unreferenced(&self, digests: Vec<Digest>) -> Vec<Digest> {
        self.ledger.unreferenced(digests)
    }

    /// Returns the time of a job's end if the end is not announced to all recipients yet.
    pub fn end_to_announce(&self, job: JobId) -> Option<Tick> {
        self.ledger.jobs.get(&job).filter(|job| job.is_unannounced).and_then(|job| job.ended)
    }

    /// Returns the jobs whose end must be announced, each with the time of its end.
    pub fn ends_to_announce(&self) -> Vec<(JobId, Tick)> {
        self.ledger.submitted_jobs().filter_map(|(id, _)| Some((id, self.end_to_announce(id)?))).collect()
    }

    /// Handles `event` at time `now`, which must not decrease. Returns the commands that follow.
    pub fn handle(&mut self, event: Event, now: Tick) -> Vec<Command> {
        let mut out = Vec::new();
        self.handle_into(event, now, &mut out);
        out
    }

    /// Handles an event like [`Self::handle`], and appends the commands to `out`.
    pub fn handle_into(&mut self, event: Event, now: Tick, out: &mut Vec<Command>) {
        self.now = now;
        let is_time = event == Event::Elapsed;
        let makes_room = !matches!(event, Event::Usage { .. });
        self.apply_event(event, now, out);
        self.count_deaths(now, out);
        if makes_room {
            self.dispatch(now, out);
        }
        if is_time {
            self.speculate(now, out);
        }
        if self.order.take_leveled() || (is_time && now >= self.next_charge) {
            self.record_charges(now, out);
            self.record_usage(now, out);
        }
    }

    fn apply_event(&mut self, event: Event, now: Tick, out: &mut Vec<Command>) {
        match event {
            Event::Submitted { request, key, spec, date } => {
                let answer = self.submit(key, spec, date, now, out);
                out.push(Command::Answer { request, answer });
            }
            Event::Controlled { request, job, control } => {
                let answer = self.control(job, control, now, out);
                out.push(Command::Answer { request, answer });
            }
            Event::Joined { worker, registration } => self.join_worker(worker, registration, now, out),
            Event::Left { worker } => {
                self.presume_death(worker, |_| true, now);
                self.remove_worker(worker, out);
            }
            Event::Draining { worker } => self.set_wanted_intake(worker, Intake::Off),
            Event::Available { worker } => self.set_wanted_intake(worker, Intake::Open),
            Event::Drained { worker, drain } => self.set_drained(worker, drain, now, out),
            Event::Heartbeat { worker, tasks } => self.handle_heartbeat(worker, &tasks, now, out),
            Event::Logged { worker, task, epoch, log } => self.store_log(worker, task, epoch, log, now, out),
            Event::Completed { worker, task, epoch, result } => {
                self.handle_completed(worker, task, epoch, result, now, out);
            }
            Event::ArtifactMissing { worker, task, epoch, artifact, message } => {
                let (failure, refusal) = (Failure::Store { message }, Refusal::NoSuchArtifact { digest: artifact });
                self.reject_result(worker, (task, epoch), failure, refusal, now, out);
            }
            Event::Failed { worker, task, epoch, failure } => {
                self.handle_failed(worker, task, epoch, failure, now, out);
            }
            Event::ArtifactLost { digest } => self.handle_lost_artifact(&digest, now, out),
            Event::Usage { worker, usage } => self.handle_usage(worker, usage, now, out),
            Event::Announced { job, ended } => {
                if self.end_to_announce(job) == Some(ended) {
                    self.record_fact(Fact::Announced { job, ended }, now, out);
                }
            }
            Event::Month(month) => self.begin_month(month, now, out),
            Event::Elapsed => self.handle_elapsed(now, out),
            Event::CoordinatorStalled => self.handle_stall(now),
        }
    }

    fn join_worker(&mut self, worker: WorkerId, mut registration: Registration, now: Tick, out: &mut Vec<Command>) {
        let held = std::mem::take(&mut registration.held);
        let died = registration.death.take();
        let instances = [Some(registration.instance), died.as_ref().map(|death| death.instance)];
        let same_process =
            |(&id, known): (&WorkerId, &Worker)| instances.contains(&Some(known.registration.instance)).then_some(id);
        let before: Vec<WorkerId> = self.table.workers.iter().filter_map(same_process).collect();
        self.table.join(worker, registration, now);
        self.update_intake(worker);
        self.record_alive(worker, now, out);
        let held: Vec<HeldLease> = held.into_iter().filter(|held| !self.take_over(held, worker, now)).collect();
        for before in before {
            self.remove_worker(before, out);
            out.push(Command::Dismiss { worker: before });
        }
        if let Some(death) = died {
            self.handle_death_report(worker, &death, now, out);
        }
        self.avoid_after_death(worker);
        for held in held {
            let HeldLease { task, epoch, .. } = held;
            let is_of_other_build = is_of_other_build(&self.ledger, &self.table, task.job, task.stage.frame, worker);
            if let Some(run) = self.adoptable_run(&held, worker).filter(|_| !is_of_other_build) {
                let units = self.units_of(&task, &run);
                self.grant_lease((task, epoch), &run, units, worker, now);
                out.push(Command::JobChanged(task.job));
            } else {
                self.count_stale(task.job);
                out.push(Command::Revoke { worker, task, epoch, reason: RevokeReason::Expired });
            }
        }
    }

    /// Hands a lease over to the session of its worker that reports it. The lease belongs to the worker, whatever its session or
    /// process: an earlier session whose end is not known yet loses it. A lease of another farm with the same key belongs to
    /// another job, or covers other steps of the task. Returns whether there is such a lease.
    fn take_over(&mut self, held: &HeldLease, worker: WorkerId, now: Tick) -> bool {
        let key = (held.task, held.epoch);
        let runs = self.table.leases.get(&key).map(|lease| lease.run(&held.task));
        runs.is_some()
            && runs == self.run_of(held)
            && !is_of_other_build(&self.ledger, &self.table, held.task.job, held.task.stage.frame, worker)
            && self.hand_over(&key, worker, now)
    }

    /// Returns the keys of a reported lease if they are all ready: wanted, with all inputs, and not leased to others.
    fn adoptable_run(&mut self, held: &HeldLease, worker: WorkerId) -> Option<Range<u32>> {
        let (task, run) = (&held.task, self.run_of(held)?);
        let job = self.ledger.jobs.get(&task.job)?;
        let is_over = |progress: &Progress| progress.is_lease_over(&task.stage, task.index, held.epoch);
        let engine = &self.table.workers.get(&worker)?.registration.engine;
        if !matches!(self.content_state(task.job, job, &task.stage, engine), ContentState::Available) {
            return None;
        }
        if job.has_ended()
            || !job.is_open(task.stage.frame)
            || job.unfinished.get(&task.stage.frame).is_some_and(is_over)
        {
            return None;
        }
        let ready_tasks = self.ready.entry(task.job).or_default();
        ready_tasks.refresh(task.job, job, task.stage.frame, &self.table);
        ready_tasks.is_ready(task, &run).then_some(run)
    }

    fn remove_worker(&mut self, worker: WorkerId, out: &mut Vec<Command>) {
        let held = self.table.leases_of_worker(worker).into_iter();
        let leases: Vec<(LeaseKey, Lease)> =
            held.filter_map(|key| Some((key, self.table.leases.get(&key)?.clone()))).collect();
        leases.iter().for_each(|(key, lease)| {
            self.record_lease_end(key, lease, LeaseEnding::Lost, ResultSummary::default(), out);
        });
        for (key, _) in &leases {
            self.release_lease(key);
        }
        self.table.leave(worker);
        for ((task, _), _) in leases {
            self.refresh_task(&task);
            out.push(Command::JobChanged(task.job));
        }
    }

    fn handle_heartbeat(&mut self, worker: WorkerId, tasks: &[TaskProgress], now: Tick, out: &mut Vec<Command>) {
        self.record_alive(worker, now, out);
        for (task, epoch) in self.table.renew(worker, tasks, &self.config, now) {
            self.count_stale(task.job);
            out.push(Command::Revoke { worker, task, epoch, reason: RevokeReason::Expired });
        }
    }

    /// Pauses dispatch as after a restart. Does not do so again within a lease's duration, so that a coordinator that stalls all
    /// the time makes progress.
    fn handle_stall(&mut self, now: Tick) {
        if now >= self.dispatch_from.after(self.config.lease) {
            self.dispatch_from = now.after(self.config.regroup);
        }
    }

    fn handle_elapsed(&mut self, now: Tick, out: &mut Vec<Command>) {
        if now < self.dispatch_from {
            return;
        }
        let expired = self.table.expired_leases(now);
        let holders = expired.iter().filter_map(|key| Some(self.table.leases.get(key)?.worker));
        let silent: BTreeSet<WorkerId> = holders.filter(|&it| self.table.is_silent(it, &self.config, now)).collect();
        for worker in silent {
            self.presume_death(worker, |key| expired.contains(key), now);
        }
        for key in expired {
            let (task, stalled) = (key.0, self.table.find_stall(&key, &self.config, now));
            self.revoke_lease(&key, RevokeReason::Expired, out);
            if let Some((worker, seconds)) = stalled {
                self.count_failure(worker, task, Failure::Stalled { seconds }, now, out);
            }
            self.refresh_task(&task);
            out.push(Command::JobChanged(task.job));
        }
        let running: Vec<JobId> = self.order.jobs().collect();
        for id in running {
            if self.ready.get(&id).is_some_and(|ready_tasks| ready_tasks.sample_rate.is_due(now)) {
                let samples = self.units_done(id);
                if let Some(ready_tasks) = self.ready.get_mut(&id) {
                    ready_tasks.sample_rate.record(now, samples);
                }
            }
        }
        self.restart_orphans(now, out);
        self.remove_expired(now, out);
        self.revoke_unwanted(out);
        self.evict_shared(now, out);
    }

    /// Applies a fact. It becomes durable before its consequences are reported to anyone.
    pub(crate) fn record_fact(&mut self, fact: Fact, now: Tick, out: &mut Vec<Command>) {
        let released = self.ledger.apply(&fact, now);
        let job = match &fact {
            Fact::Failed { task, .. }
            | Fact::WorkerDied { task, .. }
            | Fact::Done { task, .. }
            | Fact::OutputsLost { task } => Some(task.job),
            Fact::JobFailed { job, .. } => Some(*job),
            _ => None,
        };
        if job.filter(|job| job.is_shared()).is_some_and(|job| self.ledger.jobs.get(&job).is_some_and(Job::is_stuck)) {
            // The frames that wait for this shared job are now blocked.
            self.rebuild_ready_of_contents();
        }
        out.push(Command::Record(fact));
        if !released.is_empty() {
            out.push(Command::Discard(released));
        }
    }

    /// Revokes a lease and notifies its worker.
    pub(crate) fn revoke_lease(&mut self, key: &LeaseKey, reason: RevokeReason, out: &mut Vec<Command>) {
        if let Some(lease) = self.release_lease(key) {
            let ending = match reason {
                RevokeReason::JobEnded => LeaseEnding::Cancelled,
                RevokeReason::Expired | RevokeReason::Done => LeaseEnding::Revoked,
            };
            self.record_lease_end(key, &lease, ending, ResultSummary::default(), out);
            out.push(Command::Revoke { worker: lease.worker, task: key.0, epoch: key.1, reason });
        }
    }

    /// Rederives the ready tasks of the task's frame, including the task itself if it is still wanted.
    pub(crate) fn refresh_task(&mut self, task: &TaskKey) {
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        let ready_tasks = self.ready.entry(task.job).or_default();
        if self.table.leases_of_task(task).next().is_none() {
            ready_tasks.quarantine.record_release(task);
        }
        ready_tasks.refresh(task.job, job, task.stage.frame, &self.table);
        self.update_order(task.job);
    }

    /// Rederives the ready tasks of a job.
    pub(crate) fn rebuild_ready(&mut self, id: JobId) {
        let Some(job) = self.ledger.jobs.get(&id) else { return };
        self.ready.entry(id).or_default().rebuild(id, job, &self.table);
        self.update_order(id);
    }

    /// Notes whether a job has ready join tasks. Call it after its ready tasks or its state have changed.
    pub(crate) fn update_joinable(&mut self, id: JobId) {
        let may_run = self.ledger.jobs.get(&id).is_some_and(Job::is_runnable);
        if may_run && self.ready.get(&id).is_some_and(|ready_tasks| ready_tasks.open.can_join()) {
            self.joinable.insert(id);
        } else {
            self.joinable.remove(&id);
        }
    }

    /// Adds the job to the order of service, or removes it.
    pub(crate) fn update_order(&mut self, id: JobId) {
        self.update_joinable(id);
        let Some(job) = self.ledger.jobs.get(&id) else { return };
        if job.is_runnable() && job.shared.is_none() {
            self.order.insert(id, job.spec.priority, &job.spec.owner);
        } else {
            self.order.remove(id);
        }
    }

    pub(crate) fn count_stale(&mut self, job: JobId) {
        self.stale_messages += 1;
        if let Some(ready_tasks) = self.ready.get_mut(&job) {
            ready_tasks.stale_messages += 1;
        }
    }

    pub(crate) fn job(&self, id: JobId) -> Result<&Job, Refusal> {
        self.ledger.jobs.get(&id).ok_or(Refusal::NoSuchJob { job: id })
    }

    pub(crate) fn next_epoch(&mut self) -> Epoch {
        self.granted_leases += 1;
        Epoch::new(self.ledger.incarnation, self.granted_leases)
    }
}
