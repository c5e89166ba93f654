//! A simulated farm: a scheduler, its log, and workers that the test controls.
#![allow(dead_code, reason = "each test file uses its part")]

use std::collections::{BTreeMap, BTreeSet};

use femc_model::*;
use femc_schedule::*;

/// Creates a job of square films of `tiles` tiles in a row, whose images are made directly from tiles.
pub fn job(frames: &[u32], tiles: u32, rounds: &[u32]) -> JobSpec {
    of(frames, tiles, rounded(tiles, rounds, 0))
}

/// Creates such a job, whose images are made from groups of `fan` tiles.
pub fn grouped(frames: &[u32], tiles: u32, rounds: &[u32], fan: u32) -> JobSpec {
    of(frames, tiles, rounded(tiles, rounds, fan))
}

/// Returns the number of the stage of this kind in such jobs.
pub fn number(spec: &JobSpec, kind: StageKind) -> u16 {
    spec.graph.iter().find(|(_, template)| template.kind == kind).expect("it has such a stage").0
}

/// Creates the graph of such a job, with tiles of 64 pixels.
pub fn rounded(tiles: u32, rounds: &[u32], fan: u32) -> Graph {
    testing::frames(Sizes::even(tiles, 64), rounds, fan)
}

/// Creates a job with this graph.
pub fn of(frames: &[u32], tiles: u32, graph: Graph) -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: Digest::of(b"bundle"),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: frames.to_vec(),
        grid: Grid { film: [tiles * 8, 8], tile: 8 },
        graph,
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

/// Returns a configuration in which workers hold one task beyond the running one.
pub fn config() -> Config {
    Config { lease: 5_000, prefetch: 1, queue: u64::MAX, ahead: 0, regroup: 0, ..Config::default() }
}

/// Scheduler, time, and all durable facts.
pub struct Farm {
    pub scheduler: Scheduler,
    pub now: Tick,
    pub log: Vec<(Tick, Fact)>,
    /// Leases as the workers know them.
    pub held: Vec<(WorkerId, Assignment)>,
    /// Leases revoked by the last commands.
    pub ended: Vec<(WorkerId, Assignment)>,
    /// Build of the engine of joining workers.
    pub engine: &'static str,
    requests: u64,
    /// Leases of each session with their owner, oldest first, derived only from the messages.
    hands: BTreeMap<WorkerId, BTreeMap<(Epoch, TaskKey), String>>,
    /// Milliseconds of worker time charged to each owner since the last start.
    pub charged: BTreeMap<String, u64>,
    heard: Tick,
}

impl Farm {
    pub fn new() -> Self {
        Self::with(config())
    }

    pub fn with(config: Config) -> Self {
        let (scheduler, opened) = Scheduler::new(config, Ledger::default());
        Self {
            scheduler,
            now: Tick(0),
            log: vec![(Tick(0), opened)],
            held: vec![],
            ended: vec![],
            engine: "e",
            requests: 0,
            hands: BTreeMap::new(),
            charged: BTreeMap::new(),
            heard: Tick(0),
        }
    }

    /// Returns the ledger that results from the log.
    pub fn replay(&self) -> Ledger {
        let mut ledger = Ledger::default();
        for (now, fact) in &self.log {
            let (now, fact) = Fact::decode(&fact.encode(*now).unwrap()).unwrap();
            ledger.apply(&fact, now);
        }
        ledger
    }

    /// Replaces the coordinator with a new one that resumes from the log; the workers are gone.
    pub fn restart(&mut self) {
        let ledger = self.replay();
        assert_eq!(&ledger, self.scheduler.ledger());
        assert_eq!(Ledger::decode(&ledger.encode().unwrap()), Ok(ledger.clone()), "a snapshot is the ledger");
        let config = self.scheduler.config().clone();
        let (scheduler, opened) = Scheduler::new(config, ledger);
        self.log.push((scheduler.ledger().now(), opened));
        self.scheduler = scheduler;
        self.held.clear();
        self.hands.clear();
        self.charged = self.scheduler.used().map(|(owner, used)| (owner.to_owned(), used.held)).collect();
    }

    /// Returns the owners of each session's oldest lease.
    pub fn served(&self) -> BTreeSet<&str> {
        self.hands.values().filter_map(|held| held.first_key_value()).map(|(_, owner)| owner.as_str()).collect()
    }

    /// Charges the time since the last event: that of each worker to the owner of its oldest lease.
    fn charge(&mut self) {
        let passed = self.now.since(std::mem::replace(&mut self.heard, self.now));
        for owner in self.hands.values().filter_map(|held| held.values().next()) {
            *self.charged.entry(owner.clone()).or_default() += passed;
        }
    }

    /// Owner's name that stands for shared jobs.
    pub const SHARED: &str = "";

    fn owner(&self, job: JobId) -> String {
        let owner = &self.scheduler.spec(job).expect("the job is there").owner;
        if job.is_shared() { Self::SHARED.to_owned() } else { owner.clone() }
    }

