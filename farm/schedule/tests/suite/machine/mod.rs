//! Property test with arbitrary orders of events: no task is lost, no sample of a tile is done twice, every job ends, a replay
//! gives the same state, and a second dispatch changes nothing.

mod laws;
mod step;

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU64;

use crate::common;
use crate::common::TestFarm;
use femc_model::*;
use femc_schedule::*;
use proptest::prelude::*;
use step::{LoopDecision, OWNERS, Step, any_step};

/// The farm, with a model of its expected state.
struct Machine {
    farm: TestFarm,
    /// Ledger of the log so far, for queries about the state before a fact.
    shadow: Ledger,
    workers: BTreeSet<u64>,
    next_worker: u64,
    /// Workers that have reported a failure.
    failing_workers: BTreeSet<u64>,
    /// Build of the engine of each worker.
    builds: BTreeMap<u64, &'static str>,
    jobs: Vec<JobId>,
    keys: BTreeMap<u8, (JobId, JobSpec)>,
    /// Jobs that a person has cancelled.
    cancelled: BTreeSet<JobId>,
    /// Jobs that a person has paused.
    paused: BTreeSet<JobId>,
    /// Number of tries of each quarantined task.
    quarantined_tries: BTreeMap<TaskKey, u32>,
    /// Leases that are over, as a slow worker may still report them.
    ended: Vec<(WorkerId, Assignment)>,
    /// Running leases: one per task, or two if the second is a copy of the first.
    live: BTreeSet<(TaskKey, Epoch)>,
    /// Steps of every lease that was ever granted.
    covered_steps: BTreeMap<Epoch, Vec<TaskStep>>,
    /// Inputs of the leases, by frame, task and role: frames that are made again may be divided differently.
    inputs: BTreeMap<Epoch, BTreeSet<(u32, u32, Role)>>,
    last_epoch: Epoch,
    done: BTreeSet<TaskKey>,
    /// Lease that last completed each task.
    made_by: BTreeMap<TaskKey, Epoch>,
    /// Results whose usage was recorded, until they count.
    recorded_usage: BTreeSet<(TaskKey, Epoch)>,
    /// Outputs of frames since they began, by job, frame, stage and task, including lost ones.
    frame_outputs: BTreeMap<(JobId, u32, u16, u32), BTreeSet<Digest>>,
    /// Results that count, each with its lease.
    results: BTreeMap<TaskStep, (Epoch, TaskResult)>,
    /// Decisions, by job, frame and round.
    decisions: BTreeMap<(JobId, u32, u32), LoopDecision>,
    /// Whether there ever was a shared job.
    has_shared: bool,
    /// Shared jobs by content and build.
    shared: BTreeMap<(Digest, String), JobId>,
    /// Decided steps of tasks at the end of rounds, by job, frame and round.
    decided_steps: BTreeMap<(JobId, u32, u32), Vec<u32>>,
}

/// A step of a task: job, stage, number of the task, step.
type TaskStep = (JobId, Stage, u32, u32);

/// Returns the steps that a lease covers.
fn task_steps(held: &Assignment) -> Vec<TaskStep> {
    held.spec.steps.clone().map(|step| (held.task.job, held.task.stage, held.spec.item, step)).collect()
}

