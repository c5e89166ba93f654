//! Tests of usage by owner and month, deleted jobs, and announcements of ends.

use femc_model::*;
use femc_schedule::*;

use crate::common::{self, TestFarm, job};

fn month(text: &str) -> Month {
    text.parse().expect("a month")
}

fn job_of(owner: &str, frames: &[u32], tiles: u32) -> JobSpec {
    JobSpec { owner: owner.into(), ..job(frames, tiles, &[4]) }
}

/// Completes the worker's oldest task after `milliseconds`, and reports `cpu` processor seconds for it.
fn complete_first(farm: &mut TestFarm, worker: u64, milliseconds: u64, cpu: f64) {
    let held = farm.first_lease_of(worker);
    farm.wait(milliseconds);
    let usage =
        TaskUsage { task: held.task, epoch: held.epoch, usage: ResourceUsage { cpu, ..ResourceUsage::default() } };
    farm.handle(Event::Usage { worker: WorkerId(worker), usage });
    farm.complete(worker, &held, Decision::Done);
}

fn finish(farm: &mut TestFarm, worker: u64) {
    while farm.leases.iter().any(|(holder, _)| holder.0 == worker) {
        complete_first(farm, worker, 100, 0.25);
    }
}

fn usage_sums(farm: &TestFarm, month_text: &str, owner: &str) -> UsageSums {
    let all = farm.scheduler.usage_by_owner();
    all.iter().find(|row| row.month == month(month_text) && row.owner == owner).map(|row| row.sums).unwrap_or_default()
}

#[test]
fn usage_sums_the_leases_and_attempts_of_an_owner() {
    let mut farm = TestFarm::new();
    farm.handle(Event::Month(month("2026-11")));
    farm.join(1);
    farm.submit(job_of("ann", &[1, 2], 3));
    finish(&mut farm, 1);
    farm.submit(job_of("bob", &[1], 2));
    finish(&mut farm, 1);
    farm.wait(Scheduler::CHARGE_INTERVAL);
    let (ann, bob) = (usage_sums(&farm, "2026-11", "ann"), usage_sums(&farm, "2026-11", "bob"));
    assert_eq!((ann.jobs, ann.frames, bob.jobs, bob.frames), (1, 2, 1, 1));
    // ann: three tiles and an image per frame; bob: two tiles and an image.
    assert_eq!((ann.tasks, bob.tasks), (8, 3));
    assert_eq!((ann.processor_us, bob.processor_us), (8 * 250_000, 3 * 250_000));
    assert_eq!((ann.worker_ms, bob.worker_ms), (farm.charged["ann"], farm.charged["bob"]));
    assert_eq!((ann.samples, bob.samples), (farm.status(JobId(1)).samples_done, farm.status(JobId(2)).samples_done));
}

#[test]
fn usage_belongs_to_its_month_and_outlives_job_and_coordinator() {
    let mut farm = TestFarm::new();
    farm.handle(Event::Month(month("2026-11")));
    farm.join(1);
    let id = farm.submit(job_of("ann", &[1], 3));
    complete_first(&mut farm, 1, 400, 0.5);
    farm.handle(Event::Month(month("2026-12")));
    finish(&mut farm, 1);
    let november = usage_sums(&farm, "2026-11", "ann");
    assert_eq!((november.jobs, november.tasks, november.processor_us), (1, 1, 500_000));
    let december = usage_sums(&farm, "2026-12", "ann");
    assert_eq!((december.jobs, december.frames, december.tasks, december.processor_us), (0, 1, 3, 750_000));
    assert_eq!(november.worker_ms + december.worker_ms, farm.charged["ann"]);
    farm.wait(Scheduler::CHARGE_INTERVAL);
    farm.control(id, Control::Delete);
    let usage = farm.scheduler.usage_by_owner();
    farm.restart();
    assert_eq!(farm.scheduler.usage_by_owner(), usage, "all of it is durable");
    assert_eq!(usage.iter().map(|row| row.month.to_string()).collect::<Vec<_>>(), ["2026-11", "2026-12"]);
}

#[test]
fn killed_coordinator_loses_at_most_five_seconds_of_usage() {
    let mut farm = TestFarm::new();
    farm.handle(Event::Month(month("2026-11")));
    farm.join(1);
    farm.submit(job_of("ann", &[1], 60));
    for _ in 0..50 {
        complete_first(&mut farm, 1, 300, 0.3);
    }
    let before = usage_sums(&farm, "2026-11", "ann");
    farm.restart();
    let after = usage_sums(&farm, "2026-11", "ann");
    let lost = before.worker_ms - after.worker_ms;
    assert!(lost <= Scheduler::CHARGE_INTERVAL, "{lost} ms");
    // A task takes 300 ms.
    let lost = before.processor_us - after.processor_us;
    assert!(lost <= 1000 * (Scheduler::CHARGE_INTERVAL + 300), "{lost} us");
}

