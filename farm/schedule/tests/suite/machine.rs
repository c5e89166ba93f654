//! Property test with arbitrary orders of events: no task is lost, no sample of a tile is done twice, every job ends, a replay
//! gives the same state, and a second dispatch changes nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU64;

use crate::common;
use crate::common::{TestFarm, panic_failure, result_of};
use femc_model::*;
use femc_schedule::*;
use proptest::prelude::*;

#[derive(Debug, Clone, Copy)]
enum Step {
    Submit {
        frames: u32,
        tiles: u32,
        rounds: usize,
        form: GraphForm,
        /// Index of the owner.
        owner: usize,
        key: Option<u8>,
        priority: u8,
    },
    /// A worker dies while it computes a task; its next process reports it.
    Die(usize),
    Join,
    /// A worker comes back with leases of an earlier session.
    Return(usize),
    /// A worker restarts, and the end of its earlier session is not known.
    RestartWorker(usize),
    Drain(usize, Drain),
    Leave(usize),
    /// A task is completed after these milliseconds of work.
    Complete(usize, LoopDecision, u64),
    Fail(usize, u8),
    /// A task panics on every worker, again and again.
    Doom(usize),
    LateReport(usize),
    Heartbeat(usize, u64),
    Wait(u64),
    Control(usize, u8),
    Restart,
    /// The image of a finished frame is lost from the store.
    LoseImage(usize),
    /// Workers that start from now on have the other build.
    Upgrade,
}

/// Form of a job's graph.
#[derive(Debug, Clone, Copy)]
enum GraphForm {
    /// Tiles, groups of this many tiles (0: none), an image.
    Frames(u32),
    /// Two stages that read the tiles, and an image that reads both.
    Diamond,
    /// Tiles, and an image after the loop that reads all rounds.
    ImageAfterLoop,
    /// Tiles, groups of two tiles, a decision that reads the groups' errors, and an image after the loop that reads their pixels.
    /// The groups of the previous frame are hints for tiles and groups.
    Decided,
    /// Frames, and for the job a tree over their tiles with one result, and a chain over its frames; with gaps or without.
    JobStages { gaps: bool },
    /// Frames that read a content which is solved in rounds, once for all frames and jobs with this content.
    Shared,
}

