//! Laws of the property test: checks of commands and states against the model.

use std::collections::{BTreeMap, BTreeSet};

use super::step::{OWNERS, Step, TAG};
use super::{Machine, TaskStep, task_steps};
use crate::common::{self, TestFarm};
use femc_model::*;
use femc_schedule::*;

impl Machine {
    pub(super) fn inputs_of(&self, (job, stage, item, _): &TaskStep, engine: &str) -> Vec<(Need, TaskStep)> {
        let graph = &self.farm.scheduler.spec(*job).unwrap().graph;
        let frames = &self.farm.scheduler.spec(*job).unwrap().frames;
        let template = graph.stage(stage.number).unwrap();
        let mut all = Vec::new();
        for need in &template.needs {
            let made = graph.stage(need.stage).unwrap();
            let of_frames = made.scope == Scope::Frame && template.scope == Scope::Job;
            let is_shared = made.scope == Scope::Content && template.scope == Scope::Frame;
            let content = || {
                let spec = self.farm.scheduler.spec(*job).unwrap();
                spec.content_key(frames.binary_search(&stage.frame).unwrap()).unwrap()
            };
            let owner = if is_shared { self.shared.get(&(content(), engine.to_owned())).copied() } else { Some(*job) };
            let Some(owner) = owner else { continue };
            let own = if is_shared { Stage::JOB_FRAME } else { stage.frame };
            let sources: Vec<u32> = if of_frames { frames.clone() } else { vec![own] };
            let counted: Vec<(u32, u32)> =
                sources.iter().flat_map(|&frame| (0..made.tasks()).map(move |task| (frame, task))).collect();
            let chosen: Vec<(u32, u32)> = match need.reach {
                Reach::All => counted,
                Reach::Same => vec![counted[*item as usize]],
                Reach::Fan(n) => counted.into_iter().skip((item * n) as usize).take(n as usize).collect(),
                Reach::Previous => item.checked_sub(1).map(|before| counted[before as usize]).into_iter().collect(),
            };
            for (frame, task) in chosen {
                let last = self.last_round(owner, frame);
                let rounds = match need.round {
                    Round::Previous => stage.round.saturating_sub(1)..stage.round,
                    Round::Every => 0..last + 1,
                    Round::Same if is_shared && !graph.is_looped(need.stage) => 0..1,
                    Round::Same
                        if of_frames
                            || is_shared
                            || (graph.is_looped(need.stage) && !graph.is_looped(stage.number)) =>
                    {
                        last..last + 1
                    }
                    Round::Same => stage.round..stage.round + 1,
                };
                for round in rounds {
                    let from = Stage { frame, round, number: need.stage, kind: made.kind };
                    let steps = self.steps(owner, &from, task);
                    all.extend(steps.map(|step| (*need, (owner, from, task, step))));
                }
            }
        }
        all
    }

    /// Checks that no task of a paused job is leased, and no task to a worker without its tags. For a shared job, checks that at
    /// least one of the jobs that share it runs and fits the worker, and that no build does a content twice.
    pub(super) fn check_may_lease(&self, worker: WorkerId, task: &TaskKey) {
        if !task.job.is_shared() {
            assert!(!self.paused.contains(&task.job), "{task} is leased, and its job stands still");
            assert!(self.is_fit_for(worker, task.job), "{task} is leased to a worker without its tags");
            assert!(
                self.has_tags(worker, &self.template(task).tags),
                "{task} is leased to a worker without its stage's"
            );
            return;
        }
        let shared = self.shared.iter().find(|(_, id)| **id == task.job);
        let ((key, engine), _) = shared.expect("it was begun");
        assert_eq!(engine, self.builds[&worker.0], "{task} is another build's");
        let waits = |job: &JobId| {
            let state = self.farm.state(*job);
            matches!(state, JobState::Queued | JobState::Running)
                && self.has_open_frame_of(*job, key)
                && self.is_fit_for(worker, *job)
        };
        assert!(self.jobs.iter().any(waits), "{task} is leased, and no job waits for it");
    }

    /// Checks whether an unfinished frame of the job has this content.
    pub(super) fn has_open_frame_of(&self, job: JobId, key: &Digest) -> bool {
        let spec = self.farm.scheduler.spec(job).unwrap();
        let finished = self.farm.scheduler.frames(job).unwrap();
        let is_open = |frame: u32| !finished.iter().any(|record| record.frame == frame);
        spec.frames
            .iter()
            .enumerate()
            .any(|(place, &frame)| spec.content_key(place).as_ref() == Some(key) && is_open(frame))
    }