impl Machine {
    /// Creates a machine.
    /// - `grain`: pixel samples of a sample chunk; a tile has 64 pixels.
    /// - `prefetch`: tasks that a worker holds beyond the running one.
    fn new(grain: u64, prefetch: u32, keep_ended: Option<u64>) -> Self {
        let grain = NonZeroU64::new(grain).unwrap();
        let config = Config {
            chunk_size: grain,
            prefetch,
            keep_ended,
            work_per_lease: 100,
            min_work_per_lease: 20,
            weights: [(OWNERS[0].to_owned(), 3)].into(),
            quota: Quota { jobs: 4, ..Quota::default() },
            ..common::config()
        };
        let farm = TestFarm::with_config(config);
        Self {
            shadow: farm.replay(),
            farm,
            workers: BTreeSet::new(),
            next_worker: 1,
            failing_workers: BTreeSet::new(),
            builds: BTreeMap::new(),
            jobs: vec![],
            keys: BTreeMap::new(),
            cancelled: BTreeSet::new(),
            paused: BTreeSet::new(),
            quarantined_tries: BTreeMap::new(),
            ended: vec![],
            live: BTreeSet::new(),
            covered_steps: BTreeMap::new(),
            inputs: BTreeMap::new(),
            last_epoch: Epoch(0),
            done: BTreeSet::new(),
            made_by: BTreeMap::new(),
            recorded_usage: BTreeSet::new(),
            frame_outputs: BTreeMap::new(),
            results: BTreeMap::new(),
            decisions: BTreeMap::new(),
            has_shared: false,
            shared: BTreeMap::new(),
            decided_steps: BTreeMap::new(),
        }
    }

    /// Checks every command against the model, and updates the model.
    fn check_commands(&mut self, commands: Vec<Command>) {
        for command in commands {
            if let Command::Record(fact) = &command {
                self.apply_fact(fact);
            }
            match command {
                Command::Assign { worker, assignment } => {
                    let Assignment { task, epoch, .. } = assignment;
                    self.check_may_lease(worker, &task);
                    assert!(epoch > self.last_epoch, "epochs grow");
                    self.last_epoch = epoch;
                    assert!(!self.done.contains(&task), "{task} is done and leased again");
                    self.check_inputs(&assignment, self.builds[&worker.0]);
                    self.check_hints(&assignment);
                    self.begin_lease(&assignment);
                }
                Command::Revoke { worker, task, epoch, .. } => {
                    if let Some(held) = self.farm.revoked.iter().find(|(to, held)| (*to, held.epoch) == (worker, epoch))
                    {
                        self.ended.push(held.clone());
                    }
                    self.live.remove(&(task, epoch));
                }
                Command::RecordAttempt(note) if note.ending == LeaseEnding::Done => {
                    assert!(self.recorded_usage.insert((note.task, note.epoch)), "{} is noted twice", note.task);
                }
                Command::Record(Fact::JobRemoved { job }) => {
                    self.jobs.retain(|known| *known != job);
                    self.shared.retain(|_, known| *known != job);
                    self.done.retain(|task| !job.is_shared() || task.job != job);
                    self.results.retain(|step, _| !job.is_shared() || step.0 != job);
                    self.keys.retain(|_, (known, _)| *known != job);
                    self.ended.retain(|(_, held)| held.task.job != job);
                    assert!(self.live.iter().all(|(task, _)| task.job != job), "{job} is forgotten and leased");
                }
                Command::Record(Fact::Controlled { job, control }) => match control {
                    Control::Cancel => drop(self.cancelled.insert(job)),
                    Control::Pause => drop(self.paused.insert(job)),
                    Control::Resume => drop(self.paused.remove(&job)),
                    Control::Retry => {
                        self.cancelled.remove(&job);
                        self.paused.remove(&job);
                        self.quarantined_tries.retain(|task, _| task.job != job);
                    }
                    Control::RetryFrames(frames) => {
                        self.quarantined_tries.retain(|task, _| task.job != job || !frames.contains(&task.stage.frame));
                    }
                    Control::Priority(_) | Control::Delete => {}
                },
                Command::Discard(digests) => {
                    let gone = self.farm.scheduler.unreferenced(digests);
                    let needs =
                        |(_, held): &&(WorkerId, Assignment)| held.spec.artifacts().any(|it| gone.contains(&it.digest));
                    let needy = self.farm.leases.iter().find(needs);
                    assert_eq!(needy, None, "what it reads may go");
                }
                _ => {}
            }
        }
    }