#[test]
fn without_a_month_nothing_is_summed() {
    let mut farm = TestFarm::new();
    farm.join(1);
    farm.submit(job_of("ann", &[1], 3));
    finish(&mut farm, 1);
    farm.wait(Scheduler::CHARGE_INTERVAL);
    assert!(farm.scheduler.usage_by_owner().is_empty());
}

#[test]
fn only_ended_jobs_can_be_deleted_and_nothing_refers_to_them() {
    let mut farm = TestFarm::new();
    farm.join(1);
    let (first, second) = (farm.submit(job_of("ann", &[1], 3)), farm.submit(job_of("ann", &[1], 3)));
    let refused = |commands: &[Command]| {
        commands.iter().find_map(|command| match command {
            Command::Answer { answer, .. } => answer.clone().err(),
            _ => None,
        })
    };
    let commands = farm.control(first, Control::Delete);
    assert!(
        matches!(refused(&commands), Some(Refusal::Invalid { message, .. }) if message.contains("cancel it first"))
    );
    finish(&mut farm, 1);
    let commands = farm.control(first, Control::Delete);
    assert_eq!(refused(&commands), None);
    assert!(commands.contains(&Command::JobChanged(first)), "watchers are informed");
    assert_eq!(farm.scheduler.status(first, farm.now), Err(Refusal::NoSuchJob { job: first }));
    assert_eq!(refused(&farm.control(first, Control::Delete)), Some(Refusal::NoSuchJob { job: first }));
    assert_eq!(farm.state(second), JobState::Done);
    farm.control(second, Control::Delete);
    assert!(farm.scheduler.ledger().references().is_empty(), "what they had made can go");
    farm.restart();
    assert!(farm.scheduler.jobs(farm.now).is_empty());
    // A number is never used again.
    assert!(farm.submit(job_of("ann", &[1], 3)) > second);
}

#[test]
fn each_end_of_a_job_is_announced_once_and_until_done() {
    let mut farm = TestFarm::new();
    farm.join(1);
    let id = farm.submit(job_of("ann", &[1], 3));
    assert_eq!(farm.scheduler.end_to_announce(id), None);
    farm.control(id, Control::Cancel);
    let cancelled = farm.scheduler.end_to_announce(id).expect("it has ended");
    farm.restart();
    farm.wait(10_000);
    assert_eq!(farm.scheduler.ends_to_announce(), [(id, cancelled)], "also after a restart");
    farm.handle(Event::Announced { job: id, ended: Tick(cancelled.0 + 1) });
    assert_eq!(farm.scheduler.ends_to_announce(), [(id, cancelled)], "that was another end");
    farm.handle(Event::Announced { job: id, ended: cancelled });
    farm.restart();
    assert_eq!(farm.scheduler.ends_to_announce(), []);
    farm.wait(10_000);
    farm.control(id, Control::Retry);
    assert_eq!(farm.scheduler.ends_to_announce(), [], "it goes on");
    farm.join(1);
    farm.wait(100);
    finish(&mut farm, 1);
    assert_eq!(farm.state(id), JobState::Done);
    let done = farm.scheduler.end_to_announce(id).expect("it has ended once more");
    assert!(done > cancelled);
    farm.handle(Event::Announced { job: id, ended: cancelled });
    assert_eq!(farm.scheduler.end_to_announce(id), Some(done), "the end before is not this one");
    let commands = farm.handle(Event::Announced { job: id, ended: done });
    assert_eq!(commands.iter().filter(|it| matches!(it, Command::Record(Fact::Announced { .. }))).count(), 1);
    let again = farm.handle(Event::Announced { job: id, ended: done });
    assert!(again.is_empty(), "{again:?}");
}

#[test]
fn notes_are_kept_with_the_job() {
    let mut farm = TestFarm::new();
    let notes = JobNotes {
        comment: "before the change of lamps".into(),
        labels: [("shot".to_owned(), "12".to_owned())].into(),
        notify: Some("https://hooks.test/femc".into()),
    };
    let id = farm.submit(JobSpec { notes: notes.clone(), ..job_of("ann", &[1], 3) });
    farm.restart();
    assert_eq!(farm.status(id).notes, notes);
    let refused = JobNotes { comment: "a\nb".into(), ..notes };
    let spec = Box::new(JobSpec { notes: refused, ..job_of("ann", &[1], 3) });
    let commands = farm.handle(Event::Submitted { request: RequestId(99), key: None, spec, date: None });
    assert_eq!(common::find_answer(&commands), None, "{commands:?}");
}
