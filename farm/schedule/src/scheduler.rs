//! The state machine: handles events, and leases ready tasks to workers with room.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{
    Cut, Digest, Ending, Epoch, Failure, HeldLease, Intake, JobId, JobSpec, Refusal, Registration, RevokeReason,
    TaskKey, TaskProgress, Tick, Usage, WorkerId,
};

use crate::attempts::Counted;
use crate::builds::{Orphans, is_of_other_build};
use crate::deaths::Deaths;
use crate::lease_table::{Lease, LeaseKey, LeaseTable, Worker};
use crate::ledger::{Job, Unit};
use crate::logs::Shelf;
use crate::meter::Meter;
use crate::order::Order;
use crate::ready_tasks::ReadyTasks;
use crate::shared::Content;
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
    pub(crate) order: Order,
    /// Jobs that may run and have ready join tasks.
    pub(crate) joinable: BTreeSet<JobId>,
    /// Number of leases granted in this incarnation.
    pub(crate) leases: u64,
    pub(crate) stale_messages: u64,
    pub(crate) logs: Shelf,
    /// Reported usage of a lease whose outcome is about to arrive.
    pub(crate) reported_usage: Option<(LeaseKey, Usage)>,
    /// Usage by owner that is not durable yet.
    pub(crate) meter: Meter,
    /// Time of the present event.
    pub(crate) now: Tick,
    pub(crate) orphans: Orphans,
    /// Shared jobs that no worker could continue, with the time since when.
    pub(crate) unattended: BTreeMap<JobId, Tick>,
    pub(crate) deaths: Deaths,
    /// Time of the next check of ended jobs.
    pub(crate) looks_from: Tick,
    /// Time from which used time is made durable next.
    pub(crate) shares_from: Tick,
    /// Time before which nothing is dispatched and no lease expires: after a restart the workers reconnect one by one, with the
    /// tasks that they still work on.
    pub(crate) deals_from: Tick,
}