    /// Updates the finished work with a fact.
    fn apply_fact(&mut self, fact: &Fact) {
        match fact {
            Fact::SharedJobBegun { job, key, engine, .. } => {
                self.has_shared = true;
                let before = self.shared.insert((*key, engine.clone()), *job);
                assert_eq!(before, None, "one content is begun twice by one build");
            }
            Fact::Done { task, epoch, result, .. } => {
                assert!(self.live.remove(&(*task, *epoch)), "a result without a lease counts");
                assert!(self.done.insert(*task), "{task} is done twice");
                for step in self.covered_steps[epoch].clone() {
                    let made = self.frame_outputs.entry((step.0, step.1.frame, step.1.number, step.2)).or_default();
                    made.extend(result.artifacts().map(|it| it.digest));
                    let before = self.results.insert(step, (*epoch, (**result).clone()));
                    assert!(before.is_none(), "{step:?} of {task} counts twice");
                }
                self.made_by.insert(*task, *epoch);
                assert!(self.recorded_usage.remove(&(*task, *epoch)), "what {task} took is not noted");
                if let Some(Decision::Steps(steps)) = &result.decision {
                    let round = (task.job, task.stage.frame, task.stage.round + 1);
                    self.decided_steps.entry(round).or_insert_with(|| steps.clone());
                }
            }
            Fact::OutputsLost { task } => {
                assert!(self.done.contains(task));
                let there = self.shadow.references();
                let units = self.covered_steps[&self.made_by[task]].clone();
                self.undo_steps(units, &there);
            }
            Fact::Restarted { job, frame } => {
                self.frame_outputs.retain(|(of, at, ..), _| (*of, *at) != (*job, *frame));
                self.done.retain(|task| (task.job, task.stage.frame) != (*job, *frame));
                self.results.retain(|(of, stage, ..), _| (*of, stage.frame) != (*job, *frame));
                self.decided_steps.retain(|(of, at, _), _| (*of, *at) != (*job, *frame));
            }
            _ => {}
        }
        let (Fact::Restarted { job, .. } | Fact::Controlled { job, control: Control::Retry | Control::RetryFrames(_) }) =
            fact
        else {
            drop(self.shadow.apply(fact, self.farm.now));
            return;
        };
        // The job's own stages may have been done without a frame that is now retried.
        let before = self.shadow.references();
        self.shadow.apply(fact, self.farm.now);
        let after = self.shadow.references();
        let own = |stage: &Stage| stage.frame == Stage::JOB_FRAME;
        let is_gone = |it: &Artifact| before.contains(&it.digest) && !after.contains(&it.digest);
        let mut made = self.results.iter().filter(|(step, _)| step.0 == *job && own(&step.1));
        if made.any(|(_, (_, result))| result.artifacts().any(|it| is_gone(&it))) {
            self.done.retain(|task| task.job != *job || !own(&task.stage));
            self.results.retain(|(of, stage, ..), _| of != job || !own(stage));
        }
    }

    /// Marks these steps as not done, together with the producers of their inputs that no longer exist.
    fn undo_steps(&mut self, units: Vec<TaskStep>, there: &BTreeSet<Digest>) {
        for step in units {
            let Some((epoch, _)) = self.results.remove(&step) else { continue };
            let made = &self.made_by;
            self.done.retain(|task| made.get(task) != Some(&epoch));
            let others: Vec<TaskStep> = self.covered_steps[&epoch].clone();
            others.iter().for_each(|other| drop(self.results.remove(other)));
            let read = self.inputs_of(&step, "");
            let is_gone = |(need, step): &(Need, TaskStep)| {
                let result = self.results.get(step);
                result.is_some_and(|(_, it)| it.output(need.role).is_some_and(|it| !there.contains(&it.digest)))
            };
            let gone: Vec<(Need, TaskStep)> = read.into_iter().filter(is_gone).collect();
            for (_, step) in gone {
                // If a part of a task is lost, the whole task is done again.
                let whole: Vec<TaskStep> =
                    self.results.keys().filter(|it| (it.0, it.1, it.2) == (step.0, step.1, step.2)).copied().collect();
                self.undo_steps(whole, there);
            }
        }
    }

