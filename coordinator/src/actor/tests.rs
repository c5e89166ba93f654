use femc_model::{Epoch, Phase, Stage, StageKind, TaskKey, TaskProgress};
use femc_queue::Memory;
use femc_schedule::Ledger;
use tokio::sync::watch;

use super::*;

type TestActor = Actor<Memory>;

fn new_actor() -> TestActor {
    let config = Config::default();
    let (scheduler, _) = Scheduler::new(config.scheduler.clone(), Ledger::default());
    let (_, metrics_requests) = mpsc::channel(1);
    Actor::new(scheduler, Memory::default(), Store::in_memory(), 0, Roster::default(), metrics_requests, &config)
}

fn join(actor: &mut TestActor, commands: &mut Vec<Command>) -> (WorkerId, mpsc::Receiver<ToWorker>) {
    let registration = Registration {
        name: "one".into(),
        instance: 1,
        engine: "build".into(),
        threads: 1,
        slots: 1,
        tags: Vec::new(),
        held: Vec::new(),
        death: None,
    };
    let (out, received) = mpsc::channel(16);
    (actor.add_session(registration, out, commands), received)
}

async fn commit(actor: &mut TestActor, commands: &mut Vec<Command>) {
    let ((_calls, calls), (_stop, stop)) = (mpsc::channel(1), watch::channel(()));
    actor.commit(commands, &mut ActorInputs { calls, stop }).await.unwrap();
}

fn received(messages: &mut mpsc::Receiver<ToWorker>) -> Vec<ToWorker> {
    std::iter::from_fn(|| messages.try_recv().ok()).collect()
}

/// After a pause of the coordinator, it may process the end of a session and the next session of the worker in one batch.
#[tokio::test]
async fn messages_to_an_ended_session_do_not_reach_the_next() {
    let (mut actor, mut commands) = (new_actor(), Vec::new());
    let (number, mut first) = join(&mut actor, &mut commands);
    commit(&mut actor, &mut commands).await;
    assert!(matches!(received(&mut first)[..], [ToWorker::Welcome { .. }]));
    let stage = Stage { frame: 1, round: 0, number: 0, kind: StageKind::Render };
    let (task, epoch) = (TaskKey { job: JobId(1), stage, index: 0 }, Epoch(1));
    let tasks = vec![TaskProgress { task, epoch, phase: Phase::Working, units: 1 }];
    let reports = [
        FromWorker::Heartbeat { number: 1, tasks, usage: Vec::new() },
        FromWorker::Failed { task, epoch, failure: Failure::Cancelled, log: None, usage: None },
    ];
    for report in reports {
        actor.handle_session_event(number, SessionEvent::Message(Box::new(report)), &mut commands);
    }
    let sent = commands.iter().filter(|command| command.worker() == Some(number)).count();
    assert_eq!(sent, 2, "the lease is revoked, and the report refused: {commands:?}");
    actor.handle_session_event(number, SessionEvent::Ended, &mut commands);
    let (second, mut unwelcomed) = join(&mut actor, &mut commands);
    actor.handle_session_event(second, SessionEvent::Ended, &mut commands);
    let (third, mut last) = join(&mut actor, &mut commands);
    assert_eq!([second, third], [number; 2], "a worker keeps its number");
    commit(&mut actor, &mut commands).await;
    assert_eq!(received(&mut unwelcomed), []);
    let messages = received(&mut last);
    assert!(matches!(messages[..], [ToWorker::Welcome { .. }]), "{messages:?}");
}

#[tokio::test]
async fn number_of_a_replaced_session_is_free_after_its_last_event() {
    let (mut actor, mut commands) = (new_actor(), Vec::new());
    let (first, mut replaced) = join(&mut actor, &mut commands);
    let (second, _messages) = join(&mut actor, &mut commands);
    commit(&mut actor, &mut commands).await;
    assert!(matches!(received(&mut replaced)[..], [ToWorker::Welcome { .. }]));
    assert!(replaced.is_closed(), "one process has one session");
    let (third, _messages) = join(&mut actor, &mut commands);
    assert_eq!(BTreeSet::from([first, second, third]).len(), 3, "no last event has been processed yet");
    for ended in [first, second, third] {
        actor.handle_session_event(ended, SessionEvent::Ended, &mut commands);
    }
    let (again, _messages) = join(&mut actor, &mut commands);
    assert_eq!(again, first);
}