    /// Checks whether a worker has all tags of a job.
    pub(super) fn is_fit_for(&self, worker: WorkerId, job: JobId) -> bool {
        self.has_tags(worker, &self.farm.scheduler.spec(job).unwrap().tags)
    }

    pub(super) fn has_tags(&self, worker: WorkerId, all: &[String]) -> bool {
        let workers = self.farm.scheduler.workers(self.farm.now);
        let tags = workers.into_iter().find(|known| known.worker == worker).map(|known| known.tags).unwrap_or_default();
        all.iter().all(|tag| tags.contains(tag))
    }

    /// Checks that all inputs of a task exist before it begins, and that it gets exactly these: where gaps are allowed, none of
    /// frames that cannot be finished.
    pub(super) fn check_inputs(&self, held: &Assignment, engine: &str) {
        let Some(step) = task_steps(held).first().copied() else { panic!("a task of nothing: {held:?}") };
        let expected = self.expected_inputs(&held.task, &step, engine);
        let given: BTreeSet<Digest> = held.spec.artifacts().map(|it| it.digest).collect();
        assert_eq!(given, expected, "the inputs of {}", held.task);
        assert_eq!(held.spec.artifacts().count(), given.len(), "{} reads one input twice", held.task);
        self.check_steps_taken(held);
    }

    /// Checks that a task which reads divided tasks gets the number of steps that each of them has taken.
    pub(super) fn check_steps_taken(&self, held: &Assignment) {
        let graph = &self.farm.scheduler.spec(held.task.job).unwrap().graph;
        let (stage, template) = (held.task.stage, self.template(&held.task));
        let Some(need) = template.needs.iter().find(|need| need.round != Round::Previous) else { return };
        let made = graph.stage(need.stage).unwrap();
        if !made.kind.is_divided() || made.scope != template.scope || template.kind.is_divided() {
            return;
        }
        let items = match need.reach {
            Reach::All => 0..made.tasks(),
            Reach::Same => held.spec.item..held.spec.item + 1,
            Reach::Fan(n) => held.spec.item * n..((held.spec.item + 1) * n).min(made.tasks()),
            Reach::Previous => held.spec.item.saturating_sub(1)..held.spec.item,
        };
        let is_behind = graph.is_looped(need.stage) && !graph.is_looped(stage.number);
        let round = if is_behind { self.last_round(held.task.job, stage.frame) } else { stage.round };
        let from = Stage { round, number: need.stage, kind: made.kind, ..stage };
        let taken: StepsTaken = items.map(|item| self.steps(held.task.job, &from, item).end).collect();
        assert_eq!(held.spec.steps_taken, taken, "what {} is told", held.task);
    }

    /// Returns the present inputs of a task.
    pub(super) fn expected_inputs(&self, task: &TaskKey, step: &TaskStep, engine: &str) -> BTreeSet<Digest> {
        let finished = |frame: u32| self.farm.scheduler.frames(step.0).unwrap().iter().any(|it| it.frame == frame);
        let mut expected = BTreeSet::new();
        for (need, step) in self.inputs_of(step, engine) {
            if step.0 == task.job && step.1.frame != task.stage.frame && !finished(step.1.frame) {
                assert!(need.gaps, "{} is given before frame {} is finished", task, step.1.frame);
                continue;
            }
            let Some((_, result)) = self.results.get(&step) else { panic!("{step:?} before {}", task) };
            expected.extend(result.output(need.role).map(|it| it.digest));
        }
        expected
    }

    pub(super) fn check(&mut self) {
        // A paused job that is done is no longer paused.
        let is_done = |job: &JobId| self.farm.scheduler.spec(*job).is_none() || self.farm.state(*job) == JobState::Done;
        self.paused = self.paused.iter().copied().filter(|job| !is_done(job)).collect();
        // Copies are granted when time passes.
        self.take_step(Step::Wait(0));
        assert_eq!(&self.farm.replay(), self.farm.scheduler.ledger(), "a replay gives the same state");
        let again = self.farm.handle(Event::Elapsed);
        assert_eq!(again, [], "dealing again changes nothing");
        for &job in &self.jobs {
            let status = self.farm.status(job);
            let is_under_way = self.farm.leases.iter().any(|(_, held)| held.task.job == job);
            let says_why = is_under_way || status.state.has_ended() || !status.waits.is_empty();
            assert!(says_why, "nothing of job {job} is under way, and it does not say why: {status:?}");
        }
        self.check_ends();
        self.check_charges();
        self.check_samples();
        self.check_stats();
        let known: BTreeSet<_> = self.farm.leases.iter().map(|(_, h)| (h.task, h.epoch)).collect();
        assert_eq!(known, self.live);
        assert!(self.live.iter().all(|(task, _)| !self.done.contains(task)), "what is done is no longer leased");
    }