    /// Returns the steps of a task in a round.
    fn steps(&self, job: JobId, stage: &Stage, item: u32) -> std::ops::Range<u32> {
        let template = self.farm.scheduler.spec(job).unwrap().graph.stage(stage.number).unwrap().clone();
        let to = |round: u32| {
            let steps = self.decided_steps.get(&(job, stage.frame, round)).filter(|_| template.kind.is_divided());
            steps.map(|steps| steps[item as usize])
        };
        let mut range = template.steps_of(0);
        for round in 1..=stage.round {
            let planned = template.steps_of(round);
            range = match to(round) {
                Some(end) => range.end..end.max(range.end),
                None if template.kind.is_divided() => range.end..planned.end.max(range.end),
                None => planned,
            };
        }
        range
    }

    /// Returns the last round of a frame's loop that has begun.
    fn last_round(&self, job: JobId, frame: u32) -> u32 {
        let of_frame = self.results.keys().filter(|step| (step.0, step.1.frame) == (job, frame));
        of_frame.map(|step| step.1.round).max().unwrap_or(0)
    }

    /// Returns the inputs of a task according to its graph: from existing frames, and from the shared job of this build.
    /// Notes a granted or adopted lease. Checks that no part of it is leased to others or done.
    fn begin_lease(&mut self, held: &Assignment) {
        let units = task_steps(held);
        let original = held.copy_of.filter(|original| self.live.contains(&(held.task, *original)));
        assert!(original.is_none_or(|original| self.covered_steps[&original] == units), "{} is no copy", held.task);
        let others = self.live.iter().filter(|(_, epoch)| Some(*epoch) != original);
        for taken in others.clone().flat_map(|(_, epoch)| &self.covered_steps[epoch]).chain(self.results.keys()) {
            assert!(!units.contains(taken), "{taken:?} of {} is leased or done", held.task);
        }
        assert!(others.clone().all(|(task, _)| *task != held.task), "{} is leased twice", held.task);
        self.live.insert((held.task, held.epoch));
        self.covered_steps.insert(held.epoch, units);
        let read = held.spec.inputs.iter().map(|it| (it.frame, it.item, it.output.role));
        self.inputs.insert(held.epoch, read.collect());
    }

    fn end_lease(&mut self, worker: WorkerId, held: &Assignment) {
        self.ended.push((worker, held.clone()));
    }

    fn nth_lease(&self, which: usize) -> Option<(WorkerId, Assignment)> {
        let held = &self.farm.leases;
        (!held.is_empty()).then(|| held[which % held.len()].clone())
    }

    fn nth_worker(&self, which: usize) -> Option<u64> {
        self.workers.iter().nth(which % self.workers.len().max(1)).copied()
    }

    fn template(&self, task: &TaskKey) -> &StageTemplate {
        self.farm.scheduler.spec(task.job).and_then(|spec| spec.graph.stage(task.stage.number)).expect("it has a stage")
    }

    /// Returns the result of a correct worker: all outputs of the graph, and a decision if the task closes a loop.
    fn correct_result(&self, held: &Assignment, choice: LoopDecision, milliseconds: u64) -> TaskResult {
        let stage = held.task.stage;
        let graph = &self.farm.scheduler.spec(held.task.job).unwrap().graph;
        let template = graph.stage(stage.number).unwrap();
        let decision = template.closes.map(|_| match (held.spec.next_round, choice) {
            (NextRound::Impossible, _) | (_, LoopDecision::End) => Decision::Done,
            (NextRound::Possible, LoopDecision::Continue) => Decision::Continue,
            (NextRound::Possible, LoopDecision::ContinueUnevenly(seed)) => {
                let main = graph.main_stage().filter(|_| template.scope == Scope::Frame).map(|(_, main)| main);
                let Some(main) = main else { return Decision::Continue };
                let steps =
                    |task: u32| (stage.round * 3 + task.wrapping_mul(7) + seed) % (main.steps.last().unwrap() + 1);
                Decision::Steps((0..main.tasks()).map(steps).collect())
            }
        });
        let goes_on = decision.as_ref().map_or(held.spec.next_round == NextRound::Possible, |it| *it != Decision::Done);
        let is_made = |role: &&Role| {
            let mut readers = graph.readers(stage.number).filter(|(_, need)| need.role == **role).peekable();
            let is_carried = readers.peek().is_some() && readers.all(|(_, need)| need.round == Round::Previous);
            if is_carried { goes_on } else { decision.is_none() || !goes_on }
        };
        let output = |role: &Role| {
            let artifact =
                Artifact::from_bytes(format!("{} {} {:?}", role.name(), held.task, held.spec.steps).as_bytes());
            Output { role: *role, artifact }
        };
        TaskResult {
            outputs: template.outputs.iter().filter(is_made).map(output).collect(),
            units: if template.kind.is_divided() { 64 * held.spec.steps.len() as u64 } else { 0 },
            bad_samples: 1,
            relative_error: Some(0.1),
            blocks: Some(BlockCounts { all: 4, unlit: 1 }),
            decision,
            seconds: milliseconds as f64 / 1000.0,
        }
    }

