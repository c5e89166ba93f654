//! Simulated user and operator, who submits and changes jobs, fetches and compares frames, and maintains the farm.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::common::{TestFolder, file_names, pixels};
use crate::farm::{Farm, WORKERS};
use crate::faults::Rng;

/// Settings of a job: three frames of four tiles; a tile takes some hundredths of a second.
const SETTINGS: &str = "--spp 64 --size 32x32 --frames 1..3";
/// Number of different seeds of jobs.
const SEEDS: usize = 3;
/// Number of jobs that run at the same time.
const MAX_RUNNING: usize = 4;
/// Time in which the jobs must end after the last fault.
const END_TIMEOUT: Duration = Duration::from_secs(120);
/// Interval between two drained workers, and between two garbage collections.
const MAINTENANCE_INTERVAL: Duration = Duration::from_secs(30);

/// Bits of the frames by file name.
type FrameBits = BTreeMap<String, Vec<u32>>;

/// Renders the frames of each seed in one process, for comparison.
pub fn reference_frames(dir: &TestFolder) -> Vec<FrameBits> {
    let render = |seed| {
        let folder = format!("alone{seed}");
        dir.run(&format!("render fog.mgf -o {folder} {SETTINGS} --seed {seed}")).exits(0);
        frames(dir, &folder)
    };
    (0..SEEDS).map(render).collect()
}

fn frames(dir: &TestFolder, folder: &str) -> FrameBits {
    let folder = dir.path(folder);
    file_names(&folder).into_iter().map(|name| (name.clone(), pixels(&folder.join(name)))).collect()
}

/// Summary of the user's actions and findings.
#[derive(Debug, Default, Serialize)]
pub struct UserSummary {
    pub submitted: u64,
    pub done: u64,
    pub cancelled: u64,
    pub frames_compared: u64,
    /// Number of successful requests by command.
    pub asked: BTreeMap<&'static str, u64>,
    /// Violations that must never happen.
    pub wrong: Vec<String>,
}

/// Remaining steps for a job, and its expected end.
struct JobPlan {
    steps: VecDeque<(Instant, &'static str)>,
    end: &'static str,
}

impl JobPlan {
    fn random(draw: &mut Rng) -> Self {
        let steps: &[&'static str] = match draw.below(10) {
            0 => &["cancel"],
            1 => &["cancel", "retry"],
            2 => &["pause", "resume"],
            3 => &["priority"],
            _ => &[],
        };
        let mut at = Instant::now();
        let mut later = |step| {
            at += Duration::from_millis(draw.below(3_000));
            (at, step)
        };
        let end = if steps == ["cancel"] { "cancelled" } else { "done" };
        Self { steps: steps.iter().copied().map(&mut later).collect(), end }
    }
}

/// State of the simulated user.
struct SimulatedUser<'a> {
    farm: &'a Farm,
    reference: &'a [FrameBits],
    rng: Rng,
    plans: BTreeMap<u64, JobPlan>,
    seen: BTreeSet<u64>,
    tally: UserSummary,
}

