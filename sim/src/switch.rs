//! The way between workers and the coordinator that leads: it passes everything on, sees everything, and lets some messages
//! of workers come twice or late.

use std::time::Duration;

use femc_model::{FromWorker, ToWorker};
use femc_proto::{Call, Client, Outgoing, Server, Session};
use femc_store::Store;
use tokio::sync::mpsc;

use crate::network::{SWITCH, dial, listen, url};
use crate::shared::Shared;

/// Latest that a message comes.
const LATE: Duration = Duration::from_secs(8);

/// After so long a coordinator that does not answer is taken for dead.
const GIVE_UP: Duration = Duration::from_secs(30);

/// Serves for ever.
pub(crate) async fn serve(shared: Shared, store: Store) -> turmoil::Result {
    let (calls, mut inbox) = mpsc::channel(64);
    tokio::spawn(Server::new(calls, store).serve_on(listen(&shared, SWITCH).await));
    while let Some(call) = inbox.recv().await {
        // Others than workers ask the coordinator itself.
        if let Call::Session(session) = call {
            tokio::spawn(relay(*session, shared.clone()));
        }
    }
    Ok(())
}

async fn relay(session: Session, shared: Shared) {
    let Session { registration, mut words, out } = session;
    let leader = url(&format!("c{}", shared.lock().leader));
    let (name, engine) = (registration.name.clone(), registration.engine.clone());
    shared.note(|| format!("{name} joins {leader} with {:?}", registration.held));
    let held = registration.held.iter().map(|held| (held.task, held.epoch));
    let number = shared.lock().leases.joined(&engine, held);
    let session = async {
        let client = Client::connect_by(&dial(&shared, SWITCH), &leader).await?;
        client.session(registration).await
    };
    // A host that is dead says nothing, for ever.
    let Ok(Ok((up, mut down))) = tokio::time::timeout(GIVE_UP, session).await else { return };
    let upwards = async {
        while let Some(Ok(word)) = words.next().await {
            shared.note(|| format!("{name} > {word:?}"));
            if let FromWorker::Completed { task, epoch, .. } = &word {
                shared.lock().reported.insert((*task, *epoch));
            }
            pass(word, &up, &shared).await;
        }
    };
    let downwards = async {
        while let Ok(Some(message)) = down.next().await {
            shared.note(|| format!("{name} < {message:?}"));
            match &message {
                ToWorker::Assign(lease) => {
                    let mut state = shared.lock();
                    if lease.copy_of.is_some() {
                        state.fired("given out twice");
                    }
                    let wrong = state.leases.assigned(&engine, lease);
                    state.wrong.extend(wrong);
                }
                ToWorker::Revoke { task, epoch, .. } => shared.lock().leases.revoked(number, *task, *epoch),
                ToWorker::Accepted { task, epoch } => drop(shared.lock().accepted.insert((*task, *epoch))),
                _ => {}
            }
            if out.send(message).await.is_err() {
                break;
            }
        }
    };
    tokio::select! {
        biased;
        () = downwards => {}
        () = upwards => {}
    }
    shared.note(|| format!("{name} is cut off"));
}

async fn pass(word: FromWorker, up: &Outgoing, shared: &Shared) {
    let (is_twice, is_late) = {
        let mut state = shared.lock();
        let (twice, late) = (state.twice, state.late);
        (state.chance(twice), state.chance(late))
    };
    if is_twice || is_late {
        shared.lock().fired(if is_twice { "came twice" } else { "came late" });
        let (again, up, pause) = (word.clone(), up.clone(), shared.pause(LATE));
        tokio::spawn(async move {
            tokio::time::sleep(pause).await;
            up.send(again).await;
        });
    }
    if !is_late {
        up.send(word).await;
    }
}