    /// Updates the leases of the sessions after an event.
    fn learn(&mut self, event: &Event, commands: &[Command]) {
        match event {
            Event::Left { worker } => drop(self.hands.remove(worker)),
            Event::Completed { worker, task, epoch, .. }
            | Event::Failed { worker, task, epoch, .. }
            | Event::ArtifactMissing { worker, task, epoch, .. } => {
                self.hands.entry(*worker).or_default().remove(&(*epoch, *task));
            }
            Event::Joined { worker, registration } => {
                for held in &registration.held {
                    let is_refused = |command: &Command| matches!(command, Command::Revoke { worker: to, task, epoch, .. } if (to, *task, *epoch) == (worker, held.task, held.epoch));
                    if !commands.iter().any(is_refused) {
                        let key = (held.epoch, held.task);
                        self.hands.values_mut().for_each(|hand| drop(hand.remove(&key)));
                        let owner = self.owner(held.task.job);
                        self.hands.entry(*worker).or_default().insert((held.epoch, held.task), owner);
                    }
                }
            }
            _ => {}
        }
        for command in commands {
            match command {
                Command::Dismiss { worker } => drop(self.hands.remove(worker)),
                Command::Revoke { worker, task, epoch, .. } => {
                    self.hands.entry(*worker).or_default().remove(&(*epoch, *task));
                }
                Command::Assign { worker, assignment: Assignment { task, epoch, .. } } => {
                    let owner = self.owner(task.job);
                    self.hands.entry(*worker).or_default().insert((*epoch, *task), owner);
                }
                _ => {}
            }
        }
    }

    pub fn on(&mut self, event: Event) -> Vec<Command> {
        self.charge();
        let heard = event.clone();
        let commands = self.scheduler.on(event, self.now);
        self.learn(&heard, &commands);
        self.ended.clear();
        for command in &commands {
            match command {
                Command::Record(fact) => self.log.push((self.now, fact.clone())),
                Command::Assign { worker, assignment } => self.held.push((*worker, assignment.clone())),
                Command::Revoke { task, epoch, .. } => {
                    self.ended.extend(self.held.iter().filter(|(_, held)| held.epoch == *epoch).cloned());
                    self.drop_lease(*task, *epoch);
                }
                _ => {}
            }
        }
        commands
    }

    pub fn drop_lease(&mut self, task: TaskKey, epoch: Epoch) {
        self.held.retain(|(_, held)| (held.task, held.epoch) != (task, epoch));
    }

    pub fn submit(&mut self, spec: JobSpec) -> JobId {
        self.requests += 1;
        let request = RequestId(self.requests);
        let commands = self.on(Event::Submitted { request, key: None, spec: Box::new(spec), date: None });
        let taken = answer(&commands).map(|answer| match answer {
            Answer::Submitted(job) | Answer::Controlled(job) => job,
        });
        taken.expect("the job is taken")
    }

    pub fn control(&mut self, job: JobId, control: Control) -> Vec<Command> {
        self.requests += 1;
        self.on(Event::Controlled { request: RequestId(self.requests), job, control })
    }

    pub fn join(&mut self, worker: u64) -> Vec<Command> {
        self.join_with(worker, vec![])
    }

    pub fn join_with(&mut self, worker: u64, tags: Vec<String>) -> Vec<Command> {
        self.join_as(worker, Registration { instance: worker, engine: self.engine.into(), tags, ..registration() })
    }

    pub fn join_as(&mut self, worker: u64, registration: Registration) -> Vec<Command> {
        self.on(Event::Joined { worker: WorkerId(worker), registration })
    }

    /// Lets a worker rejoin in a new session with leases of an earlier one.
    pub fn rejoin(&mut self, worker: u64, leases: &[Assignment]) -> Vec<Command> {
        let held: Vec<HeldLease> = leases.iter().map(|held| self.lease(held)).collect();
        self.held.extend(leases.iter().map(|held| (WorkerId(worker), held.clone())));
        self.join_as(worker, Registration { instance: worker, held, engine: self.engine.into(), ..registration() })
    }

    /// Returns a lease as a worker reports it.
    pub fn lease(&self, held: &Assignment) -> HeldLease {
        let job = self.scheduler.spec(held.task.job).expect("the job is there").key();
        HeldLease { task: held.task, epoch: held.epoch, steps: held.work.steps.clone(), job }
    }

    /// Lets a worker join whose earlier process died while it computed these tasks.
    pub fn reborn(&mut self, worker: u64, before: u64, computing: &[Assignment]) -> Vec<Command> {
        let computing = computing.iter().map(|held| self.lease(held)).collect();
        self.held.retain(|(holder, _)| holder.0 != before);
        let died = Some(Death { instance: before, computing });
        self.join_as(worker, Registration { instance: worker, died, engine: self.engine.into(), ..registration() })
    }

    pub fn leave(&mut self, worker: u64) -> Vec<Command> {
        self.held.retain(|(holder, _)| holder.0 != worker);
        self.on(Event::Left { worker: WorkerId(worker) })
    }