impl GraphForm {
    fn graph(self, tiles: u32, rounds: &[u32], frames: u32) -> Graph {
        use {Role::*, Scope::*, StageKind as Kind};
        let (one, most) = (TaskSizes::even(1, 1), rounds.len() as u32);
        let render = StageTemplate::new(Kind::Render, Frame, TaskSizes::even(tiles, 64), &[Tile]).with_steps(rounds);
        let image = |scope, makes: &[Role]| StageTemplate::new(Kind::Image, scope, one.clone(), makes);
        let need = |stage, role, reach, round, gaps| Need { stage, role, reach, round, gaps };
        match self {
            Self::Frames(fan) => common::tile_graph(tiles, rounds, fan),
            Self::Diamond => {
                let pairs = TaskSizes::even(tiles.div_ceil(2), 1);
                let left = StageTemplate::new(Kind::Reduce, Frame, pairs, &[Pixels]).with_input(0, Tile, Reach::Fan(2));
                let right = StageTemplate::new(Kind::Reduce, Frame, TaskSizes::even(tiles, 1), &[Sums])
                    .with_input(0, Tile, Reach::Same)
                    .with_need(need(2, Sums, Reach::All, Round::Previous, false));
                let end = image(Frame, &[Image]).with_input(1, Pixels, Reach::All).with_input(2, Sums, Reach::All);
                Graph { stages: vec![render, left, right, end.with_loop(0, most)] }
            }
            Self::ImageAfterLoop => {
                let decide = image(Frame, &[]).with_input(0, Tile, Reach::All).with_loop(0, most);
                let end = image(Frame, &[Image]).with_need(need(0, Tile, Reach::All, Round::Every, false));
                Graph { stages: vec![render, decide, end] }
            }
            Self::Decided => {
                let groups = StageTemplate::new(
                    Kind::Reduce,
                    Frame,
                    TaskSizes::even(tiles.div_ceil(2), 1),
                    &[Pixels, Errors, Sums, Numbers],
                )
                .with_input(0, Tile, Reach::Fan(2))
                .with_hint(1, Numbers, Reach::Same)
                .with_need(need(1, Sums, Reach::Same, Round::Previous, false));
                let decide =
                    StageTemplate::new(Kind::Decide, Frame, one.clone(), &[]).with_input(1, Errors, Reach::All);
                let end = image(Frame, &[Image]).with_input(1, Pixels, Reach::All);
                let render = render.with_hint(1, Numbers, Reach::All);
                Graph { stages: vec![render, groups, decide.with_loop(0, most), end] }
            }
            Self::Shared => {
                let blocks = StageTemplate::new(Kind::Reduce, Content, TaskSizes::even(2, 1), &[Sums]);
                let before = |stage, role| need(stage, role, Reach::All, Round::Previous, false);
                let blocks = blocks.with_need(before(0, Sums)).with_need(before(1, Numbers));
                let decide = image(Content, &[Numbers]).with_input(0, Sums, Reach::All).with_loop(0, most);
                let field =
                    StageTemplate::new(Kind::Reduce, Content, one.clone(), &[Pixels]).with_input(0, Sums, Reach::All);
                let render = render.with_input(2, Pixels, Reach::All);
                let end = image(Frame, &[Image]).with_input(3, Tile, Reach::All).with_loop(3, most);
                Graph { stages: vec![blocks, decide, field, render, end] }
            }
            Self::JobStages { gaps } => {
                let end = image(Frame, &[Image]).with_input(0, Tile, Reach::All).with_loop(0, most);
                let all = tiles * frames;
                let pairs = StageTemplate::new(Kind::Reduce, Job, TaskSizes::even(all.div_ceil(2), 1), &[Sums])
                    .with_need(need(0, Tile, Reach::Fan(2), Round::Every, gaps));
                let whole = image(Job, &[Preview]).with_input(2, Sums, Reach::All).with_tags(&[TAG]);
                let whole = whole.with_need(need(1, Image, Reach::All, Round::Same, gaps));
                let chain = StageTemplate::new(Kind::Paint, Job, TaskSizes::even(frames, 1), &[Painted, Brushwork])
                    .with_need(need(1, Image, Reach::Fan(1), Round::Same, gaps))
                    .with_input(4, Brushwork, Reach::Previous);
                Graph { stages: vec![render, end, pairs, whole, chain] }
            }
        }
    }
}

/// Decision of a task that closes a loop.
#[derive(Debug, Clone, Copy)]
enum LoopDecision {
    Continue,
    /// Continue, with different steps for each task.
    ContinueUnevenly(u32),
    End,
}

fn any_step() -> impl Strategy<Value = Step> {
    let decision = prop_oneof![2 => Just(LoopDecision::Continue), 1 => (0..8u32).prop_map(LoopDecision::ContinueUnevenly), 2 => Just(LoopDecision::End)];
    let form = prop_oneof![
        4 => (0..4u32).prop_map(GraphForm::Frames), 2 => Just(GraphForm::Diamond), 2 => Just(GraphForm::ImageAfterLoop), 4 => Just(GraphForm::Decided),
        3 => any::<bool>().prop_map(|gaps| GraphForm::JobStages { gaps }), 5 => Just(GraphForm::Shared)
    ];
    prop_oneof![
        1 => (1..4u32, 1..7u32, 1..4usize, form, 0..3usize, prop::option::of(0..3u8), prop_oneof![Just(50u8), 0..=100u8])
            .prop_map(|(frames, tiles, rounds, form, owner, key, priority)| Step::Submit { frames, tiles, rounds, form, owner, key, priority }),
        1 => any::<usize>().prop_map(Step::Die),
        2 => Just(Step::Join),
        2 => any::<usize>().prop_map(Step::Return),
        1 => any::<usize>().prop_map(Step::RestartWorker),
        1 => (any::<usize>(), prop_oneof![Just(Drain::Begin), Just(Drain::Undo)]).prop_map(|(which, drain)| Step::Drain(which, drain)),
        1 => any::<usize>().prop_map(Step::Leave),
        12 => (any::<usize>(), decision, prop_oneof![Just(0u64), Just(30), Just(2_000)])
            .prop_map(|(which, decision, milliseconds)| Step::Complete(which, decision, milliseconds)),
        3 => (any::<usize>(), 0..24u8).prop_map(|(which, kind)| Step::Fail(which, kind)),
        1 => any::<usize>().prop_map(Step::Doom),
        2 => any::<usize>().prop_map(Step::LateReport),
        3 => (any::<usize>(), 0..1000u64).prop_map(|(which, samples)| Step::Heartbeat(which, samples)),
        3 => prop_oneof![4 => Just(400u64), 4 => Just(2_000), 4 => Just(6_000), 1 => Just(90_000), 1 => Just(1 << 32)].prop_map(Step::Wait),
        2 => (any::<usize>(), 0..6u8).prop_map(|(which, kind)| Step::Control(which, kind)),
        1 => Just(Step::Restart),
        1 => any::<usize>().prop_map(Step::LoseImage),
        1 => Just(Step::Upgrade),
    ]
}

