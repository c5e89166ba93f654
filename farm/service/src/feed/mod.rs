//! Feed of changes of the farm, for any number of listeners.
//!
//! While there are listeners, the feed queries the farm once per second. All changes of a query become one numbered delta, which is
//! encoded once. A listener that is up to date gets these bytes. A listener that was disconnected or reads slowly gets one delta
//! with all changes since the last number it knows. For this, every job and worker is stored with the number of its last change, so
//! there are no queues per listener. Removed jobs and workers are remembered for a while. A listener whose last number is older
//! than that gets a snapshot.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::convert::Infallible;
use std::fmt::{self, Write as _};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use bytes::Bytes;
use femc_model::{JobId, WorkerStatus};
use futures_util::Stream;
use futures_util::stream::unfold;
use serde::Serialize;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior};

use crate::access::Caller;
use crate::call::{Call, ChangeScope, Changes};
use crate::farm::Farm;
use crate::view::{JobJson, OfflineJson, WorkerJson};

/// Feed of changes. Clones are the same feed.
pub struct Feed<S> {
    farm: Farm<S>,
    hub: Arc<Hub>,
}

impl<S> Clone for Feed<S> {
    fn clone(&self) -> Self {
        Self { farm: self.farm.clone(), hub: self.hub.clone() }
    }
}

impl<S> fmt::Debug for Feed<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Feed").field("hub", &self.hub).finish()
    }
}

/// State shared by all listeners.
#[derive(Debug)]
struct Hub {
    state: Mutex<State>,
    /// Counter of updates.
    updates: watch::Sender<u64>,
}

/// Known state of the farm.
#[derive(Debug)]
struct State {
    /// Identifier of this start of the coordinator. Numbers from another start are invalid.
    start: String,
    /// Number of the last change.
    seq: u64,
    jobs: VersionedItems,
    workers: VersionedItems,
    /// Disconnected workers, as a JSON list.
    offline: String,
    offline_changed: u64,
    warnings: Vec<String>,
    warnings_changed: u64,
    /// Number and encoded event of the last change.
    delta: Option<(u64, Bytes)>,
    snapshot: Option<(u64, Bytes)>,
    query_task: QueryTask,
}

/// State of the task that queries the farm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum QueryTask {
    /// There is no task, because there are no listeners.
    Stopped,
    /// The task has not finished its first query. The known state may be old.
    Starting,
    /// The known state is that of the latest query.
    Running,
}

/// Items by number, each as JSON with the number of its last change.
#[derive(Debug, Default)]
struct VersionedItems {
    present: BTreeMap<u64, (String, u64)>,
    /// Removed items: number of the change, and number of the item, in order of changes.
    removed: VecDeque<(u64, u64)>,
    /// Removals up to this change have been forgotten.
    forgotten_until: u64,
}

impl VersionedItems {
    /// Maximum number of remembered removals.
    const MAX_REMOVED: usize = 4096;

    /// Applies new states and removes items that do not exist any more. Returns whether anything changed.
    fn update(&mut self, now: BTreeMap<u64, String>, exists: impl Fn(u64) -> bool, seq: u64) -> bool {
        let mut has_changed = false;
        let gone: Vec<u64> = self.present.keys().filter(|number| !exists(**number)).copied().collect();
        for number in gone {
            self.present.remove(&number);
            self.removed.push_back((seq, number));
            has_changed = true;
        }
        while self.removed.len() > Self::MAX_REMOVED {
            self.forgotten_until = self.removed.pop_front().map_or(self.forgotten_until, |(seq, _)| seq);
        }
        for (number, json) in now {
            if self.present.get(&number).is_none_or(|(known, _)| *known != json) {
                self.present.insert(number, (json, seq));
                has_changed = true;
            }
        }
        has_changed
    }

    /// Returns the items that changed after `seq`, as a JSON list.
    fn since(&self, seq: u64) -> String {
        let changed = self.present.values().filter(|(_, changed)| *changed > seq);
        format!("[{}]", changed.map(|(json, _)| json.as_str()).collect::<Vec<_>>().join(","))
    }

    /// Returns the numbers of the items removed after `seq`, as a JSON list.
    fn removed_since(&self, seq: u64) -> String {
        let gone = self.removed.iter().filter(|(at, number)| *at > seq && !self.present.contains_key(number));
        let numbers: BTreeSet<u64> = gone.map(|(_, number)| *number).collect();
        format!("[{}]", numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(","))
    }
}