/// Keeps the farm busy until `end`, then waits for the last jobs.
pub fn run_user(farm: &Farm, reference: &[FrameBits], seed: u64, end: Instant) -> UserSummary {
    let (plans, seen, tally) = (BTreeMap::new(), BTreeSet::new(), UserSummary::default());
    let mut user = SimulatedUser { farm, reference, rng: Rng(!seed), plans, seen, tally };
    let mut round = Instant::now() + MAINTENANCE_INTERVAL;
    loop {
        let now = Instant::now();
        let left = user.check_jobs();
        if now >= end && left == Some(0) {
            break;
        }
        if now >= end + END_TIMEOUT {
            user.tally.wrong.push(format!("{left:?} jobs have not ended: {:?}", user.plans.keys()));
            break;
        }
        if now < end && left.is_some_and(|left| left < MAX_RUNNING) {
            user.submit();
        }
        if now >= round {
            user.do_maintenance();
            round = Instant::now() + MAINTENANCE_INTERVAL;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    user.tally
}

impl SimulatedUser<'_> {
    /// Runs a command. Returns whether it succeeded.
    fn run_command(&mut self, command: &'static str, arguments: &str) -> bool {
        let ran = self.farm.dir.run(&format!("{command} {arguments} --server {}", self.farm.url));
        let is_done = ran.code() == Some(0);
        if is_done {
            *self.tally.asked.entry(command).or_default() += 1;
        }
        is_done
    }

    fn submit(&mut self) {
        let seed = self.rng.below(SEEDS as u64);
        // A job whose answer is lost may exist: it is found later in the list of jobs.
        if self.run_command("submit", &format!("fog.mgf {SETTINGS} --seed {seed} --owner {seed}")) {
            self.tally.submitted += 1;
        }
    }

    /// Checks every job and executes its next step. Returns the number of unfinished jobs, if the farm answers.
    fn check_jobs(&mut self) -> Option<usize> {
        let ran = self.farm.dir.run(&format!("jobs --json --server {}", self.farm.url));
        if ran.code() != Some(0) {
            return None;
        }
        let mut left = 0;
        let jobs = ran.json();
        for job in jobs.as_array().expect("a list") {
            let number = job["job"].as_u64().expect("a number");
            if !self.seen.contains(&number) && !self.has_finished(number, job) {
                left += 1;
            }
        }
        let listed: BTreeSet<u64> =
            jobs.as_array().into_iter().flatten().filter_map(|job| job["job"].as_u64()).collect();
        let lost: Vec<u64> = self.plans.keys().copied().filter(|number| !listed.contains(number)).collect();
        for number in lost {
            self.plans.remove(&number);
            self.tally.wrong.push(format!("job {number} is gone, and nobody has seen it end"));
        }
        Some(left)
    }

    fn has_finished(&mut self, number: u64, job: &serde_json::Value) -> bool {
        let state = job["state"].as_str().expect("a state");
        let has_ended = ["done", "cancelled", "failed"].contains(&state);
        let plan = self.plans.entry(number).or_insert_with(|| JobPlan::random(&mut self.rng));
        if let Some(&(at, step)) = plan.steps.front() {
            // A finished job cannot be changed any more, and an ended one can only be retried.
            let is_idle = state == "done" || (has_ended && step != "retry");
            if is_idle {
                plan.steps.pop_front();
            } else if Instant::now() >= at {
                let rest = if step == "priority" { format!("{number} 90") } else { number.to_string() };
                if self.run_command(step, &rest)
                    && let Some(plan) = self.plans.get_mut(&number)
                {
                    plan.steps.pop_front();
                }
            }
            return false;
        }
        let expected = plan.end;
        has_ended && self.check_frames(number, job, state, expected)
    }

    /// Fetches and compares the frames; returns `false` if the farm does not allow it now.
    fn check_frames(&mut self, number: u64, job: &serde_json::Value, state: &str, expected: &str) -> bool {
        let folder = format!("out{number}");
        let fetched = self.farm.dir.run(&format!("fetch {number} -o {folder} --server {}", self.farm.url));
        let found = frames(&self.farm.dir, &folder);
        let whole = job["frames_done"].as_u64() == Some(found.len() as u64);
        if !whole || fetched.code() == Some(4) {
            return false;
        }
        let seed: usize = job["owner"].as_str().and_then(|owner| owner.parse().ok()).expect("a seed");
        let reference = &self.reference[seed];
        let are_right = found.iter().all(|(name, bits)| reference.get(name) == Some(bits));
        let is_right = match state {
            "done" => found.len() == reference.len() && job["samples"] == job["samples_most"],
            "cancelled" => expected == "cancelled",
            _ => false,
        };
        if !are_right || !is_right {
            self.tally.wrong.push(format!("job {number} should be {expected}; pixels right: {are_right}; {job}"));
        }
        self.tally.frames_compared += found.len() as u64;
        *(if state == "done" { &mut self.tally.done } else { &mut self.tally.cancelled }) += 1;
        self.plans.remove(&number);
        self.seen.insert(number);
        std::fs::remove_dir_all(self.farm.dir.path(&folder)).ok();
        true
    }

    /// Acts as the operator: drains a worker for a moment and collects garbage.
    fn do_maintenance(&mut self) {
        let worker = self.rng.below(WORKERS as u64);
        self.run_command("drain", &format!("w{worker}"));
        self.run_command("gc", "--grace 60s");
        for worker in 0..WORKERS {
            // A worker that is not connected is not drained; one that stays away longer is undrained the next time.
            self.farm.dir.run(&format!("drain w{worker} --undo --server {}", self.farm.url));
        }
    }
}
