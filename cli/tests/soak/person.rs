//! Simulated user and operator, who submits and changes jobs, fetches and compares frames, and maintains the farm.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::common::{Place, names, pixels};
use crate::farm::{Farm, WORKERS};
use crate::faults::Draw;

/// Settings of a job: three frames of four tiles; a tile takes some hundredths of a second.
const SETTINGS: &str = "--spp 64 --size 32x32 --frames 1..3";
/// Number of different seeds of jobs.
const SEEDS: usize = 3;
/// Number of jobs that run at the same time.
const AT_ONCE: usize = 4;
/// Time in which the jobs must end after the last fault.
const LAST: Duration = Duration::from_secs(120);
/// Interval between two drained workers, and between two garbage collections.
const ROUND: Duration = Duration::from_secs(30);

/// Bits of the frames by file name.
type Frames = BTreeMap<String, Vec<u32>>;

/// Renders the frames of each seed in one process, for comparison.
pub fn alone(place: &Place) -> Vec<Frames> {
    let render = |seed| {
        let folder = format!("alone{seed}");
        place.run(&format!("render fog.mgf -o {folder} {SETTINGS} --seed {seed}")).exits(0);
        frames(place, &folder)
    };
    (0..SEEDS).map(render).collect()
}

fn frames(place: &Place, folder: &str) -> Frames {
    let folder = place.path(folder);
    names(&folder).into_iter().map(|name| (name.clone(), pixels(&folder.join(name)))).collect()
}

/// Summary of the user's actions and findings.
#[derive(Debug, Default, Serialize)]
pub struct Tally {
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
struct Plan {
    steps: VecDeque<(Instant, &'static str)>,
    end: &'static str,
}

impl Plan {
    fn draw(draw: &mut Draw) -> Self {
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
struct Person<'a> {
    farm: &'a Farm,
    alone: &'a [Frames],
    draw: Draw,
    plans: BTreeMap<u64, Plan>,
    seen: BTreeSet<u64>,
    tally: Tally,
}

/// Keeps the farm busy until `end`, then waits for the last jobs.
pub fn work(farm: &Farm, alone: &[Frames], seed: u64, end: Instant) -> Tally {
    let (plans, seen, tally) = (BTreeMap::new(), BTreeSet::new(), Tally::default());
    let mut person = Person { farm, alone, draw: Draw(!seed), plans, seen, tally };
    let mut round = Instant::now() + ROUND;
    loop {
        let now = Instant::now();
        let left = person.look();
        if now >= end && left == Some(0) {
            break;
        }
        if now >= end + LAST {
            person.tally.wrong.push(format!("{left:?} jobs have not ended: {:?}", person.plans.keys()));
            break;
        }
        if now < end && left.is_some_and(|left| left < AT_ONCE) {
            person.submit();
        }
        if now >= round {
            person.look_after();
            round = Instant::now() + ROUND;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    person.tally
}

impl Person<'_> {
    /// Runs a command. Returns whether it succeeded.
    fn asks(&mut self, what: &'static str, rest: &str) -> bool {
        let ran = self.farm.place.run(&format!("{what} {rest} --server {}", self.farm.url));
        let is_done = ran.code() == Some(0);
        if is_done {
            *self.tally.asked.entry(what).or_default() += 1;
        }
        is_done
    }

    fn submit(&mut self) {
        let seed = self.draw.below(SEEDS as u64);
        // A job whose answer is lost may exist: it is found later in the list of jobs.
        if self.asks("submit", &format!("fog.mgf {SETTINGS} --seed {seed} --owner {seed}")) {
            self.tally.submitted += 1;
        }
    }

    /// Checks every job and executes its next step. Returns the number of unfinished jobs, if the farm answers.
    fn look(&mut self) -> Option<usize> {
        let ran = self.farm.place.run(&format!("jobs --json --server {}", self.farm.url));
        if ran.code() != Some(0) {
            return None;
        }
        let mut left = 0;
        let jobs = ran.json();
        for job in jobs.as_array().expect("a list") {
            let number = job["job"].as_u64().expect("a number");
            if !self.seen.contains(&number) && !self.settled(number, job) {
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

    fn settled(&mut self, number: u64, job: &serde_json::Value) -> bool {
        let state = job["state"].as_str().expect("a state");
        let has_ended = ["done", "cancelled", "failed"].contains(&state);
        let plan = self.plans.entry(number).or_insert_with(|| Plan::draw(&mut self.draw));
        if let Some(&(at, step)) = plan.steps.front() {
            // A finished job cannot be changed any more, and an ended one can only be retried.
            let is_idle = state == "done" || (has_ended && step != "retry");
            if is_idle {
                plan.steps.pop_front();
            } else if Instant::now() >= at {
                let rest = if step == "priority" { format!("{number} 90") } else { number.to_string() };
                if self.asks(step, &rest)
                    && let Some(plan) = self.plans.get_mut(&number)
                {
                    plan.steps.pop_front();
                }
            }
            return false;
        }
        let expected = plan.end;
        has_ended && self.ended(number, job, state, expected)
    }

    /// Fetches and compares the frames; returns `false` if the farm does not allow it now.
    fn ended(&mut self, number: u64, job: &serde_json::Value, state: &str, expected: &str) -> bool {
        let folder = format!("out{number}");
        let fetched = self.farm.place.run(&format!("fetch {number} -o {folder} --server {}", self.farm.url));
        let found = frames(&self.farm.place, &folder);
        let whole = job["frames_done"].as_u64() == Some(found.len() as u64);
        if !whole || fetched.code() == Some(4) {
            return false;
        }
        let seed: usize = job["owner"].as_str().and_then(|owner| owner.parse().ok()).expect("a seed");
        let alone = &self.alone[seed];
        let are_right = found.iter().all(|(name, bits)| alone.get(name) == Some(bits));
        let is_right = match state {
            "done" => found.len() == alone.len() && job["samples"] == job["samples_most"],
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
        std::fs::remove_dir_all(self.farm.place.path(&folder)).ok();
        true
    }

    /// Acts as the operator: drains a worker for a moment and collects garbage.
    fn look_after(&mut self) {
        let worker = self.draw.below(WORKERS as u64);
        self.asks("drain", &format!("w{worker}"));
        self.asks("gc", "--grace 60s");
        for worker in 0..WORKERS {
            // A worker that is not connected is not drained; one that stays away longer is undrained the next time.
            self.farm.place.run(&format!("drain w{worker} --undo --server {}", self.farm.url));
        }
    }
}