    /// Checks whether the commands record a lease's result.
    fn is_recorded(commands: &[Command], held: &Assignment) -> bool {
        let is_result = |command: &Command| match command {
            Command::Record(Fact::Done { epoch, .. }) => *epoch == held.epoch,
            _ => false,
        };
        commands.iter().any(is_result)
    }

    /// Starts a new session of a worker, with the same build.
    fn rejoin(&mut self, before: WorkerId, leases: &[Assignment]) -> Vec<Command> {
        let (worker, today) = (self.next_worker, self.farm.engine);
        self.next_worker += 1;
        self.workers.insert(worker);
        let build = self.builds[&before.0];
        self.builds.insert(worker, build);
        self.farm.engine = build;
        let commands = self.farm.rejoin(worker, leases);
        self.farm.engine = today;
        commands
    }

    /// Continues with one good worker and without faults: every job ends, and a job that is done has every frame.
    fn finish(&mut self) {
        let jobs: Vec<JobId> = self.jobs.clone();
        for job in jobs {
            let commands = self.farm.control(job, Control::Resume);
            self.check_commands(commands);
        }
        self.take_step(Step::Join);
        for _ in 0..10_000 {
            if self.jobs.iter().all(|&job| self.farm.state(job).has_ended()) {
                break;
            }
            match self.nth_lease(0) {
                Some(_) => self.take_step(Step::Complete(0, LoopDecision::Continue, 30)),
                None => self.take_step(Step::Wait(70_000)),
            }
            if self.farm.leases.is_empty() {
                self.take_step(Step::Join);
            }
        }
        for &job in &self.jobs {
            let status = self.farm.status(job);
            assert!(status.state.has_ended(), "job {job} does not end: {status:?}");
            self.check_made_of_all(job, status.state);
            let own = u32::from(self.farm.scheduler.spec(job).unwrap().graph.has_job_stages());
            let frames = self.farm.scheduler.frames(job).unwrap().len() as u32;
            assert_eq!(status.state == JobState::Done, frames == status.frames_total + own);
            let has_reason = !status.quarantined.is_empty() || status.failure.is_some();
            assert_eq!(
                status.state == JobState::Failed,
                has_reason && frames < status.frames_total + own && status.state != JobState::Cancelled
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 256, failure_persistence: None, max_shrink_time: 60_000, ..ProptestConfig::default()
    })]
    #[test]
    fn no_task_is_lost_and_none_is_done_twice_and_every_job_ends(
        grain in prop_oneof![Just(1u64), Just(128), Just(1 << 15)],
        prefetch in 0..2u32,
        keep_ended in prop_oneof![Just(None), Just(Some(20_000u64))],
        steps in prop::collection::vec(any_step(), 1..120),
    ) {
        let mut machine = Machine::new(grain, prefetch, keep_ended);
        for step in steps {
            machine.take_step(step);
            machine.check();
        }
        machine.finish();
        machine.check();
        machine.check_idempotence();
    }
}