    /// Checks that a job has failed if and only if one of its tasks is quarantined or it cannot succeed as a whole; that a task
    /// stays quarantined until a person retries it; and that no task of an ended job is leased.
    pub(super) fn check_ends(&mut self) {
        for &job in &self.jobs {
            let status = self.farm.status(job);
            assert_eq!(status.state == JobState::Cancelled, self.cancelled.contains(&job), "{status:?}");
            let has_reason = status.failure.is_some() || !status.quarantined.is_empty();
            assert!(status.state != JobState::Failed || has_reason, "{status:?}");
            assert!(status.state.has_ended() || status.failure.is_none(), "{status:?}");
            let blocked: BTreeSet<u32> = status.quarantined.iter().map(|one| one.task.stage.frame).collect();
            let shares = self.farm.scheduler.spec(job).unwrap().graph.has_content_stages();
            assert!(shares || status.frames_failed as usize <= blocked.len(), "{status:?}");
            let is_leased = self.live.iter().any(|(task, _)| task.job == job);
            assert!(!(status.state.has_ended() && is_leased), "job {job} has ended and is leased: {status:?}");
            let mut now: BTreeMap<TaskKey, u32> = BTreeMap::new();
            for one in &status.quarantined {
                let is_enough = if matches!(one.failure, Failure::Killed { .. }) { 5 } else { 3 };
                assert!(one.attempts >= is_enough, "{one:?}");
                // A frame that restarts keeps its quarantined tasks in its first round, so the round is ignored.
                now.insert(TaskKey { stage: Stage { round: 0, ..one.task.stage }, ..one.task }, one.attempts);
            }
            for (task, tries) in self.quarantined_tries.iter().filter(|(task, _)| task.job == job) {
                assert!(now.get(task) >= Some(tries), "{task} was tried {tries} times: {now:?}");
            }
            self.quarantined_tries.extend(now);
        }
    }

    /// Checks that every moment of a worker is charged to the owner of its oldest lease; running leases are charged with a delay.
    pub(super) fn check_charges(&self) {
        let used: BTreeMap<&str, u64> =
            self.farm.scheduler.used_times().map(|(owner, used)| (owner, used.charged)).collect();
        let served = self.farm.served_owners();
        for owner in OWNERS {
            let charged = used.get(owner).copied().unwrap_or(0);
            let held = self.farm.charged.get(owner).copied().unwrap_or(0);
            let under_way =
                if served.contains(owner) { self.workers.len() as u64 * Scheduler::CHARGE_INTERVAL } else { 0 };
            let shared = self.farm.charged.get(TestFarm::SHARED).copied().unwrap_or(0);
            let is_right = charged <= held + shared && held.saturating_sub(charged) <= under_way;
            assert!(is_right, "{owner} held {held} ms, shared {shared}, and is charged {charged}");
        }
        let (charged, held) = (used.values().sum::<u64>(), self.farm.charged.values().sum::<u64>());
        let under_way = self.workers.len() as u64 * Scheduler::CHARGE_INTERVAL;
        assert!(charged <= held && held - charged <= under_way, "{held} ms were held, and {charged} are charged");
    }

    /// Checks that a job without running leases has the sum of its results' samples, and that its frames have the sum of the
    /// results' seconds.
    pub(super) fn check_samples(&self) {
        for &job in &self.jobs {
            if self.live.iter().any(|(task, _)| task.job == job) {
                continue;
            }
            let units = self.results.keys().filter(|step| step.0 == job && step.1.kind.is_divided()).count() as u64;
            assert_eq!(self.farm.status(job).samples_done, 64 * units, "samples of job {job}");
            for record in self.farm.scheduler.frames(job).unwrap() {
                let of_it = |task: &TaskKey| (task.job, task.stage.frame) == (job, record.frame);
                let seconds = self.farm.log.iter().map(|(_, fact)| match fact {
                    Fact::Done { task, result, .. } if of_it(task) => result.seconds,
                    _ => 0.0,
                });
                let sum: f64 = seconds.sum();
                assert!((record.busy_seconds - sum).abs() < 1e-6, "{record:?}: {sum} s");
                let passed = self.farm.now.0 as f64 / 1000.0;
                assert!((0.0..=passed).contains(&record.seconds), "{record:?} after {passed} s");
            }
        }
    }