impl State {
    fn new(start: String) -> Self {
        Self {
            start,
            seq: 0,
            jobs: VersionedItems::default(),
            workers: VersionedItems::default(),
            offline: "[]".to_owned(),
            offline_changed: 0,
            warnings: Vec::new(),
            warnings_changed: 0,
            delta: None,
            snapshot: None,
            query_task: QueryTask::Stopped,
        }
    }

    /// Returns the next event for a listener that knows the change `known`, and the number that it knows afterwards.
    fn next_event(&mut self, known: Option<u64>) -> Option<(u64, Bytes)> {
        match known {
            Some(known) if known == self.seq => None,
            Some(known) if known < self.seq && known >= self.jobs.forgotten_until.max(self.workers.forgotten_until) => {
                if known + 1 == self.seq
                    && let Some(delta) = self.delta.clone()
                {
                    return Some(delta);
                }
                Some((self.seq, self.delta_event(known)))
            }
            Some(_) | None => {
                let is_old = self.snapshot.as_ref().is_none_or(|(seq, _)| *seq != self.seq);
                if is_old {
                    self.snapshot = Some((self.seq, self.snapshot_event()));
                }
                self.snapshot.clone()
            }
        }
    }

    /// Returns the event with all changes after `since`.
    fn delta_event(&self, since: u64) -> Bytes {
        let warnings = if self.warnings_changed > since { json(&self.warnings) } else { "null".to_owned() };
        let offline = if self.offline_changed > since { self.offline.clone() } else { "null".to_owned() };
        let fields = [
            ("jobs", self.jobs.since(since)),
            ("gone_jobs", self.jobs.removed_since(since)),
            ("workers", self.workers.since(since)),
            ("gone_workers", self.workers.removed_since(since)),
            ("offline", offline),
            ("warnings", warnings),
        ];
        self.event("delta", &fields)
    }

    /// Returns the event with the whole state.
    fn snapshot_event(&self) -> Bytes {
        let fields = [
            ("jobs", self.jobs.since(0)),
            ("workers", self.workers.since(0)),
            ("offline", self.offline.clone()),
            ("warnings", json(&self.warnings)),
        ];
        self.event("snapshot", &fields)
    }

    fn event(&self, name: &str, fields: &[(&str, String)]) -> Bytes {
        let id = format!("{}-{}", self.start, self.seq);
        let mut text = format!("id: {id}\nevent: {name}\ndata: {{\"seq\":\"{id}\"");
        for (field, value) in fields {
            // Writing to a string cannot fail.
            let _ = write!(text, ",\"{field}\":{value}");
        }
        text.push_str("}\n\n");
        text.into()
    }

    /// Applies new states. Returns whether there is something new.
    fn update(&mut self, changes: Changes, silence: impl Fn(f64) -> f64) -> bool {
        let Changes { jobs, existing_jobs: there, workers, warnings } = changes;
        let next = self.seq + 1;
        let jobs = jobs.iter().map(|job| (job.job.0, json(&JobJson::from(job)))).collect();
        let have_jobs_changed = self.jobs.update(jobs, |number| there.contains(&JobId(number)), next);
        let worker = |it: &WorkerStatus| (it.worker.0, json(&WorkerJson::from(it).map_silence(&silence)));
        let sessions: BTreeMap<u64, String> = workers.connected.iter().map(worker).collect();
        let numbers: BTreeSet<u64> = sessions.keys().copied().collect();
        let offline = json(&workers.offline.iter().map(OfflineJson::from).collect::<Vec<_>>());
        let have_workers_changed = self.workers.update(sessions, |number| numbers.contains(&number), next);
        let have_left = self.offline != offline;
        if have_left {
            (self.offline, self.offline_changed) = (offline, next);
        }
        self.commit(have_jobs_changed || have_workers_changed || have_left, warnings)
    }

    /// Assigns a number to the changes. Returns whether there is something new.
    fn commit(&mut self, has_changed: bool, warnings: Vec<String>) -> bool {
        let next = self.seq + 1;
        let have_warnings_changed = self.warnings != warnings;
        if have_warnings_changed {
            (self.warnings, self.warnings_changed) = (warnings, next);
        }
        let is_new = self.seq == 0 || has_changed || have_warnings_changed;
        if is_new {
            let before = std::mem::replace(&mut self.seq, next);
            self.delta = Some((next, self.delta_event(before)));
        }
        is_new
    }
}

/// Serializes a value on one line. This does not fail for our types, which have no maps with keys other than strings.
fn json<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_else(|_| "null".to_owned())
}

