//! Relay between workers and the leading coordinator. It passes on and observes all messages. It repeats or delays some messages of
//! workers, misstates sizes in others, and adds leases of another farm to some sessions.

use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;

use femc_model::{Artifact, Digest, Epoch, FromWorker, HeldLease, Refusal, Registration, TaskKey, ToWorker};
use femc_proto::{Call, Client, Server, Session, SessionSender};
use femc_store::Store;
use rand::RngExt as _;
use tokio::sync::mpsc;

use crate::audit::Violation;
use crate::charges::Payers;
use crate::leases::SessionNumber;
use crate::network::{SWITCH, dialer, listen, url};
use crate::shared::{Shared, State};

/// Bits of an epoch that count the leases of one incarnation.
const LEASE_BITS: u32 = 40;

/// Longest delay of a late message.
pub(crate) const MAX_DELAY: Duration = Duration::from_secs(8);

/// Time after which a silent coordinator counts as dead.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(30);

/// Serves forever.
pub(crate) async fn serve(shared: Shared, store: Store) -> turmoil::Result {
    let (calls, mut inbox) = mpsc::channel(64);
    tokio::spawn(Server::new(calls, store).serve_forever(listen(&shared, SWITCH).await));
    while let Some(call) = inbox.recv().await {
        // Other clients contact the coordinator directly.
        if let Call::Session(session) = call {
            tokio::spawn(relay(*session, shared.clone()));
        }
    }
    Ok(())
}

fn now() -> Duration {
    turmoil::sim_elapsed().unwrap_or_default()
}