    /// Checks that the key figures are the sums over all jobs and workers, and match the model.
    pub(super) fn check_stats(&self) {
        let (scheduler, now) = (&self.farm.scheduler, self.farm.now);
        let (stats, jobs, workers) = (scheduler.stats(now), scheduler.jobs(now), scheduler.workers(now));
        for (state, count) in stats.jobs {
            assert_eq!(count, jobs.iter().filter(|job| job.state == state).count() as u64, "{state:?} jobs");
        }
        for (kind, count) in stats.leased {
            let leased = self.live.iter().filter(|(task, _)| task.stage.kind == kind).count();
            assert_eq!(count, leased as u64, "leases of {kind:?}");
        }
        let quarantined =
            jobs.iter().flat_map(|job| &job.quarantined).filter(|one| !one.task.job.is_shared()).count() as u64;
        assert!(stats.quarantined == quarantined || (stats.quarantined > quarantined && self.has_shared), "{jobs:?}");
        assert_eq!(stats.threads, workers.iter().map(|worker| u64::from(worker.threads)).sum());
        assert_eq!(stats.used, scheduler.used_times().map(|(_, used)| used.charged).sum());
        assert_eq!(stats.stale_messages, scheduler.stale_messages());
        let stale: u64 = jobs.iter().map(|job| job.stale_messages).sum();
        let is_all = scheduler.config().keep_ended.is_none() && !self.has_shared;
        assert!(stale == stats.stale_messages || !is_all, "{stale} stale messages");

        let standing = |sought| stats.workers.iter().find(|(standing, _)| *standing == sought).unwrap().1;
        let count = |is: &dyn Fn(&WorkerStatus) -> bool| workers.iter().filter(|worker| is(worker)).count() as u64;
        assert_eq!(stats.workers.iter().map(|(_, count)| count).sum::<u64>(), workers.len() as u64);
        assert_eq!(standing(WorkerStanding::Drained), count(&|worker| worker.intake == Intake::Drained));
        assert_eq!(standing(WorkerStanding::Off), count(&|worker| worker.intake == Intake::Off));
        let is_open = |worker: &WorkerStatus| worker.intake == Intake::Open;
        // A worker is fit if it is not silent and has not failed.
        let (unfit, lease) = (standing(WorkerStanding::Unfit), scheduler.config().lease);
        let may_rest = count(&|worker| {
            is_open(worker) && (self.failing_workers.contains(&worker.worker.0) || worker.silent >= lease)
        });
        assert!(unfit <= may_rest, "{unfit} unfit: {workers:?}");
        let [idle, busy] = [standing(WorkerStanding::Idle), standing(WorkerStanding::Busy)];
        assert!(idle <= count(&|worker| is_open(worker) && worker.tasks.is_empty()), "{idle} idle: {workers:?}");
        assert!(busy <= count(&|worker| is_open(worker) && !worker.tasks.is_empty()), "{busy} busy: {workers:?}");

        let is_whole = |job: &JobStatus| {
            job.frames_failed == 0
                && job.quarantined.is_empty()
                && self.live.iter().all(|(task, _)| task.job != job.job)
        };
        if jobs.iter().all(is_whole) {
            let left = |job: &JobStatus| {
                let frames = scheduler.frames(job.job).unwrap();
                let spec = scheduler.spec(job.job).unwrap();
                let is_open = |frame: &u32| !frames.iter().any(|record| record.frame == *frame);
                let open = spec.frames.iter().filter(|frame| is_open(frame)).count() as u64;
                let is_cut = |stage: &Stage| stage.kind.is_divided();
                let units = self
                    .results
                    .keys()
                    .filter(|(of, stage, ..)| *of == job.job && is_cut(stage) && is_open(&stage.frame));
                open * spec.samples_of_frame() - 64 * units.count() as u64
            };
            let run = jobs.iter().filter(|job| matches!(job.state, JobState::Queued | JobState::Running));
            assert_eq!(stats.samples_left, run.map(left).sum::<u64>(), "{jobs:?}");
        }
    }

