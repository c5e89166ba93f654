//! Tests of the records of attempts.

use crate::common::{Farm, job, panic, registration};
use femc_model::*;
use femc_schedule::*;

use Decision::Done;

fn usage(cpu: f64) -> Usage {
    Usage { cpu, wall: 1.0, ..Usage::default() }
}

/// Reports the usage of a worker's lease.
fn tell(farm: &mut Farm, worker: u64, held: &Assignment, cpu: f64) -> Vec<Command> {
    let report = TaskUsage { task: held.task, epoch: held.epoch, usage: usage(cpu) };
    farm.on(Event::Usage { worker: WorkerId(worker), usage: report })
}

fn notes(commands: &[Command]) -> Vec<(Epoch, Ending, Option<f64>)> {
    let note = |command: &Command| match command {
        Command::Note(note) => Some((note.epoch, note.ending, note.usage.map(|usage| usage.cpu))),
        _ => None,
    };
    commands.iter().filter_map(note).collect()
}

/// Creates a farm with a worker that works on a task.
fn at_work() -> (Farm, JobId, Assignment) {
    let mut farm = Farm::new();
    let id = farm.submit(job(&[1], 1, &[4]));
    farm.join(1);
    let held = farm.first_of(1);
    farm.heartbeat(1, Phase::Working, 1);
    (farm, id, held)
}

#[test]
fn result_is_noted_once_with_usage_and_ledger_does_not_grow() {
    let (mut farm, _, held) = at_work();
    farm.wait(700);
    assert_eq!(tell(&mut farm, 1, &held, 2.0), [], "its end is to come");
    let commands = farm.complete(1, &held, Done);
    let [Command::Note(note)] =
        &commands.iter().filter(|c| matches!(c, Command::Note(_))).cloned().collect::<Vec<_>>()[..]
    else {
        panic!("{commands:?}")
    };
    let found = (note.task, note.worker.as_str(), note.granted, note.ended, note.ending, note.samples);
    assert_eq!(found, (held.task, registration().name.as_str(), Tick(0), Tick(700), Ending::Done, 256));
    assert_eq!(note.usage, Some(usage(2.0)));
    tell(&mut farm, 1, &held, 2.0);
    assert_eq!(notes(&farm.complete(1, &held, Done)), [], "a repetition is no attempt");
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
    let (mut farm, _, held) = at_work();
    tell(&mut farm, 1, &held, 0.5);
    assert_eq!(notes(&farm.fail(1, &held, panic())), [(held.epoch, Ending::Failed, Some(0.5))]);

    let (mut farm, _, held) = at_work();
    tell(&mut farm, 1, &held, 0.25);
    assert_eq!(notes(&farm.fail(1, &held, Failure::Cancelled)), [(held.epoch, Ending::Cancelled, Some(0.25))]);

    let (mut farm, _, held) = at_work();
    assert_eq!(notes(&farm.leave(1)), [(held.epoch, Ending::Lost, None)]);

    let (mut farm, id, held) = at_work();
    assert_eq!(notes(&farm.control(id, Control::Cancel)), [(held.epoch, Ending::Cancelled, None)]);
    assert_eq!(
        notes(&tell(&mut farm, 1, &held, 3.0)),
        [(held.epoch, Ending::Revoked, Some(3.0))],
        "told after its end"
    );

    let (mut farm, _, held) = at_work();
    assert_eq!(notes(&farm.wait(6_000)), [(held.epoch, Ending::Revoked, None)]);
}

#[test]
fn late_report_ends_at_arrival_and_begins_its_duration_before() {
    for (wall, wait) in [(1.0, 0.0), (2.5, 0.25), (0.125, 7.0), (1e9, 1.0)] {
        let (mut farm, id, held) = at_work();
        farm.wait(3_000);
        farm.control(id, Control::Cancel);
        farm.wait(20_000);
        let usage = Usage { wall, wait, ..Usage::default() };
        let report = TaskUsage { task: held.task, epoch: held.epoch, usage };
        let commands = farm.on(Event::Usage { worker: WorkerId(1), usage: report });
        let [Command::Note(note)] = &commands[..] else { panic!("{commands:?}") };
        let took = ((wall + wait) * 1000.0) as u64;
        assert_eq!((note.granted, note.ended), (Tick(farm.now.0.saturating_sub(took)), farm.now), "{wall} + {wait} s");
    }
}

#[test]
fn a_task_that_only_waited_was_no_attempt() {
    let mut farm = Farm::new();
    farm.submit(job(&[1], 2, &[4]));
    farm.join(1);
    let held = farm.first_of(1);
    assert_eq!(notes(&farm.fail(1, &held, Failure::Cancelled)), []);
    assert_eq!(notes(&farm.leave(1)), []);
}

#[test]
fn what_a_stranger_says_of_a_job_that_is_not_there_is_not_kept() {
    let (mut farm, _, held) = at_work();
    let strange = Assignment { task: TaskKey { job: JobId(77), ..held.task }, ..held };
    assert_eq!(tell(&mut farm, 1, &strange, 1.0), []);
    assert_eq!(tell(&mut farm, 9, &strange, 1.0), []);
}

#[test]
fn lease_with_lost_heartbeats_has_not_stalled() {
    let (mut farm, id, held) = at_work();
    farm.wait(farm.scheduler.config().lease - 1);
    // The link is back. The first message is about another lease, which ended long ago.
    farm.on(Event::Failed { worker: WorkerId(1), task: held.task, epoch: Epoch(1), failure: panic() });
    let commands = farm.wait(1);
    assert!(commands.iter().any(|command| matches!(command, Command::Revoke { .. })), "it ran out: {commands:?}");
    let is_failure = |command: &Command| matches!(command, Command::Record(Fact::Failed { .. }));
    assert!(!commands.iter().any(is_failure), "nothing failed: {commands:?}");
    assert_eq!(farm.status(id).quarantined, []);
}