impl Hub {
    fn lock(&self) -> MutexGuard<'_, State> {
        // A poisoned lock is safe to use: a panic in the few lines under it leaves no partial change.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Position of a listener in the feed.
struct Listener<S> {
    feed: Feed<S>,
    updates: watch::Receiver<u64>,
    last_seq: Option<u64>,
    caller: Option<Arc<Caller>>,
    last_sent: Instant,
}

impl<S: Send + 'static> Feed<S> {
    /// Interval between two queries of the farm.
    const QUERY_INTERVAL: Duration = Duration::from_secs(1);
    /// Interval between two keep-alives to a listener.
    const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(10);
    /// Shortest silence of a worker that is shown, in seconds. A shorter silence is normal between two heartbeats.
    const MIN_SILENCE: f64 = 3.0;

    /// Makes the feed of a farm. Its numbers are valid for this start of the coordinator only.
    pub fn new(farm: Farm<S>) -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let start = format!("{:x}", since.as_nanos());
        let hub = Hub { state: Mutex::new(State::new(start)), updates: watch::Sender::new(0) };
        Self { farm, hub: Arc::new(hub) }
    }

    /// Returns the server-sent events for one listener. The stream ends when the listener disconnects, the coordinator stops, or
    /// the credential becomes invalid.
    /// - `last`: id of the last event that the listener received.
    pub fn listen(
        &self,
        last: Option<&str>,
        caller: Option<Arc<Caller>>,
    ) -> impl Stream<Item = Result<Bytes, Infallible>> + Send + use<S> {
        let (news, known) = {
            let mut state = self.hub.lock();
            let mut news = self.hub.updates.subscribe();
            match state.query_task {
                QueryTask::Stopped => {
                    state.query_task = QueryTask::Starting;
                    tokio::spawn(self.clone().run());
                }
                // The listener waits for the end of the first query.
                QueryTask::Starting => {}
                QueryTask::Running => news.mark_changed(),
            }
            let number = |id: &str| id.strip_prefix(&*state.start)?.strip_prefix('-')?.parse().ok();
            (news, last.and_then(number).filter(|known: &u64| *known > 0 && *known <= state.seq))
        };
        let listener =
            Listener { feed: self.clone(), updates: news, last_seq: known, caller, last_sent: Instant::now() };
        unfold(listener, Listener::next)
    }

    /// Queries the farm while there are listeners.
    async fn run(self) {
        let mut timer = tokio::time::interval(Self::QUERY_INTERVAL);
        timer.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut is_first, mut scope) = (true, ChangeScope::All);
        loop {
            tokio::select! {
                _ = timer.tick() => {}
                () = self.farm.stopped() => return,
            }
            if !is_first {
                let mut state = self.hub.lock();
                if self.hub.updates.receiver_count() == 0 {
                    state.query_task = QueryTask::Stopped;
                    return;
                }
            }
            let is_new = self.query(&mut scope).await;
            if is_first {
                self.hub.lock().query_task = QueryTask::Running;
            }
            if is_new || is_first {
                self.hub.updates.send_modify(|news| *news += 1);
            }
            is_first = false;
        }
    }

    /// Queries the farm once. Returns whether there is something new.
    /// - `scope`: set to changes only, after the first successful query.
    async fn query(&self, scope: &mut ChangeScope) -> bool {
        let requested = *scope;
        let changes = self.farm.call(|reply| Call::Changes { scope: requested, reply }).await;
        let quiet = |silent: f64| if silent < Self::MIN_SILENCE { 0.0 } else { silent.floor() };
        match changes {
            Ok(changes) => {
                *scope = ChangeScope::Changes;
                self.hub.lock().update(changes, quiet)
            }
            // The known state is kept, with a warning.
            Err(refusal) => self.hub.lock().commit(false, vec![refusal.to_string()]),
        }
    }
}

impl<S: Send + 'static> Listener<S> {
    /// Waits for the next event and returns it.
    async fn next(mut self) -> Option<(Result<Bytes, Infallible>, Self)> {
        loop {
            if self.caller.as_ref().is_some_and(|caller| !caller.is_valid()) {
                return None;
            }
            let pause = tokio::time::sleep(Feed::<S>::QUERY_INTERVAL);
            tokio::select! {
                biased;
                () = self.feed.farm.stopped() => return None,
                changed = self.updates.changed() => {
                    changed.ok()?;
                    let message = self.feed.hub.lock().next_event(self.last_seq);
                    if let Some((known, event)) = message {
                        (self.last_seq, self.last_sent) = (Some(known), Instant::now());
                        return Some((Ok(event), self));
                    }
                }
                () = pause => {
                    if self.last_sent.elapsed() >= Feed::<S>::KEEP_ALIVE_INTERVAL {
                        self.last_sent = Instant::now();
                        return Some((Ok(Bytes::from_static(b": alive\n\n")), self));
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
