//! Tests of how owners share the farm's time, and what they are charged.

use std::collections::BTreeMap;

use crate::common;
use crate::common::{TestFarm, config, job, registration, result_in};
use femc_model::*;
use femc_schedule::*;

fn job_of(owner: &str, tiles: u32) -> JobSpec {
    JobSpec { owner: owner.into(), ..job(&[1], tiles, &[8]) }
}

/// Returns the milliseconds charged to each owner.
fn charged(farm: &TestFarm) -> BTreeMap<String, u64> {
    farm.scheduler
        .used_times()
        .map(|(owner, used)| (owner.to_owned(), used.charged))
        .filter(|(_, held)| *held > 0)
        .collect()
}

fn owner_of(farm: &TestFarm, held: &Assignment) -> String {
    farm.scheduler.spec(held.task.job).expect("the job is there").owner.clone()
}

/// Workers that each compute their oldest task, in parallel. A task takes the time of its job's tasks.
#[derive(Default)]
struct ParallelWorkers {
    /// Present task of each worker, and the time at which it is done.
    running: BTreeMap<u64, (Epoch, Tick)>,
    /// Milliseconds of finished work, by owner.
    work_done: BTreeMap<String, u64>,
    /// Owners of the finished tasks, in order.
    order: Vec<String>,
}

impl ParallelWorkers {
    /// Completes `tasks` tasks one after the other.
    fn complete_tasks(&mut self, farm: &mut TestFarm, tasks: usize, duration_of: impl Fn(&str) -> u64) {
        for _ in 0..tasks {
            let workers: Vec<u64> = farm.scheduler.workers(farm.now).iter().map(|worker| worker.worker.0).collect();
            for worker in workers.into_iter().filter(|&worker| !farm.tasks_of(worker).is_empty()) {
                let first = farm.first_lease_of(worker);
                let end = farm.now.after(duration_of(&owner_of(farm, &first)));
                let at = self.running.entry(worker).or_insert((first.epoch, end));
                if at.0 != first.epoch {
                    *at = (first.epoch, end);
                }
            }
            let (&worker, &(_, end)) = self.running.iter().min_by_key(|(_, (_, end))| *end).expect("somebody works");
            self.running.remove(&worker);
            farm.wait(end.since(farm.now));
            let held = farm.first_lease_of(worker);
            let owner = owner_of(farm, &held);
            let milliseconds = duration_of(&owner);
            farm.complete_with(worker, &held, result_in(&held, Decision::Done, milliseconds as f64 / 1000.0));
            *self.work_done.entry(owner.clone()).or_default() += milliseconds;
            self.order.push(owner);
        }
    }
}

/// Returns a configuration in which leases last forever, so that no heartbeats are needed, and no worker works out of turn.
fn patient_config() -> Config {
    Config { lease: 1 << 40, late: 1 << 40, work_per_lease: 0, ..config() }
}

#[test]
fn owners_share_the_time_by_their_weights() {
    let mut farm = TestFarm::with_config(Config { weights: [("ann".to_owned(), 3)].into(), ..patient_config() });
    farm.submit(job_of("ann", 4000));
    farm.submit(job_of("bob", 4000));
    (1..=4).for_each(|worker| drop(farm.join(worker)));
    let mut workers = ParallelWorkers::default();
    // Bob's tasks take twice as long: time is shared, not the number of tasks.
    workers.complete_tasks(&mut farm, 800, |owner| if owner == "ann" { 250 } else { 500 });
    let (ann, bob) = (workers.work_done["ann"], workers.work_done["bob"]);
    let share = ann as f64 / (ann + bob) as f64;
    assert!((share - 0.75).abs() < 0.02, "{ann} {bob}: {share}");
}

#[test]
fn fifty_machine_deaths_do_not_use_up_owners_share() {
    let mut farm = TestFarm::with_config(patient_config());
    farm.submit(JobSpec { tags: vec!["lab".into()], ..job_of("ann", 400) });
    farm.submit(JobSpec { tags: vec!["hall".into()], ..job_of("bob", 400) });
    let machine = |tags: &[&str], instance| Registration {
        tags: tags.iter().map(|&tag| tag.to_owned()).collect(),
        instance,
        ..registration()
    };
    for life in 1..=50 {
        farm.join_as(life, machine(&["lab"], life));
        farm.wait(10);
        farm.leave(life);
    }
    assert_eq!(charged(&farm), [("ann".to_owned(), 500)].into(), "ten milliseconds each time");
    farm.join_as(51, machine(&["lab", "hall"], 51));
    let mut workers = ParallelWorkers::default();
    workers.complete_tasks(&mut farm, 400, |_| 250);
    let before = workers.order.iter().position(|owner| owner == "ann").expect("ann is served");
    assert!(before <= 3, "{before} of bob's tasks went first");
    assert!(workers.work_done["ann"].abs_diff(workers.work_done["bob"]) <= 4 * 250, "{:?}", workers.work_done);
}