    /// Returns the tasks that a worker holds, as (frame, round, kind, index), in the order of assignment.
    pub fn tasks_of(&self, worker: u64) -> Vec<(u32, u32, StageKind, u32)> {
        let own = self.held.iter().filter(|(holder, _)| holder.0 == worker);
        own.map(|(_, held)| (held.task.stage.frame, held.task.stage.round, held.task.stage.kind, held.task.index))
            .collect()
    }

    /// Returns the worker's oldest lease.
    pub fn first_of(&self, worker: u64) -> Assignment {
        self.held.iter().find(|(holder, _)| holder.0 == worker).expect("it holds a task").1.clone()
    }

    pub fn complete(&mut self, worker: u64, held: &Assignment, decision: Decision) -> Vec<Command> {
        self.complete_with(worker, held, result(held, decision))
    }

    pub fn complete_with(&mut self, worker: u64, held: &Assignment, result: TaskResult) -> Vec<Command> {
        self.drop_lease(held.task, held.epoch);
        let (task, epoch) = (held.task, held.epoch);
        self.on(Event::Completed { worker: WorkerId(worker), task, epoch, result })
    }

    pub fn fail(&mut self, worker: u64, held: &Assignment, failure: Failure) -> Vec<Command> {
        self.drop_lease(held.task, held.epoch);
        self.on(Event::Failed { worker: WorkerId(worker), task: held.task, epoch: held.epoch, failure })
    }

    /// Completes the worker's oldest task.
    pub fn work(&mut self, worker: u64, decision: Decision) -> Vec<Command> {
        let held = self.first_of(worker);
        self.complete(worker, &held, decision)
    }

    pub fn heartbeat(&mut self, worker: u64, phase: Phase, samples: u64) -> Vec<Command> {
        let own = self.held.iter().filter(|(holder, _)| holder.0 == worker);
        let tasks =
            own.map(|(_, held)| TaskProgress { task: held.task, epoch: held.epoch, phase, units: samples }).collect();
        self.on(Event::Heartbeat { worker: WorkerId(worker), tasks })
    }

    pub fn wait(&mut self, milliseconds: u64) -> Vec<Command> {
        self.now = self.now.after(milliseconds);
        self.on(Event::Elapsed)
    }

    pub fn status(&self, job: JobId) -> JobStatus {
        self.scheduler.status(job, self.now).expect("the job is there")
    }

    pub fn state(&self, job: JobId) -> JobState {
        self.status(job).state
    }
}

pub fn registration() -> Registration {
    Registration {
        name: "w".into(),
        instance: 0,
        engine: "e".into(),
        threads: 2,
        slots: 1,
        tags: vec![],
        held: vec![],
        died: None,
    }
}

pub fn answer(commands: &[Command]) -> Option<Answer> {
    commands.iter().find_map(|command| match command {
        Command::Answer { answer, .. } => answer.clone().ok(),
        _ => None,
    })
}

/// Returns the result that a correct worker reports.
pub fn result(held: &Assignment, decision: Decision) -> TaskResult {
    result_in(held, decision, 0.5)
}

/// Returns the result that a correct worker reports after `seconds` of work; join tasks take less.
pub fn result_in(held: &Assignment, decision: Decision, seconds: f64) -> TaskResult {
    let Work { steps, more, .. } = &held.work;
    let decision = if *more == More::Last { Decision::Done } else { decision };
    let output = |role: Role| {
        let artifact = Artifact::of(format!("{} {} {steps:?}", role.name(), held.task).as_bytes());
        Output { role, artifact }
    };
    let all = |roles: &[Role]| roles.iter().copied().map(output).collect::<Vec<_>>();
    let goes_on = decision != Decision::Done;
    match held.task.stage.kind {
        StageKind::Render => {
            let units = steps.len() as u64 * 64;
            TaskResult { outputs: all(&[Role::Tile]), units, bad_samples: 1, seconds, ..TaskResult::default() }
        }
        StageKind::Reduce if *more == More::Rounds => {
            TaskResult { outputs: all(&[Role::Pixels, Role::Sums]), seconds: seconds / 4.0, ..TaskResult::default() }
        }
        StageKind::Image => {
            // The sums of an image that reads pixels are made where the pixels are made.
            let reads_tiles = held.work.of_role(Role::Tile).next().is_some();
            let outputs = match (goes_on, reads_tiles) {
                (true, true) => all(&[Role::Sums]),
                (true, false) => vec![],
                (false, _) => all(&[Role::Image]),
            };
            let (relative_error, decision) = (Some(0.1), Some(decision));
            TaskResult { outputs, relative_error, decision, seconds: seconds / 2.0, ..TaskResult::default() }
        }
        _ => TaskResult { outputs: all(&[Role::Pixels]), seconds: seconds / 4.0, ..TaskResult::default() },
    }
}

pub fn panic() -> Failure {
    Failure::Panicked { message: "oops".into() }
}
