//! Steps of the property test: what users, workers and the coordinator do.

use super::Machine;
use crate::common;
use crate::common::{panic_failure, result_of};
use femc_model::*;
use femc_schedule::*;
use proptest::prelude::*;

/// A step.
#[derive(Debug, Clone, Copy)]
pub(super) enum Step {
    Submit(Submission),
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

/// A job that is submitted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Submission {
    frames: u32,
    tiles: u32,
    rounds: usize,
    form: GraphForm,
    /// Index of the owner.
    owner: usize,
    key: Option<u8>,
    priority: u8,
}

/// Form of a job's graph.
#[derive(Debug, Clone, Copy)]
pub(super) enum GraphForm {
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
pub(super) enum LoopDecision {
    Continue,
    /// Continue, with different steps for each task.
    ContinueUnevenly(u32),
    End,
}

pub(super) fn any_step() -> impl Strategy<Value = Step> {
    let decision = prop_oneof![2 => Just(LoopDecision::Continue), 1 => (0..8u32).prop_map(LoopDecision::ContinueUnevenly), 2 => Just(LoopDecision::End)];
    let form = prop_oneof![
        4 => (0..4u32).prop_map(GraphForm::Frames), 2 => Just(GraphForm::Diamond), 2 => Just(GraphForm::ImageAfterLoop), 4 => Just(GraphForm::Decided),
        3 => any::<bool>().prop_map(|gaps| GraphForm::JobStages { gaps }), 5 => Just(GraphForm::Shared)
    ];
    prop_oneof![
        1 => (1..4u32, 1..7u32, 1..4usize, form, 0..3usize, prop::option::of(0..3u8), prop_oneof![Just(50u8), 0..=100u8])
            .prop_map(|(frames, tiles, rounds, form, owner, key, priority)| Step::Submit(Submission { frames, tiles, rounds, form, owner, key, priority })),
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

pub(super) const OWNERS: [&str; 3] = ["ann", "bob", "eve"];

/// Tag that jobs of one tile require.
pub(super) const TAG: &str = "near";
impl Machine {
    /// Takes a step, and checks what it commands.
    pub(super) fn take_step(&mut self, step: Step) {
        match step {
            Step::Submit(job) => self.submit(job),
            Step::Die(which) => self.kill_worker(which),
            Step::Upgrade => self.farm.engine = if self.farm.engine == "e" { "f" } else { "e" },
            Step::Join => self.join(),
            Step::Return(which) => self.return_with_old_leases(which),
            Step::RestartWorker(which) => self.restart_worker(which),
            Step::Drain(which, drain) => self.drain(which, drain),
            Step::Leave(which) => self.leave(which),
            Step::Complete(which, choice, milliseconds) => self.complete(which, choice, milliseconds),
            Step::Fail(which, kind) => self.fail(which, kind),
            Step::Doom(which) => self.fail_everywhere(which),
            Step::LateReport(which) => self.report_late(which),
            Step::Heartbeat(which, samples) => self.send_heartbeat(which, samples),
            Step::Wait(milliseconds) => self.wait(milliseconds),
            Step::Control(which, kind) => self.control(which, kind),
            Step::LoseImage(which) => self.lose_image(which),
            Step::Restart => self.restart_coordinator(),
        }
    }

    fn submit(&mut self, job: Submission) {
        let Submission { frames, tiles, rounds, form, owner, key, priority } = job;
        let graph = form.graph(tiles, &[3, 8, 16][..rounds], frames);
        let worlds = [1, frames].map(|end| (end, Digest::compute(&[end.min(2) as u8, rounds as u8])));
        let contents = if graph.has_content_stages() { &worlds[usize::from(frames == 1)..] } else { &[] }.to_vec();
        let frames: Vec<u32> = (1..=frames).collect();
        let owner = OWNERS[owner].to_owned();
        let tags = if tiles == 1 { vec![TAG.to_owned()] } else { vec![] };
        let spec =
            Box::new(JobSpec { owner, priority, tags, contents, ..common::job_with_graph(&frames, tiles, graph) });
        let name = key.map(|key| key.to_string());
        let commands =
            self.farm.handle(Event::Submitted { request: RequestId(0), key: name, spec: spec.clone(), date: None });
        let known = key.and_then(|key| self.keys.get(&key));
        match common::find_answer(&commands) {
            Some(Answer::Submitted(job)) if known.is_none() => {
                assert!(!self.jobs.contains(&job), "{job} is new");
                self.jobs.push(job);
                self.keys.extend(key.map(|key| (key, (job, *spec))));
            }
            answer => {
                let is_same = |first: &JobSpec| {
                    (&first.frames, &first.graph, &first.contents) == (&spec.frames, &spec.graph, &spec.contents)
                };
                // A job with a new key is refused for its owner's quota.
                let due = known.filter(|(_, first)| is_same(first)).map(|(job, _)| Answer::Submitted(*job));
                assert_eq!(answer, due, "the same key is the same job, or is refused");
            }
        }
        self.check_commands(commands);
    }

    fn kill_worker(&mut self, which: usize) {
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

    fn join(&mut self) {
        self.check_ready();
        self.workers.insert(self.next_worker);
        self.builds.insert(self.next_worker, self.farm.engine);
        let tags = if self.next_worker.is_multiple_of(2) { vec![TAG.to_owned()] } else { vec![] };
        let commands = self.farm.join_with(self.next_worker, tags);
        self.next_worker += 1;
        self.check_commands(commands);
    }

    fn return_with_old_leases(&mut self, which: usize) {
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

    fn restart_worker(&mut self, which: usize) {
        let Some((before, held)) = self.nth_lease(which) else { return };
        self.farm.leases.retain(|(holder, other)| (*holder, other.epoch) != (before, held.epoch));
        self.end_lease(before, &held);
        let commands = self.rejoin(before, std::slice::from_ref(&held));
        let is_back = |c: &Command| matches!(c, Command::Revoke { epoch, .. } if *epoch == held.epoch);
        assert!(!commands.iter().any(is_back), "its own lease is taken from it: {commands:?}");
        self.check_commands(commands);
    }

    fn drain(&mut self, which: usize, drain: Drain) {
        let Some(worker) = self.nth_worker(which) else { return };
        let commands = self.farm.handle(Event::Drained { worker: WorkerId(worker), drain });
        let assigned = |c: &Command| matches!(c, Command::Assign { worker: to, .. } if to.0 == worker);
        assert!(drain == Drain::Undo || !commands.iter().any(assigned), "a drained worker gets a task");
        self.check_commands(commands);
    }

    fn leave(&mut self, which: usize) {
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

    fn complete(&mut self, which: usize, choice: LoopDecision, milliseconds: u64) {
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
            assert!(
                again.iter().any(is_heard),
                "a result that is already recorded must be accepted when it is reported again: {again:?}"
            );
            assert!(!Self::is_recorded(&again, &held), "it counts twice");
            self.check_commands(again);
        }
    }

    fn fail(&mut self, which: usize, kind: u8) {
        let Some((worker, held)) = self.nth_lease(which) else { return };
        self.end_lease(worker, &held);
        self.live.remove(&(held.task, held.epoch));
        let missing =
            held.spec.artifacts().next().map_or(Digest::compute(b"an unknown artifact"), |first| first.digest);
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

    fn fail_everywhere(&mut self, which: usize) {
        let Some((_, doomed)) = self.nth_lease(which) else { return };
        for _ in 0..3 {
            let place = self.farm.leases.iter().position(|(_, held)| held.task == doomed.task);
            let Some(place) = place else { return };
            self.take_step(Step::Fail(place, 0));
        }
    }

    fn report_late(&mut self, which: usize) {
        if self.ended.is_empty() {
            return;
        }
        let (worker, task) = self.ended[which % self.ended.len()].clone();
        let event =
            Event::Completed { worker, task: task.task, epoch: task.epoch, result: result_of(&task, Decision::Done) };
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

    fn send_heartbeat(&mut self, which: usize, samples: u64) {
        let Some(worker) = self.nth_worker(which) else { return };
        let commands = self.farm.heartbeat(worker, Phase::Working, samples);
        self.check_commands(commands);
    }

    fn wait(&mut self, milliseconds: u64) {
        let commands = self.farm.wait(milliseconds);
        self.check_commands(commands);
    }

    fn control(&mut self, which: usize, kind: u8) {
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

    fn lose_image(&mut self, which: usize) {
        let frames = |&job: &JobId| self.farm.scheduler.frames(job).unwrap_or_default().into_iter();
        let images: Vec<Digest> =
            self.jobs.iter().flat_map(frames).flat_map(|frame| frame.outputs).map(|it| it.artifact.digest).collect();
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

    fn restart_coordinator(&mut self) {
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