#[test]
fn what_owners_have_used_is_known_after_a_restart() {
    let mut farm = TestFarm::with_config(patient_config());
    farm.submit(job_of("ann", 400));
    farm.join(1);
    let mut workers = ParallelWorkers::default();
    workers.complete_tasks(&mut farm, 100, |_| 250);
    farm.submit(job_of("bob", 400));
    workers.complete_tasks(&mut farm, 100, |_| 250);
    let (before, now) = (charged(&farm), farm.now);
    assert_eq!(before.values().sum::<u64>(), now.0, "the worker's time, to the millisecond");
    // A killed coordinator loses at most five seconds of each worker.
    farm.restart();
    let after = charged(&farm);
    let forgotten = before.values().sum::<u64>() - after.values().sum::<u64>();
    assert!(forgotten <= Scheduler::CHARGE_INTERVAL && after["ann"] > 20_000, "{before:?} {after:?}");
    // Bob came when ann had used 25 s. Neither of them has to make up for the difference.
    farm.join(2);
    let mut workers = ParallelWorkers::default();
    workers.complete_tasks(&mut farm, 40, |_| 250);
    assert!(
        workers.work_done["ann"].abs_diff(workers.work_done["bob"]) <= Scheduler::CHARGE_INTERVAL,
        "{:?}",
        workers.work_done
    );
}

#[test]
fn leveled_owner_stays_level_after_immediate_coordinator_kill() {
    let mut farm = TestFarm::with_config(patient_config());
    farm.submit(job_of("ann", 4000));
    farm.join(1);
    ParallelWorkers::default().complete_tasks(&mut farm, 400, |_| 250);
    farm.submit(job_of("bob", 400));
    farm.restart();
    farm.join(2);
    let mut workers = ParallelWorkers::default();
    workers.complete_tasks(&mut farm, 100, |_| 250);
    assert!(
        workers.work_done["ann"].abs_diff(workers.work_done["bob"]) <= 2 * Scheduler::CHARGE_INTERVAL,
        "{:?}",
        workers.work_done
    );
}

#[test]
fn newcomer_on_idle_farm_does_not_shut_out_earlier_owners() {
    let mut farm = TestFarm::with_config(patient_config());
    farm.submit(job_of("ann", 400));
    farm.join(1);
    ParallelWorkers::default().complete_tasks(&mut farm, 401, |_| 250);
    farm.submit(job_of("bob", 400));
    farm.submit(job_of("ann", 400));
    let mut workers = ParallelWorkers::default();
    workers.complete_tasks(&mut farm, 100, |_| 250);
    assert!(workers.work_done["ann"].abs_diff(workers.work_done["bob"]) <= 4 * 250, "{:?}", workers.work_done);
}

#[test]
fn lease_is_charged_once_for_its_held_time_however_it_ends() {
    let single = Config { prefetch: 0, stall: 3_000, lease: 5_000, ..config() };
    let mut farm = TestFarm::with_config(single);
    let id = farm.submit(job_of("ann", 40));
    let ann = |farm: &TestFarm| charged(farm).get("ann").copied().unwrap_or(0);
    farm.join(1);
    let mut sum = 0;
    let mut advance = |farm: &mut TestFarm, milliseconds| {
        farm.now = farm.now.after(milliseconds);
        sum += milliseconds;
        sum
    };
    // The charge does not depend on the duration that the worker reports.
    let expected = advance(&mut farm, 700);
    let held = farm.first_lease_of(1);
    farm.complete_with(1, &held, result_in(&held, Decision::Done, 0.001));
    assert_eq!(ann(&farm), expected, "done");
    let expected = advance(&mut farm, 301);
    let held = farm.first_lease_of(1);
    farm.fail(1, &held, common::panic_failure());
    assert_eq!(ann(&farm), expected, "failed");
    let expected = advance(&mut farm, 53);
    farm.leave(1);
    assert_eq!(ann(&farm), expected, "lost");
    farm.now = farm.now.after(10_000);
    farm.join(2);
    assert_eq!(ann(&farm), expected, "nobody had anything");
    let held = farm.first_lease_of(2);
    farm.handle(Event::Draining { worker: WorkerId(2) });
    let expected = advance(&mut farm, 11);
    farm.rejoin(3, std::slice::from_ref(&held));
    assert!(advance(&mut farm, 17) > expected);
    let expected = expected + 17;
    farm.leave(3);
    assert_eq!(ann(&farm), expected, "handed over to another session: the same lease");
    farm.join(4);
    let expected = advance(&mut farm, 5_000);
    farm.handle(Event::Elapsed);
    assert_eq!(ann(&farm), expected, "expired");
    // The worker is silent and gets nothing.
    farm.wait(1_000);
    farm.join(5);
    let expected = advance(&mut farm, 23);
    farm.control(id, Control::Cancel);
    assert_eq!(ann(&farm), expected, "cancelled");
}

#[test]
fn a_workers_time_is_charged_once_however_many_leases_it_holds() {
    let mut farm = TestFarm::with_config(Config { prefetch: 5, ..patient_config() });
    farm.submit(job_of("ann", 9));
    farm.submit(job_of("bob", 9));
    farm.join(1);
    assert_eq!(farm.tasks_of(1).len(), 6);
    let first = owner_of(&farm, &farm.first_lease_of(1));
    farm.wait(4_000);
    assert_eq!(charged(&farm), [].into(), "what is under way is a claim");
    farm.wait(1_000);
    assert_eq!(charged(&farm), [(first.clone(), 5_000)].into(), "it works on the oldest");
    farm.wait(500);
    farm.leave(1);
    assert_eq!(charged(&farm), [(first, 5_500)].into());
}
