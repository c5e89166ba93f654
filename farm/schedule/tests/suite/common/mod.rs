//! A simulated farm: a scheduler, its log, and workers that the test controls.
#![allow(dead_code, reason = "each test file uses its part")]

use std::collections::{BTreeMap, BTreeSet};

use femc_model::*;
use femc_schedule::*;

/// Creates a job of square films of `tiles` tiles in a row, whose images are made directly from tiles.
pub fn job(frames: &[u32], tiles: u32, rounds: &[u32]) -> JobSpec {
    job_with_graph(frames, tiles, tile_graph(tiles, rounds, 0))
}

/// Creates such a job, whose images are made from groups of `fan` tiles.
pub fn grouped_job(frames: &[u32], tiles: u32, rounds: &[u32], fan: u32) -> JobSpec {
    job_with_graph(frames, tiles, tile_graph(tiles, rounds, fan))
}

/// Returns the number of the stage of this kind in such jobs.
pub fn stage_number(spec: &JobSpec, kind: StageKind) -> u16 {
    spec.graph.iter().find(|(_, template)| template.kind == kind).expect("it has such a stage").0
}

/// Creates the graph of such a job, with tiles of 64 pixels.
pub fn tile_graph(tiles: u32, rounds: &[u32], fan: u32) -> Graph {
    testing::frame_graph(TaskSizes::even(tiles, 64), rounds, fan)
}

/// Creates a job with this graph.
pub fn job_with_graph(frames: &[u32], tiles: u32, graph: Graph) -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: Digest::compute(b"bundle"),
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
pub struct TestFarm {
    pub scheduler: Scheduler,
    pub now: Tick,
    pub log: Vec<(Tick, Fact)>,
    /// Leases as the workers know them.
    pub leases: Vec<(WorkerId, Assignment)>,
    /// Leases revoked by the last commands.
    pub revoked: Vec<(WorkerId, Assignment)>,
    /// Build of the engine of joining workers.
    pub engine: &'static str,
    requests: u64,
    /// Leases of each session with their owner, oldest first, derived only from the messages.
    session_leases: BTreeMap<WorkerId, BTreeMap<(Epoch, TaskKey), String>>,
    /// Milliseconds of worker time charged to each owner since the last start.
    pub charged: BTreeMap<String, u64>,
    last_event: Tick,
}

impl TestFarm {
    pub fn new() -> Self {
        Self::with_config(config())
    }

    pub fn with_config(config: Config) -> Self {
        Self::from_ledger(config, Ledger::default())
    }