impl Scheduler {
    /// Resumes from `ledger`: leased tasks are ready again. Returns also the fact that must be durable before anything else is
    /// done.
    pub fn new(config: Config, mut ledger: Ledger) -> (Self, Fact) {
        let opened = Fact::Opened { incarnation: ledger.incarnation + 1 };
        let now = ledger.now();
        ledger.apply(&opened, now);
        let mut scheduler = Self {
            config,
            table: LeaseTable::default(),
            ready: BTreeMap::new(),
            order: Order::new(ledger.side.used()),
            joinable: BTreeSet::new(),
            leases: 0,
            stale_messages: 0,
            logs: Shelf::default(),
            reported_usage: None,
            meter: Meter::default(),
            now,
            orphans: Orphans::default(),
            unattended: BTreeMap::new(),
            deaths: Deaths::of(&ledger),
            looks_from: Tick(0),
            shares_from: now.after(Self::NOTE_SHARES),
            deals_from: Tick(0),
            ledger,
        };
        for (id, job) in scheduler.ledger.of_people().filter(|(_, job)| job.is_runnable()) {
            scheduler.order.put(id, job.spec.priority, &job.spec.owner);
        }
        let jobs: Vec<JobId> = scheduler.ledger.jobs.keys().copied().collect();
        jobs.into_iter().for_each(|job| scheduler.rebuild(job));
        if scheduler.order.jobs().next().is_some() {
            scheduler.deals_from = now.after(scheduler.config.regroup);
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
    pub fn cut(&self, job: JobId) -> Cut {
        self.ledger.jobs.get(&job).map_or(Cut::Whole, Job::cut)
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
        self.ledger.of_people().filter_map(|(id, _)| Some((id, self.end_to_announce(id)?))).collect()
    }

    /// Handles `event` at time `now`, which must not decrease. Returns the commands that follow.
    pub fn on(&mut self, event: Event, now: Tick) -> Vec<Command> {
        let mut out = Vec::new();
        self.hear(event, now, &mut out);
        out
    }

    /// Handles an event like [`Self::on`], and appends the commands to `out`.
    pub fn hear(&mut self, event: Event, now: Tick, out: &mut Vec<Command>) {
        self.now = now;
        let is_time = event == Event::Elapsed;
        let makes_room = !matches!(event, Event::Usage { .. });
        self.take(event, now, out);
        self.count_deaths(now, out);
        if makes_room {
            self.deal(now, out);
        }
        if is_time {
            self.speculate(now, out);
        }
        if self.order.is_leveled() || (is_time && now >= self.shares_from) {
            self.note_shares(now, out);
            self.note_usage(now, out);
        }
    }

    fn take(&mut self, event: Event, now: Tick, out: &mut Vec<Command>) {
        match event {
            Event::Submitted { request, key, spec, date } => {
                let answer = self.submit(key, spec, date, now, out);
                out.push(Command::Answer { request, answer });
            }
            Event::Controlled { request, job, control } => {
                let answer = self.control(job, control, now, out);
                out.push(Command::Answer { request, answer });
            }
            Event::Joined { worker, registration } => self.join(worker, registration, now, out),
            Event::Left { worker } => {
                self.presume_death(worker, |_| true, now);
                self.leave(worker, out);
            }
            Event::Draining { worker } => self.wish(worker, Intake::Off),
            Event::Available { worker } => self.wish(worker, Intake::Open),
            Event::Drained { worker, drain } => self.drained(worker, drain, now, out),
            Event::Heartbeat { worker, tasks } => self.heartbeat(worker, &tasks, now, out),
            Event::Logged { worker, task, epoch, log } => self.logged(worker, task, epoch, log, now, out),
            Event::Completed { worker, task, epoch, result } => self.completed(worker, task, epoch, result, now, out),
            Event::ArtifactMissing { worker, task, epoch, artifact, message } => {
                let (failure, refusal) = (Failure::Store { message }, Refusal::NoSuchArtifact { digest: artifact });
                self.refused(worker, task, epoch, failure, refusal, now, out);
            }
            Event::Failed { worker, task, epoch, failure } => self.failed(worker, task, epoch, failure, now, out),
            Event::Lost { digest } => self.lost(&digest, now, out),
            Event::Usage { worker, usage } => self.usage(worker, usage, now, out),
            Event::Announced { job, ended } => {
                if self.end_to_announce(job) == Some(ended) {
                    self.record(Fact::Announced { job, ended }, now, out);
                }
            }
            Event::Month(month) => self.month(month, now, out),
            Event::Elapsed => self.elapsed(now, out),
            Event::LoopStalled => self.loop_stalled(now),
        }
    }

    fn join(&mut self, worker: WorkerId, mut registration: Registration, now: Tick, out: &mut Vec<Command>) {
        let held = std::mem::take(&mut registration.held);
        let died = registration.died.take();
        let instances = [Some(registration.instance), died.as_ref().map(|death| death.instance)];
        let same =
            |(&id, known): (&WorkerId, &Worker)| instances.contains(&Some(known.registration.instance)).then_some(id);
        let before: Vec<WorkerId> = self.table.workers.iter().filter_map(same).collect();
        self.table.join(worker, registration, now);
        self.note_intake(worker);
        self.note_alive(worker, now, out);
        let held: Vec<HeldLease> = held.into_iter().filter(|held| !self.take_over(held, worker, now)).collect();
        for before in before {
            self.leave(before, out);
            out.push(Command::Dismiss { worker: before });
        }
        if let Some(death) = died {
            self.report_death(worker, &death, now, out);
        }
        self.avoid_after_death(worker);
        for held in held {
            let HeldLease { task, epoch, .. } = held;
            let is_of_other_build = is_of_other_build(&self.ledger, &self.table, task.job, task.stage.frame, worker);
            if let Some(run) = self.adoptable(&held, worker).filter(|_| !is_of_other_build) {
                let units = self.units_of(&task, &run);
                self.hand_out((task, epoch), &run, units, worker, now);
                out.push(Command::Changed(task.job));
            } else {
                self.note_stale(task.job);
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
    fn adoptable(&mut self, held: &HeldLease, worker: WorkerId) -> Option<Range<u32>> {
        let (task, run) = (&held.task, self.run_of(held)?);
        let job = self.ledger.jobs.get(&task.job)?;
        let is_over = |unit: &Unit| unit.is_over_for(&task.stage, task.index, held.epoch);
        let engine = &self.table.workers.get(&worker)?.registration.engine;
        if !matches!(self.content(task.job, job, &task.stage, engine), Content::There) {
            return None;
        }
        if job.has_ended() || !job.is_open(task.stage.frame) || job.units.get(&task.stage.frame).is_some_and(is_over) {
            return None;
        }
        let ready_tasks = self.ready.entry(task.job).or_default();
        ready_tasks.refresh(task.job, job, task.stage.frame, &self.table);
        ready_tasks.is_ready(task, &run).then_some(run)
    }

    fn leave(&mut self, worker: WorkerId, out: &mut Vec<Command>) {
        let held = self.table.held(worker).into_iter();
        let leases: Vec<(LeaseKey, Lease)> =
            held.filter_map(|key| Some((key, self.table.leases.get(&key)?.clone()))).collect();
        leases.iter().for_each(|(key, lease)| self.note(key, lease, Ending::Lost, Counted::default(), out));
        for (key, _) in &leases {
            self.release(key);
        }
        self.table.leave(worker);
        for ((task, _), _) in leases {
            self.put_back(&task);
            out.push(Command::Changed(task.job));
        }
    }

    fn heartbeat(&mut self, worker: WorkerId, tasks: &[TaskProgress], now: Tick, out: &mut Vec<Command>) {
        self.note_alive(worker, now, out);
        for (task, epoch) in self.table.renew(worker, tasks, &self.config, now) {
            self.note_stale(task.job);
            out.push(Command::Revoke { worker, task, epoch, reason: RevokeReason::Expired });
        }
    }

    /// Pauses dispatch as after a restart. Does not do so again within a lease's duration, so that a coordinator that stalls all
    /// the time makes progress.
    fn loop_stalled(&mut self, now: Tick) {
        if now >= self.deals_from.after(self.config.lease) {
            self.deals_from = now.after(self.config.regroup);
        }
    }

    fn elapsed(&mut self, now: Tick, out: &mut Vec<Command>) {
        if now < self.deals_from {
            return;
        }
        let expired = self.table.expired(now);
        let holders = expired.iter().filter_map(|key| Some(self.table.leases.get(key)?.worker));
        let silent: BTreeSet<WorkerId> = holders.filter(|&it| self.table.is_silent(it, &self.config, now)).collect();
        for worker in silent {
            self.presume_death(worker, |key| expired.contains(key), now);
        }
        for key in expired {
            let (task, stalled) = (key.0, self.table.stalled(&key, &self.config, now));
            self.revoke(&key, RevokeReason::Expired, out);
            if let Some((worker, seconds)) = stalled {
                self.count_failure(worker, task, Failure::Stalled { seconds }, now, out);
            }
            self.put_back(&task);
            out.push(Command::Changed(task.job));
        }
        let running: Vec<JobId> = self.order.jobs().collect();
        for id in running {
            if self.ready.get(&id).is_some_and(|ready_tasks| ready_tasks.rate.is_due(now)) {
                let samples = self.units(id);
                if let Some(ready_tasks) = self.ready.get_mut(&id) {
                    ready_tasks.rate.note(now, samples);
                }
            }
        }
        self.restart_orphans(now, out);
        self.forget_ended(now, out);
        self.revoke_unwanted(out);
        self.forget_shared(now, out);
    }

    /// Applies a fact. It becomes durable before its consequences are reported to anyone.
    pub(crate) fn record(&mut self, fact: Fact, now: Tick, out: &mut Vec<Command>) {
        let released = self.ledger.apply(&fact, now);
        let job = match &fact {
            Fact::Failed { task, .. } | Fact::Died { task, .. } | Fact::Done { task, .. } | Fact::Lost { task } => {
                Some(task.job)
            }
            Fact::Doomed { job, .. } => Some(*job),
            _ => None,
        };
        if job.filter(|job| job.is_shared()).is_some_and(|job| self.ledger.jobs.get(&job).is_some_and(Job::is_stuck)) {
            // The frames that wait for this shared job are now blocked.
            self.rebuild_all();
        }
        out.push(Command::Record(fact));
        if !released.is_empty() {
            out.push(Command::Discard(released));
        }
    }

    /// Revokes a lease and notifies its worker.
    pub(crate) fn revoke(&mut self, key: &LeaseKey, reason: RevokeReason, out: &mut Vec<Command>) {
        if let Some(lease) = self.release(key) {
            let ending = match reason {
                RevokeReason::JobEnded => Ending::Cancelled,
                RevokeReason::Expired | RevokeReason::Done => Ending::Revoked,
            };
            self.note(key, &lease, ending, Counted::default(), out);
            out.push(Command::Revoke { worker: lease.worker, task: key.0, epoch: key.1, reason });
        }
    }

    /// Rederives the ready tasks of the task's frame, including the task itself if it is still wanted.
    pub(crate) fn put_back(&mut self, task: &TaskKey) {
        let Some(job) = self.ledger.jobs.get(&task.job) else { return };
        let ready_tasks = self.ready.entry(task.job).or_default();
        if self.table.of_task(task).next().is_none() {
            ready_tasks.quarantine.released(task);
        }
        ready_tasks.refresh(task.job, job, task.stage.frame, &self.table);
        self.reorder(task.job);
    }

    /// Rederives the ready tasks of a job.
    pub(crate) fn rebuild(&mut self, id: JobId) {
        let Some(job) = self.ledger.jobs.get(&id) else { return };
        self.ready.entry(id).or_default().rebuild(id, job, &self.table);
        self.reorder(id);
    }

    /// Notes whether a job has ready join tasks. Call it after its ready tasks or its state have changed.
    pub(crate) fn note_joinable(&mut self, id: JobId) {
        let may_run = self.ledger.jobs.get(&id).is_some_and(Job::is_runnable);
        if may_run && self.ready.get(&id).is_some_and(|ready_tasks| ready_tasks.open.can_join()) {
            self.joinable.insert(id);
        } else {
            self.joinable.remove(&id);
        }
    }

    /// Adds the job to the order of service, or removes it.
    pub(crate) fn reorder(&mut self, id: JobId) {
        self.note_joinable(id);
        let Some(job) = self.ledger.jobs.get(&id) else { return };
        if job.is_runnable() && job.shared.is_none() {
            self.order.insert(id, job.spec.priority, &job.spec.owner);
        } else {
            self.order.remove(id);
        }
    }

    pub(crate) fn note_stale(&mut self, job: JobId) {
        self.stale_messages += 1;
        if let Some(ready_tasks) = self.ready.get_mut(&job) {
            ready_tasks.stale_messages += 1;
        }
    }

    pub(crate) fn job(&self, id: JobId) -> Result<&Job, Refusal> {
        self.ledger.jobs.get(&id).ok_or(Refusal::NoSuchJob { job: id })
    }

    pub(crate) fn next_epoch(&mut self) -> Epoch {
        self.leases += 1;
        Epoch::new(self.ledger.incarnation, self.leases)
    }
}