    /// Checks that the reported ready tasks are those that new workers get: workers of each build join one after the other, until
    /// they get nothing.
    pub(super) fn check_ready(&self) {
        // A shared job that begins adds ready tasks, so jobs with contents are not checked.
        let has_content =
            |job: &JobId| self.farm.scheduler.spec(*job).is_some_and(|spec| spec.graph.has_content_stages());
        if self.jobs.iter().any(has_content) {
            return;
        }
        let ready = self.farm.scheduler.stats(self.farm.now).ready;
        let (mut scheduler, mut given) = (self.farm.scheduler.clone(), BTreeMap::<StageKind, u64>::new());
        let (mut number, mut idle) = (0, 0);
        while idle < 2 {
            number += 1;
            let engine = ["e", "f"][number as usize % 2];
            let worker = WorkerId(1_000_000 + number);
            let registration = Registration {
                name: format!("new {number}"),
                instance: worker.0,
                engine: engine.into(),
                tags: vec![TAG.to_owned()],
                ..common::registration()
            };
            let commands = scheduler.handle(Event::Joined { worker, registration }, self.farm.now);
            idle = if scheduler.leases(worker, self.farm.now).is_empty() { idle + 1 } else { 0 };
            for command in commands {
                if let Command::Assign { assignment: held, .. } = command
                    && held.copy_of.is_none()
                {
                    *given.entry(held.task.stage.kind).or_default() += 1;
                }
            }
        }
        let is_cut = self.farm.scheduler.config().chunk_size.get() < 1 << 15;
        for (kind, ready) in ready {
            let given = given.get(&kind).copied().unwrap_or(0);
            let is_right =
                if kind.is_divided() && is_cut { given <= ready && (given > 0) == (ready > 0) } else { given == ready };
            assert!(is_right, "{ready} tasks of {kind:?} are ready, and {given} are given out");
        }
    }

    /// Checks that applying a result again, immediately or at the end, changes nothing.
    pub(super) fn check_idempotence(&self) {
        let is_result = |fact: &Fact| matches!(fact, Fact::Done { .. });
        let mut ledger = Ledger::default();
        for (now, fact) in &self.farm.log {
            ledger.apply(fact, *now);
            if is_result(fact) {
                let once = ledger.clone();
                ledger.apply(fact, *now);
                assert_eq!(ledger, once, "{fact:?} counts twice");
            }
        }
        let now = ledger.now();
        let is_over = |(_, fact): &&(Tick, Fact)| match fact {
            // A lost result would count again, so only tasks that are done are checked.
            Fact::Done { task, .. } => self.done.contains(task),
            _ => false,
        };
        for (_, fact) in self.farm.log.iter().filter(is_over) {
            let once = ledger.clone();
            ledger.apply(fact, now);
            assert_eq!(ledger, once, "{fact:?} counts again at the end");
        }
    }

    /// Checks that the own stages of a finished job were made from all its frames.
    pub(super) fn check_made_of_all(&self, job: JobId, state: JobState) {
        let own = self.results.iter().filter(|(step, _)| step.0 == job && step.1.frame == Stage::JOB_FRAME);
        for (step, (epoch, _)) in own.filter(|_| state == JobState::Done) {
            let task = TaskKey { job, stage: step.1, index: step.2 };
            let all = self.inputs_of(step, "").into_iter().map(|(need, it)| (it.1.frame, it.2, need.role));
            assert_eq!(self.inputs[epoch], all.collect(), "{task} is made of other frames");
        }
    }

    /// Checks that the hints of a task count, and were made in the previous frame.
    pub(super) fn check_hints(&self, held: &Assignment) {
        let spec = self.farm.scheduler.spec(held.task.job).unwrap();
        for hint in &held.spec.hints {
            let of = self.template(&held.task).hints[usize::from(hint.need)];
            let place = spec.frames.binary_search(&held.task.stage.frame).unwrap();
            assert_eq!((hint.frame, hint.output.role), (spec.frames[place - 1], of.role));
            let made = self.frame_outputs.get(&(held.task.job, hint.frame, of.stage, hint.item));
            let is_made = made.is_some_and(|made| made.contains(&hint.output.artifact.digest));
            assert!(is_made, "{} has a hint that no task has made: {hint:?}", held.task);
        }
    }
}