const OWNERS: [&str; 3] = ["ann", "bob", "eve"];

/// Tag that jobs of one tile require.
const TAG: &str = "near";

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
    keys: BTreeMap<u8, JobId>,
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
                    self.keys.retain(|_, known| *known != job);
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
                // A task of which a part is lost is done again as a whole.
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
    fn inputs_of(&self, (job, stage, item, _): &TaskStep, engine: &str) -> Vec<(Need, TaskStep)> {
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
    fn check_may_lease(&self, worker: WorkerId, task: &TaskKey) {
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
    fn has_open_frame_of(&self, job: JobId, key: &Digest) -> bool {
        let spec = self.farm.scheduler.spec(job).unwrap();
        let finished = self.farm.scheduler.frames(job).unwrap();
        let is_open = |frame: u32| !finished.iter().any(|record| record.frame == frame);
        spec.frames
            .iter()
            .enumerate()
            .any(|(place, &frame)| spec.content_key(place).as_ref() == Some(key) && is_open(frame))
    }

    /// Checks whether a worker has all tags of a job.
    fn is_fit_for(&self, worker: WorkerId, job: JobId) -> bool {
        self.has_tags(worker, &self.farm.scheduler.spec(job).unwrap().tags)
    }

    fn has_tags(&self, worker: WorkerId, all: &[String]) -> bool {
        let workers = self.farm.scheduler.workers(self.farm.now);
        let tags = workers.into_iter().find(|known| known.worker == worker).map(|known| known.tags).unwrap_or_default();
        all.iter().all(|tag| tags.contains(tag))
    }

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

    /// Checks that all inputs of a task exist before it begins, and that it gets exactly these: where gaps are allowed, none of
    /// frames that cannot be finished.
    fn check_inputs(&self, held: &Assignment, engine: &str) {
        let Some(step) = task_steps(held).first().copied() else { panic!("a task of nothing: {held:?}") };
        let expected = self.expected_inputs(&held.task, &step, engine);
        let given: BTreeSet<Digest> = held.spec.artifacts().map(|it| it.digest).collect();
        assert_eq!(given, expected, "the inputs of {}", held.task);
        assert_eq!(held.spec.artifacts().count(), given.len(), "{} reads one input twice", held.task);
        self.check_steps_taken(held);
    }

    /// Checks that a task which reads divided tasks gets the number of steps that each of them has taken.
    fn check_steps_taken(&self, held: &Assignment) {
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
    fn expected_inputs(&self, task: &TaskKey, step: &TaskStep, engine: &str) -> BTreeSet<Digest> {
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

    fn take_step(&mut self, step: Step) {
        match step {
            Step::Submit { frames, tiles, rounds, form, owner, key, priority } => {
                let graph = form.graph(tiles, &[3, 8, 16][..rounds], frames);
                let worlds = [1, frames].map(|end| (end, Digest::compute(&[end.min(2) as u8, rounds as u8])));
                let contents =
                    if graph.has_content_stages() { &worlds[usize::from(frames == 1)..] } else { &[] }.to_vec();
                let frames: Vec<u32> = (1..=frames).collect();
                let owner = OWNERS[owner].to_owned();
                let tags = if tiles == 1 { vec![TAG.to_owned()] } else { vec![] };
                let spec = Box::new(JobSpec {
                    owner,
                    priority,
                    tags,
                    contents,
                    ..common::job_with_graph(&frames, tiles, graph)
                });
                let name = key.map(|key| key.to_string());
                let commands =
                    self.farm.handle(Event::Submitted { request: RequestId(0), key: name, spec, date: None });
                let known = key.and_then(|key| self.keys.get(&key).copied());
                match common::find_answer(&commands) {
                    Some(Answer::Submitted(job)) if known.is_none() => {
                        assert!(!self.jobs.contains(&job), "{job} is new");
                        self.jobs.push(job);
                        self.keys.extend(key.map(|key| (key, job)));
                    }
                    answer => assert_eq!(answer, known.map(Answer::Submitted), "the same key is the same job"),
                }
                self.check_commands(commands);
            }
            Step::Die(which) => {
                let Some((before, held)) = self.nth_lease(which) else { return };
                let own: Vec<_> = self.farm.leases.iter().filter(|(holder, _)| *holder == before).cloned().collect();
                for (worker, held) in own {
                    self.live.remove(&(held.task, held.epoch));
                    self.end_lease(worker, &held);
                }
                self.workers.remove(&before.0);
                let (worker, today) = (self.next_worker, self.farm.engine);
                self.next_worker += 1;
                self.workers.insert(worker);
                self.farm.engine = self.builds[&before.0];
                self.builds.insert(worker, self.farm.engine);
                let commands = self.farm.join_after_death(worker, before.0, &[held]);
                self.farm.engine = today;
                self.check_commands(commands);
            }
            Step::Upgrade => self.farm.engine = if self.farm.engine == "e" { "f" } else { "e" },
            Step::Join => {
                self.check_ready();
                self.workers.insert(self.next_worker);
                self.builds.insert(self.next_worker, self.farm.engine);
                let tags = if self.next_worker.is_multiple_of(2) { vec![TAG.to_owned()] } else { vec![] };
                let commands = self.farm.join_with(self.next_worker, tags);
                self.next_worker += 1;
                self.check_commands(commands);
            }
            Step::Return(which) => {
                if self.ended.is_empty() {
                    return;
                }
                let (before, _) = self.ended[which % self.ended.len()];
                let mut leases: Vec<Assignment> =
                    self.ended.iter().filter(|(worker, _)| *worker == before).map(|(_, held)| held.clone()).collect();
                leases.retain(|held| !self.live.contains(&(held.task, held.epoch)));
                leases.sort_by_key(|held| held.epoch);
                leases.dedup();
                let commands = self.rejoin(before, &leases);
                for held in leases {
                    let is_back = |c: &Command| matches!(c, Command::Revoke { task, epoch, .. } if (*task, *epoch) == (held.task, held.epoch));
                    if !commands.iter().any(is_back) {
                        assert!(!self.done.contains(&held.task), "{} is done and adopted", held.task);
                        self.begin_lease(&held);
                    }
                }
                self.check_commands(commands);
            }
            Step::RestartWorker(which) => {
                let Some((before, held)) = self.nth_lease(which) else { return };
                self.farm.leases.retain(|(holder, other)| (*holder, other.epoch) != (before, held.epoch));
                self.end_lease(before, &held);
                let commands = self.rejoin(before, std::slice::from_ref(&held));
                let is_back = |c: &Command| matches!(c, Command::Revoke { epoch, .. } if *epoch == held.epoch);
                assert!(!commands.iter().any(is_back), "its own lease is taken from it: {commands:?}");
                self.check_commands(commands);
            }
            Step::Drain(which, drain) => {
                let Some(worker) = self.nth_worker(which) else { return };
                let commands = self.farm.handle(Event::Drained { worker: WorkerId(worker), drain });
                let assigned = |c: &Command| matches!(c, Command::Assign { worker: to, .. } if to.0 == worker);
                assert!(drain == Drain::Undo || !commands.iter().any(assigned), "a drained worker gets a task");
                self.check_commands(commands);
            }
            Step::Leave(which) => {
                let Some(worker) = self.nth_worker(which) else { return };
                self.workers.remove(&worker);
                let held: Vec<_> = self.farm.leases.iter().filter(|(holder, _)| holder.0 == worker).cloned().collect();
                for (worker, held) in held {
                    self.live.remove(&(held.task, held.epoch));
                    self.end_lease(worker, &held);
                }
                let commands = self.farm.leave(worker);
                self.check_commands(commands);
            }
            Step::Complete(which, choice, milliseconds) => {
                self.take_step(Step::Wait(milliseconds));
                let Some((worker, held)) = self.nth_lease(which) else { return };
                // A repeated decision has the same inputs.
                let round = (held.task.job, held.task.stage.frame, held.task.stage.round);
                let closes = self.template(&held.task).closes.is_some();
                let choice = if closes { *self.decisions.entry(round).or_insert(choice) } else { choice };
                let result = self.correct_result(&held, choice, milliseconds);
                self.end_lease(worker, &held);
                let commands = self.farm.complete_with(worker.0, &held, result.clone());
                assert!(!commands.iter().any(|c| matches!(c, Command::Refuse { .. })), "a live lease is refused");
                let has_counted = Self::is_recorded(&commands, &held);
                self.check_commands(commands);
                if has_counted {
                    let again = self.farm.complete_with(worker.0, &held, result);
                    let is_heard = |c: &Command| matches!(c, Command::Accept { epoch, .. } if *epoch == held.epoch);
                    assert!(again.iter().any(is_heard), "what counts is refused the second time: {again:?}");
                    assert!(!Self::is_recorded(&again, &held), "it counts twice");
                    self.check_commands(again);
                }
            }
            Step::Fail(which, kind) => {
                let Some((worker, held)) = self.nth_lease(which) else { return };
                self.end_lease(worker, &held);
                self.live.remove(&(held.task, held.epoch));
                let missing =
                    held.spec.artifacts().next().map_or(Digest::compute(b"nobody knows"), |first| first.digest);
                let failure = match kind {
                    0..=9 => panic_failure(),
                    10 => Failure::Store { message: "away".into() },
                    11 => Failure::Cancelled,
                    12 => Failure::Scene { message: "no camera".into() },
                    13..=16 => Failure::LostInputs { digests: vec![missing], message: "gone".into() },
                    _ => Failure::Resources { message: "memory".into() },
                };
                self.failing_workers.insert(worker.0);
                let commands = self.farm.fail(worker.0, &held, failure);
                self.check_commands(commands);
            }
            Step::Doom(which) => {
                let Some((_, doomed)) = self.nth_lease(which) else { return };
                for _ in 0..3 {
                    let place = self.farm.leases.iter().position(|(_, held)| held.task == doomed.task);
                    let Some(place) = place else { return };
                    self.take_step(Step::Fail(place, 0));
                }
            }
            Step::LateReport(which) => {
                if self.ended.is_empty() {
                    return;
                }
                let (worker, task) = self.ended[which % self.ended.len()].clone();
                let event = Event::Completed {
                    worker,
                    task: task.task,
                    epoch: task.epoch,
                    result: result_of(&task, Decision::Done),
                };
                let commands = self.farm.handle(event);
                // Facts with other causes: the worker's sign of life, and the passing of time.
                let is_besides = |fact: &Fact| {
                    matches!(
                        fact,
                        Fact::WorkerReturned { .. }
                            | Fact::WorkerDied { .. }
                            | Fact::TimeCharged { .. }
                            | Fact::SharedJobBegun { .. }
                    )
                };
                let changes = |c: &Command| matches!(c, Command::Record(fact) if !is_besides(fact));
                assert!(!commands.iter().any(changes), "a stale report changes something");
                self.check_commands(commands);
            }
            Step::Heartbeat(which, samples) => {
                let Some(worker) = self.nth_worker(which) else { return };
                let commands = self.farm.heartbeat(worker, Phase::Working, samples);
                self.check_commands(commands);
            }
            Step::Wait(milliseconds) => {
                let commands = self.farm.wait(milliseconds);
                self.check_commands(commands);
            }
            Step::Control(which, kind) => {
                if self.jobs.is_empty() {
                    return;
                }
                let job = self.jobs[which % self.jobs.len()];
                let control = match kind {
                    0 => Control::Pause,
                    1 => Control::Resume,
                    2 => Control::Cancel,
                    3 => Control::Retry,
                    4 => Control::RetryFrames(vec![1 + (which % 3) as u32]),
                    _ => Control::Priority((which % 101) as u8),
                };
                let commands = self.farm.control(job, control);
                self.check_commands(commands);
            }
            Step::LoseImage(which) => {
                let frames = |&job: &JobId| self.farm.scheduler.frames(job).unwrap_or_default().into_iter();
                let images: Vec<Digest> = self
                    .jobs
                    .iter()
                    .flat_map(frames)
                    .flat_map(|frame| frame.outputs)
                    .map(|it| it.artifact.digest)
                    .collect();
                if images.is_empty() {
                    return;
                }
                let digest = images[which % images.len()];
                let commands = self.farm.handle(Event::ArtifactLost { digest });
                self.check_commands(commands);
                let is_listed = |&job: &JobId| {
                    let frames = self.farm.scheduler.frames(job).unwrap();
                    frames.iter().flat_map(|frame| &frame.outputs).any(|it| it.artifact.digest == digest)
                };
                assert!(!self.jobs.iter().any(is_listed), "a lost image is told as finished");
            }
            Step::Restart => {
                self.check_idempotence();
                self.ended.append(&mut self.farm.leases.clone());
                let before = self.farm.charged.clone();
                let workers = self.next_worker;
                self.farm.restart();
                let [kept, charged] = [&self.farm.charged, &before].map(|charged| charged.values().sum::<u64>());
                let most = workers * Scheduler::CHARGE_INTERVAL;
                assert!(kept <= charged && charged - kept <= most, "{kept} ms of {charged} are kept");
                self.workers.clear();
                self.live.clear();
            }
        }
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

    fn check(&mut self) {
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
    fn check_ends(&mut self) {
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
    fn check_charges(&self) {
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

    /// Checks that the samples of a job without running leases are those of its results, and that the seconds of its frames are
    /// those of all results.
    fn check_samples(&self) {
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
    fn check_stats(&self) {
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
    fn check_ready(&self) {
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
    fn check_idempotence(&self) {
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
    fn check_made_of_all(&self, job: JobId, state: JobState) {
        let own = self.results.iter().filter(|(step, _)| step.0 == job && step.1.frame == Stage::JOB_FRAME);
        for (step, (epoch, _)) in own.filter(|_| state == JobState::Done) {
            let task = TaskKey { job, stage: step.1, index: step.2 };
            let all = self.inputs_of(step, "").into_iter().map(|(need, it)| (it.1.frame, it.2, need.role));
            assert_eq!(self.inputs[epoch], all.collect(), "{task} is made of other frames");
        }
    }

    /// Checks that the hints of a task count, and were made in the previous frame.
    fn check_hints(&self, held: &Assignment) {
        let spec = self.farm.scheduler.spec(held.task.job).unwrap();
        for hint in &held.spec.hints {
            let of = self.template(&held.task).hints[usize::from(hint.need)];
            let place = spec.frames.binary_search(&held.task.stage.frame).unwrap();
            assert_eq!((hint.frame, hint.output.role), (spec.frames[place - 1], of.role));
            let made = self.frame_outputs.get(&(held.task.job, hint.frame, of.stage, hint.item));
            let is_made = made.is_some_and(|made| made.contains(&hint.output.artifact.digest));
            assert!(is_made, "{} is to look at what nobody has made: {hint:?}", held.task);
        }
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
