//! Tests of the records of attempts.

use crate::common::{TestFarm, job, panic_failure, registration};
use femc_model::*;
use femc_schedule::*;

use Decision::Done;

fn usage(cpu: f64) -> ResourceUsage {
    ResourceUsage { cpu, wall: 1.0, ..ResourceUsage::default() }
}

/// Reports the usage of a worker's lease.
fn report_usage(farm: &mut TestFarm, worker: u64, held: &Assignment, cpu: f64) -> Vec<Command> {
    let report = TaskUsage { task: held.task, epoch: held.epoch, usage: usage(cpu) };
    farm.handle(Event::Usage { worker: WorkerId(worker), usage: report })
}

fn attempt_records(commands: &[Command]) -> Vec<(Epoch, LeaseEnding, Option<f64>)> {
    let note = |command: &Command| match command {
        Command::RecordAttempt(note) => Some((note.epoch, note.ending, note.usage.map(|usage| usage.cpu))),
        _ => None,
    };
    commands.iter().filter_map(note).collect()
}

/// Creates a farm with a worker that works on a task.
fn farm_with_running_task() -> (TestFarm, JobId, Assignment) {
    let mut farm = TestFarm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    farm.heartbeat(1, Phase::Working, 1);
    (farm, id, held)
}

#[test]
fn result_is_noted_once_with_usage_and_ledger_does_not_grow() {
    let (mut farm, _, held) = farm_with_running_task();
    farm.wait(700);
    assert_eq!(report_usage(&mut farm, 1, &held, 2.0), [], "its end is to come");
    let commands = farm.complete(1, &held, Done);
    let [Command::RecordAttempt(note)] =
        &commands.iter().filter(|c| matches!(c, Command::RecordAttempt(_))).cloned().collect::<Vec<_>>()[..]
    else {
        panic!("{commands:?}")
    };
    let found = (note.task, note.worker.as_str(), note.granted, note.ended, note.ending, note.samples);
    assert_eq!(found, (held.task, registration().name.as_str(), Tick(0), Tick(700), LeaseEnding::Done, 256));
    assert_eq!(note.usage, Some(usage(2.0)));
    report_usage(&mut farm, 1, &held, 2.0);
    assert_eq!(attempt_records(&farm.complete(1, &held, Done)), [], "a repetition is no attempt");
    let again = decode_attempts(&encode_attempts(&[(**note).clone()]).unwrap()).unwrap();
    assert_eq!(again, [(**note).clone()]);
    assert_eq!(farm.replay(), *farm.scheduler.ledger());
}

#[test]
fn notes_of_another_version_are_refused_and_say_so() {
    let mut note = encode_attempts(&[]).unwrap();
    assert_eq!(decode_attempts(&note).unwrap(), []);
    note[0] -= 1;
    let error = decode_attempts(&note).unwrap_err();
    assert!(matches!(error, SnapshotError::NoteVersion { found: 1 }), "{error}");
    assert!(error.to_string().contains("records of attempts have version 1,"), "{error}");
    assert!(matches!(decode_attempts(&[]), Err(SnapshotError::Empty)));
}

#[test]
fn every_end_of_a_lease_that_began_work_is_an_attempt() {
    let (mut farm, _, held) = farm_with_running_task();
    report_usage(&mut farm, 1, &held, 0.5);
    assert_eq!(attempt_records(&farm.fail(1, &held, panic_failure())), [(held.epoch, LeaseEnding::Failed, Some(0.5))]);

    let (mut farm, _, held) = farm_with_running_task();
    report_usage(&mut farm, 1, &held, 0.25);
    assert_eq!(
        attempt_records(&farm.fail(1, &held, Failure::Cancelled)),
        [(held.epoch, LeaseEnding::Cancelled, Some(0.25))]
    );

    let (mut farm, _, held) = farm_with_running_task();
    assert_eq!(attempt_records(&farm.leave(1)), [(held.epoch, LeaseEnding::Lost, None)]);

    let (mut farm, id, held) = farm_with_running_task();
    assert_eq!(attempt_records(&farm.control(id, Control::Cancel)), [(held.epoch, LeaseEnding::Cancelled, None)]);
    assert_eq!(
        attempt_records(&report_usage(&mut farm, 1, &held, 3.0)),
        [(held.epoch, LeaseEnding::Revoked, Some(3.0))],
        "told after its end"
    );

    let (mut farm, _, held) = farm_with_running_task();
    assert_eq!(attempt_records(&farm.wait(6_000)), [(held.epoch, LeaseEnding::Revoked, None)]);
}

#[test]
fn late_report_ends_at_arrival_and_begins_its_duration_before() {
    for (wall, wait) in [(1.0, 0.0), (2.5, 0.25), (0.125, 7.0), (1e9, 1.0)] {
        let (mut farm, id, held) = farm_with_running_task();
        farm.wait(3_000);
        farm.control(id, Control::Cancel);
        farm.wait(20_000);
        let usage = ResourceUsage { wall, wait, ..ResourceUsage::default() };
        let report = TaskUsage { task: held.task, epoch: held.epoch, usage };
        let commands = farm.handle(Event::Usage { worker: WorkerId(1), usage: report });
        let [Command::RecordAttempt(note)] = &commands[..] else { panic!("{commands:?}") };
        let took = ((wall + wait) * 1000.0) as u64;
        assert_eq!((note.granted, note.ended), (Tick(farm.now.0.saturating_sub(took)), farm.now), "{wall} + {wait} s");
    }
}

#[test]
fn a_task_that_only_waited_was_no_attempt() {
    let mut farm = TestFarm::new();
    farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    let held = farm.first_lease_of(1);
    assert_eq!(attempt_records(&farm.fail(1, &held, Failure::Cancelled)), []);
    assert_eq!(attempt_records(&farm.leave(1)), []);
}

#[test]
fn what_a_stranger_says_of_a_job_that_is_not_there_is_not_kept() {
    let (mut farm, _, held) = farm_with_running_task();
    let strange = Assignment { task: TaskKey { job: JobId(77), ..held.task }, ..held };
    assert_eq!(report_usage(&mut farm, 1, &strange, 1.0), []);
    assert_eq!(report_usage(&mut farm, 9, &strange, 1.0), []);
}

#[test]
fn lease_with_lost_heartbeats_has_not_stalled() {
    let (mut farm, id, held) = farm_with_running_task();
    farm.wait(farm.scheduler.config().lease - 1);
    // The link is back. The first message is about another lease, which ended long ago.
    farm.handle(Event::Failed { worker: WorkerId(1), task: held.task, epoch: Epoch(1), failure: panic_failure() });
    let commands = farm.wait(1);
    assert!(commands.iter().any(|command| matches!(command, Command::Revoke { .. })), "it ran out: {commands:?}");
    let is_failure = |command: &Command| matches!(command, Command::Record(Fact::Failed { .. }));
    assert!(!commands.iter().any(is_failure), "nothing failed: {commands:?}");
    assert_eq!(farm.status(id).quarantined, []);
}