async fn relay(session: Session, shared: Shared) {
    let Session { mut registration, mut messages, out } = session;
    let leader = url(&format!("c{}", shared.lock().leader));
    let (name, engine, instance) = (registration.name.clone(), registration.engine.clone(), registration.instance);
    shared.trace(|| format!("{name} joins {leader} with {:?}", registration.held));
    let held = registration.held.iter().map(|held| (held.task, held.epoch));
    let mut running: BTreeSet<(Epoch, TaskKey)> = held.clone().map(|(task, epoch)| (epoch, task)).collect();
    let number = {
        let mut state = shared.lock();
        let number = state.leases.begin_session(&engine, held);
        let host = name.trim_start_matches('w').parse().unwrap_or_default();
        state.queues.begin_session(number, [host, instance], &engine, running.iter().copied());
        number
    };
    let mut foreign_lease = shared.lock().draw_foreign_lease(&registration);
    registration.held.extend(foreign_lease.clone());
    let session = async {
        let client = Client::connect_with(&dialer(&shared, SWITCH), &leader).await?;
        client.session(registration).await
    };
    // A dead host never answers.
    let Ok(Ok((up, mut down))) = tokio::time::timeout(CONNECT_TIMEOUT, session).await else {
        return shared.lock().queues.end_session(number, now());
    };
    let joined = now();
    let upwards = async {
        while let Some(Ok(mut message)) = messages.next().await {
            shared.lock().misstate_size(&mut message);
            shared.trace(|| format!("{name} > {message:?}"));
            {
                let mut state = shared.lock();
                let kept = state.observe_message(number, &message, now());
                state.violations.extend(kept);
            }
            match &message {
                FromWorker::Completed { task, epoch, .. } => drop(shared.lock().reported.insert((*task, *epoch))),
                FromWorker::Failed { task, epoch, .. } => {
                    let mut state = shared.lock();
                    state.leases.report_failure(*task, *epoch);
                    // The worker has lost the result, so the acknowledgement refers to the failure.
                    state.reported.remove(&(*task, *epoch));
                }
                _ => {}
            }
            forward(message, &up, &shared).await;
        }
    };
    let downwards = async {
        while let Ok(Some(message)) = down.next().await {
            shared.trace(|| format!("{name} < {message:?}"));
            match &message {
                ToWorker::Assign(lease) => {
                    let mut state = shared.lock();
                    if lease.copy_of.is_some() {
                        state.count_fault("lease copied");
                    }
                    let leased = state.leases.grant(&engine, lease);
                    let incarnation = (lease.epoch.0 >> LEASE_BITS) as u32;
                    let drained = state.history.check_drain(instance, incarnation, now());
                    let quarantined = state.history.check_quarantine(lease.task, lease.epoch);
                    let shared_stages_missing = state.history.check_shared_inputs(&engine, lease, incarnation, now());
                    state
                        .violations
                        .extend(leased.into_iter().chain(drained).chain(quarantined).chain(shared_stages_missing));
                    let queued = state.check_lease(number, lease, now());
                    state.violations.extend(queued);
                    running.insert((lease.epoch, lease.task));
                }
                ToWorker::Revoke { task, epoch, .. } => {
                    running.remove(&(*epoch, *task));
                    let mut state = shared.lock();
                    state.leases.revoke(number, *task, *epoch);
                    state.queues.observe_lease_end(number, *task, *epoch);
                }
                ToWorker::Renewed { leases, .. } => {
                    let is_held =
                        |of: &mut HeldLease| leases.iter().any(|it| (it.task, it.epoch) == (of.task, of.epoch));
                    let taken = foreign_lease.take_if(is_held);
                    let taken = taken.map(|HeldLease { task, epoch, .. }| Violation::ForeignLease { task, epoch });
                    shared.lock().violations.extend(taken);
                }
                ToWorker::Accepted { task, epoch } => {
                    running.remove(&(*epoch, *task));
                    let mut state = shared.lock();
                    state.accepted.insert((*task, *epoch));
                    state.observe_accepted(number, *task, *epoch, now());
                }
                ToWorker::Refused { task, epoch, refusal } => {
                    // The worker is informed of each lease that ends. A later refusal answers a repeated message.
                    let ran = running.remove(&(*epoch, *task));
                    shared.lock().queues.observe_lease_end(number, *task, *epoch);
                    if ran && *refusal == Refusal::StaleEpoch {
                        shared.lock().violations.push(Violation::UnannouncedEnd { task: *task, epoch: *epoch });
                    }
                }
                _ => {}
            }
            shared.lock().update_payers(number, &running, joined);
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
    shared.lock().update_payers(number, &BTreeSet::new(), joined);
    shared.lock().queues.end_session(number, now());
    shared.trace(|| format!("{name} disconnects"));
}

impl State {
    /// Misstates the size of an artifact in some results.
    fn misstate_size(&mut self, message: &mut FromWorker) {
        let FromWorker::Completed { result, .. } = message else { return };
        // Worlds without misstated sizes draw no random number.
        let (percent, count) = (self.misstated, result.outputs.len());
        if percent == 0 || count == 0 || !self.draw_bool(percent) {
            return;
        }
        let Artifact { digest, bytes } = &mut result.outputs[self.rng.random_range(0..count)].artifact;
        self.sizes.insert(*digest, *bytes);
        *bytes = [0, bytes.saturating_sub(1), *bytes + 1, 2 * *bytes][self.rng.random_range(0..4)];
        self.count_fault("size misstated");
    }

    /// Adds a lease of another farm to some workers' sessions. Its job has the number of a job of this farm, and its task and epoch
    /// are leased here.
    fn draw_foreign_lease(&mut self, registration: &Registration) -> Option<HeldLease> {
        /// Number of latest leases to choose from. Most of them are still held.
        const MAX_CANDIDATES: usize = 6;
        // Worlds without foreign leases draw no random number.
        let percent = self.foreign_leases;
        if percent == 0 || !self.draw_bool(percent) {
            return None;
        }
        let is_own = |task, epoch| registration.held.iter().any(|held| (held.task, held.epoch) == (task, epoch));
        let others = self.leases.latest_granted(MAX_CANDIDATES).filter(|&(task, epoch, _)| !is_own(task, epoch));
        let mut others: Vec<(TaskKey, Epoch, Range<u32>)> = others.collect();
        if others.is_empty() {
            return None;
        }
        let (task, epoch, steps) = others.swap_remove(self.rng.random_range(0..others.len()));
        self.count_fault("lease of another farm");
        Some(HeldLease { task, epoch, steps, job: Digest::compute(b"a job of another farm") })
    }

    /// Notes that the leases of a worker have changed.
    /// - `joined`: start of its session.
    fn update_payers(&mut self, session: SessionNumber, running: &BTreeSet<(Epoch, TaskKey)>, joined: Duration) {
        let first = running.first().map(|(_, task)| task.job);
        let payers = first.and_then(|job| Some(Payers::from_owners(job, self.history.payers(job)?)));
        self.charges.set_payers(session, payers, now());
        self.violations.extend(self.history.find_unwanted(running.iter().map(|(_, task)| task), joined, now()));
    }
}

async fn forward(message: FromWorker, up: &SessionSender, shared: &Shared) {
    let (is_twice, is_late) = {
        let mut state = shared.lock();
        let (twice, late) = (state.duplicated, state.delayed);
        (state.draw_bool(twice), state.draw_bool(late))
    };
    if is_twice || is_late {
        shared.lock().count_fault(if is_twice { "sent twice" } else { "sent late" });
        let (again, up, pause) = (message.clone(), up.clone(), shared.draw_duration(MAX_DELAY));
        tokio::spawn(async move {
            tokio::time::sleep(pause).await;
            up.send(again).await;
        });
    }
    if !is_late {
        up.send(message).await;
    }
}