    /// Creates a farm that continues from this ledger. Its log lacks the facts before.
    pub fn from_ledger(config: Config, ledger: Ledger) -> Self {
        let now = ledger.now();
        let (scheduler, opened) = Scheduler::new(config, ledger);
        Self {
            scheduler,
            now,
            log: vec![(now, opened)],
            leases: vec![],
            revoked: vec![],
            engine: "e",
            requests: 0,
            session_leases: BTreeMap::new(),
            charged: BTreeMap::new(),
            last_event: now,
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
        self.leases.clear();
        self.session_leases.clear();
        self.charged = self.scheduler.used_times().map(|(owner, used)| (owner.to_owned(), used.charged)).collect();
    }

    /// Returns the owners of each session's oldest lease.
    pub fn served_owners(&self) -> BTreeSet<&str> {
        self.session_leases
            .values()
            .filter_map(|held| held.first_key_value())
            .map(|(_, owner)| owner.as_str())
            .collect()
    }

    /// Charges the time since the last event: that of each worker to the owner of its oldest lease.
    fn charge_elapsed(&mut self) {
        let elapsed = self.now.since(std::mem::replace(&mut self.last_event, self.now));
        for owner in self.session_leases.values().filter_map(|held| held.values().next()) {
            *self.charged.entry(owner.clone()).or_default() += elapsed;
        }
    }

    /// Owner's name that stands for shared jobs.
    pub const SHARED: &str = "";

    fn owner(&self, job: JobId) -> String {
        let owner = &self.scheduler.spec(job).expect("the job is there").owner;
        if job.is_shared() { Self::SHARED.to_owned() } else { owner.clone() }
    }

    /// Updates the leases of the sessions after an event.
    fn update_sessions(&mut self, event: &Event, commands: &[Command]) {
        match event {
            Event::Left { worker } => drop(self.session_leases.remove(worker)),
            Event::Completed { worker, task, epoch, .. }
            | Event::Failed { worker, task, epoch, .. }
            | Event::ArtifactMissing { worker, task, epoch, .. } => {
                self.session_leases.entry(*worker).or_default().remove(&(*epoch, *task));
            }
            Event::Joined { worker, registration } => {
                for held in &registration.held {
                    let is_refused = |command: &Command| matches!(command, Command::Revoke { worker: to, task, epoch, .. } if (to, *task, *epoch) == (worker, held.task, held.epoch));
                    if !commands.iter().any(is_refused) {
                        let key = (held.epoch, held.task);
                        self.session_leases.values_mut().for_each(|leases| drop(leases.remove(&key)));
                        let owner = self.owner(held.task.job);
                        self.session_leases.entry(*worker).or_default().insert((held.epoch, held.task), owner);
                    }
                }
            }
            _ => {}
        }
        for command in commands {
            match command {
                Command::Dismiss { worker } => drop(self.session_leases.remove(worker)),
                Command::Revoke { worker, task, epoch, .. } => {
                    self.session_leases.entry(*worker).or_default().remove(&(*epoch, *task));
                }
                Command::Assign { worker, assignment: Assignment { task, epoch, .. } } => {
                    let owner = self.owner(task.job);
                    self.session_leases.entry(*worker).or_default().insert((*epoch, *task), owner);
                }
                _ => {}
            }
        }
    }

    pub fn handle(&mut self, event: Event) -> Vec<Command> {
        self.charge_elapsed();
        let received = event.clone();
        let commands = self.scheduler.handle(event, self.now);
        self.update_sessions(&received, &commands);
        self.revoked.clear();
        for command in &commands {
            match command {
                Command::Record(fact) => self.log.push((self.now, fact.clone())),
                Command::Assign { worker, assignment } => self.leases.push((*worker, assignment.clone())),
                Command::Revoke { task, epoch, .. } => {
                    self.revoked.extend(self.leases.iter().filter(|(_, held)| held.epoch == *epoch).cloned());
                    self.drop_lease(*task, *epoch);
                }
                _ => {}
            }
        }
        commands
    }

    pub fn drop_lease(&mut self, task: TaskKey, epoch: Epoch) {
        self.leases.retain(|(_, held)| (held.task, held.epoch) != (task, epoch));
    }

    pub fn submit(&mut self, spec: JobSpec) -> JobId {
        self.requests += 1;
        let request = RequestId(self.requests);
        let commands = self.handle(Event::Submitted { request, key: None, spec: Box::new(spec), date: None });
        let submitted = find_answer(&commands).map(|answer| match answer {
            Answer::Submitted(job) | Answer::Controlled(job) => job,
        });
        submitted.expect("the job is taken")
    }

    pub fn control(&mut self, job: JobId, control: Control) -> Vec<Command> {
        self.requests += 1;
        self.handle(Event::Controlled { request: RequestId(self.requests), job, control })
    }

    pub fn join(&mut self, worker: u64) -> Vec<Command> {
        self.join_with(worker, vec![])
    }

    pub fn join_with(&mut self, worker: u64, tags: Vec<String>) -> Vec<Command> {
        self.join_as(worker, Registration { instance: worker, engine: self.engine.into(), tags, ..registration() })
    }

    pub fn join_as(&mut self, worker: u64, registration: Registration) -> Vec<Command> {
        self.handle(Event::Joined { worker: WorkerId(worker), registration })
    }

    /// Lets a worker rejoin in a new session with leases of an earlier one.
    pub fn rejoin(&mut self, worker: u64, leases: &[Assignment]) -> Vec<Command> {
        let held: Vec<HeldLease> = leases.iter().map(|held| self.held_lease(held)).collect();
        self.leases.extend(leases.iter().map(|held| (WorkerId(worker), held.clone())));
        self.join_as(worker, Registration { instance: worker, held, engine: self.engine.into(), ..registration() })
    }

    /// Returns a lease as a worker reports it.
    pub fn held_lease(&self, held: &Assignment) -> HeldLease {
        let job = self.scheduler.spec(held.task.job).expect("the job is there").key();
        HeldLease { task: held.task, epoch: held.epoch, steps: held.spec.steps.clone(), job }
    }

    /// Lets a worker join whose earlier process died while it computed these tasks.
    pub fn join_after_death(&mut self, worker: u64, before: u64, computing: &[Assignment]) -> Vec<Command> {
        let computing = computing.iter().map(|held| self.held_lease(held)).collect();
        self.leases.retain(|(holder, _)| holder.0 != before);
        let died = Some(Death { instance: before, computing });
        self.join_as(
            worker,
            Registration { instance: worker, death: died, engine: self.engine.into(), ..registration() },
        )
    }

    pub fn leave(&mut self, worker: u64) -> Vec<Command> {
        self.leases.retain(|(holder, _)| holder.0 != worker);
        self.handle(Event::Left { worker: WorkerId(worker) })
    }

    /// Returns the tasks that a worker holds, as (frame, round, kind, index), in the order of assignment.
    pub fn tasks_of(&self, worker: u64) -> Vec<(u32, u32, StageKind, u32)> {
        let own = self.leases.iter().filter(|(holder, _)| holder.0 == worker);
        own.map(|(_, held)| (held.task.stage.frame, held.task.stage.round, held.task.stage.kind, held.task.index))
            .collect()
    }

    /// Returns the worker's oldest lease.
    pub fn first_lease_of(&self, worker: u64) -> Assignment {
        self.leases.iter().find(|(holder, _)| holder.0 == worker).expect("it holds a task").1.clone()
    }

    pub fn complete(&mut self, worker: u64, held: &Assignment, decision: Decision) -> Vec<Command> {
        self.complete_with(worker, held, result_of(held, decision))
    }

    pub fn complete_with(&mut self, worker: u64, held: &Assignment, result: TaskResult) -> Vec<Command> {
        self.drop_lease(held.task, held.epoch);
        let (task, epoch) = (held.task, held.epoch);
        self.handle(Event::Completed { worker: WorkerId(worker), task, epoch, result })
    }

    pub fn fail(&mut self, worker: u64, held: &Assignment, failure: Failure) -> Vec<Command> {
        self.drop_lease(held.task, held.epoch);
        self.handle(Event::Failed { worker: WorkerId(worker), task: held.task, epoch: held.epoch, failure })
    }

    /// Completes the worker's oldest task.
    pub fn complete_first(&mut self, worker: u64, decision: Decision) -> Vec<Command> {
        let held = self.first_lease_of(worker);
        self.complete(worker, &held, decision)
    }

    pub fn heartbeat(&mut self, worker: u64, phase: Phase, samples: u64) -> Vec<Command> {
        let own = self.leases.iter().filter(|(holder, _)| holder.0 == worker);
        let tasks =
            own.map(|(_, held)| TaskProgress { task: held.task, epoch: held.epoch, phase, units: samples }).collect();
        self.handle(Event::Heartbeat { worker: WorkerId(worker), tasks })
    }

    pub fn wait(&mut self, milliseconds: u64) -> Vec<Command> {
        self.now = self.now.after(milliseconds);
        self.handle(Event::Elapsed)
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
        death: None,
    }
}

pub fn find_answer(commands: &[Command]) -> Option<Answer> {
    commands.iter().find_map(|command| match command {
        Command::Answer { answer, .. } => answer.clone().ok(),
        _ => None,
    })
}

/// Returns the result that a correct worker reports.
pub fn result_of(held: &Assignment, decision: Decision) -> TaskResult {
    result_in(held, decision, 0.5)
}

/// Returns the result that a correct worker reports after `seconds` of work; join tasks take less.
pub fn result_in(held: &Assignment, decision: Decision, seconds: f64) -> TaskResult {
    let TaskSpec { steps, next_round: more, .. } = &held.spec;
    let decision = if *more == NextRound::Impossible { Decision::Done } else { decision };
    let output = |role: Role| {
        let artifact = Artifact::from_bytes(format!("{} {} {steps:?}", role.name(), held.task).as_bytes());
        Output { role, artifact }
    };
    let all = |roles: &[Role]| roles.iter().copied().map(output).collect::<Vec<_>>();
    let continues = decision != Decision::Done;
    match held.task.stage.kind {
        StageKind::Render => {
            let units = steps.len() as u64 * 64;
            TaskResult { outputs: all(&[Role::Tile]), units, bad_samples: 1, seconds, ..TaskResult::default() }
        }
        StageKind::Reduce if *more == NextRound::Possible => {
            TaskResult { outputs: all(&[Role::Pixels, Role::Sums]), seconds: seconds / 4.0, ..TaskResult::default() }
        }
        StageKind::Image => {
            // The sums of an image that reads pixels are made where the pixels are made.
            let reads_tiles = held.spec.inputs_of_role(Role::Tile).next().is_some();
            let outputs = match (continues, reads_tiles) {
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

pub fn panic_failure() -> Failure {
    Failure::Panicked { message: "oops".into() }
}
