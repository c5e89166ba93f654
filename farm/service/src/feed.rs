//! The farm as it changes, for any number of listeners.
//!
//! While somebody listens the farm is asked once a second. What has changed becomes one delta with a number, encoded once; a
//! listener that is up to date gets those bytes. One that was away, or reads slowly, gets all that has changed since the number
//! that it knows, joined into one delta: every job and worker is kept with the number of its last change, so nothing is
//! queued for anybody. What is gone is remembered for a while; who knows less than that gets a snapshot.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::convert::Infallible;
use std::fmt::{self, Write as _};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use bytes::Bytes;
use femc_model::Refusal;
use futures_util::Stream;
use futures_util::stream::unfold;
use serde::Serialize;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior};

use crate::access::Caller;
use crate::call::{Call, Listing};
use crate::farm::Farm;
use crate::view::{JobJson, WorkerJson};

/// What listeners hear; clones are the same feed.
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

/// What listeners share.
#[derive(Debug)]
struct Hub {
    state: Mutex<State>,
    /// How often there was something new.
    news: watch::Sender<u64>,
}

/// What is known of the farm.
#[derive(Debug)]
struct State {
    /// Of this start of the coordinator: numbers of another mean nothing.
    start: String,
    /// Number of the last change.
    seq: u64,
    jobs: Kept,
    workers: Kept,
    warnings: Vec<String>,
    warnings_changed: u64,
    /// Encoded: the last change, and all there is.
    delta: Option<(u64, Bytes)>,
    snapshot: Option<(u64, Bytes)>,
    /// Whether somebody asks the farm.
    is_running: bool,
}

/// Things by number, each as JSON with the number of its last change.
#[derive(Debug, Default)]
struct Kept {
    there: BTreeMap<u64, (String, u64)>,
    /// What is gone, in order of changes.
    gone: VecDeque<(u64, u64)>,
    /// Changes up to this one have been forgotten.
    forgotten: u64,
}

impl Kept {
    /// Most that is remembered of what is gone.
    const GONE: usize = 4096;

    /// Takes in what there is now; says whether that is something else than before.
    fn update(&mut self, now: BTreeMap<u64, String>, seq: u64) -> bool {
        let mut has_changed = false;
        let gone: Vec<u64> = self.there.keys().filter(|number| !now.contains_key(number)).copied().collect();
        for number in gone {
            self.there.remove(&number);
            self.gone.push_back((seq, number));
            has_changed = true;
        }
        while self.gone.len() > Self::GONE {
            self.forgotten = self.gone.pop_front().map_or(self.forgotten, |(seq, _)| seq);
        }
        for (number, json) in now {
            if self.there.get(&number).is_none_or(|(known, _)| *known != json) {
                self.there.insert(number, (json, seq));
                has_changed = true;
            }
        }
        has_changed
    }

    /// As a JSON list: what has changed since.
    fn since(&self, seq: u64) -> String {
        let changed = self.there.values().filter(|(_, changed)| *changed > seq);
        format!("[{}]", changed.map(|(json, _)| json.as_str()).collect::<Vec<_>>().join(","))
    }

    /// As a JSON list: what is gone since.
    fn gone_since(&self, seq: u64) -> String {
        let gone = self.gone.iter().filter(|(at, number)| *at > seq && !self.there.contains_key(number));
        let numbers: BTreeSet<u64> = gone.map(|(_, number)| *number).collect();
        format!("[{}]", numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(","))
    }
}

impl State {
    fn new(start: String) -> Self {
        Self {
            start,
            seq: 0,
            jobs: Kept::default(),
            workers: Kept::default(),
            warnings: Vec::new(),
            warnings_changed: 0,
            delta: None,
            snapshot: None,
            is_running: false,
        }
    }

    /// What a listener is to hear that knows the change `known`, and the number that it knows then.
    fn message(&mut self, known: Option<u64>) -> Option<(u64, Bytes)> {
        match known {
            Some(known) if known == self.seq => None,
            Some(known) if known < self.seq && known >= self.jobs.forgotten.max(self.workers.forgotten) => {
                if known + 1 == self.seq
                    && let Some(delta) = self.delta.clone()
                {
                    return Some(delta);
                }
                Some((self.seq, self.joined(known)))
            }
            Some(_) | None => {
                let is_old = self.snapshot.as_ref().is_none_or(|(seq, _)| *seq != self.seq);
                if is_old {
                    self.snapshot = Some((self.seq, self.whole()));
                }
                self.snapshot.clone()
            }
        }
    }

    /// The event with all that has changed since.
    fn joined(&self, since: u64) -> Bytes {
        let warnings = if self.warnings_changed > since { json(&self.warnings) } else { "null".to_owned() };
        let fields = [
            ("jobs", self.jobs.since(since)),
            ("gone_jobs", self.jobs.gone_since(since)),
            ("workers", self.workers.since(since)),
            ("gone_workers", self.workers.gone_since(since)),
            ("warnings", warnings),
        ];
        self.event("delta", &fields)
    }

    /// The event with all there is.
    fn whole(&self) -> Bytes {
        let fields =
            [("jobs", self.jobs.since(0)), ("workers", self.workers.since(0)), ("warnings", json(&self.warnings))];
        self.event("snapshot", &fields)
    }

    fn event(&self, name: &str, fields: &[(&str, String)]) -> Bytes {
        let id = format!("{}-{}", self.start, self.seq);
        let mut text = format!("id: {id}\nevent: {name}\ndata: {{\"seq\":\"{id}\"");
        for (field, value) in fields {
            // Writing to a string does not fail.
            let _ = write!(text, ",\"{field}\":{value}");
        }
        text.push_str("}\n\n");
        text.into()
    }

    /// Takes in what there is now; says whether there is something new.
    fn update(&mut self, jobs: BTreeMap<u64, String>, workers: BTreeMap<u64, String>, warnings: Vec<String>) -> bool {
        let next = self.seq + 1;
        let have_jobs_changed = self.jobs.update(jobs, next);
        let have_workers_changed = self.workers.update(workers, next);
        let have_warnings_changed = self.warnings != warnings;
        if have_warnings_changed {
            (self.warnings, self.warnings_changed) = (warnings, next);
        }
        let is_new = self.seq == 0 || have_jobs_changed || have_workers_changed || have_warnings_changed;
        if is_new {
            let before = std::mem::replace(&mut self.seq, next);
            self.delta = Some((next, self.joined(before)));
        }
        is_new
    }
}

/// On one line; what is there has no maps with strange keys.
fn json<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_else(|_| "null".to_owned())
}

impl Hub {
    fn lock(&self) -> MutexGuard<'_, State> {
        // A panic within the few lines under this lock leaves nothing half done.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Where a listener stands.
struct Listener<S> {
    feed: Feed<S>,
    news: watch::Receiver<u64>,
    known: Option<u64>,
    caller: Option<Arc<Caller>>,
    heard: Instant,
}

impl<S: Send + 'static> Feed<S> {
    /// Between two looks at the farm.
    const EVERY: Duration = Duration::from_secs(1);
    /// Between two signs of life to a listener.
    const ALIVE: Duration = Duration::from_secs(10);
    /// Silence of a worker that is worth a word: less is the time between two heartbeats.
    const SILENCE: f64 = 3.0;

    /// Of this farm, as this start of its coordinator knows it.
    pub fn new(farm: Farm<S>) -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let start = format!("{:x}", since.as_nanos());
        let hub = Hub { state: Mutex::new(State::new(start)), news: watch::Sender::new(0) };
        Self { farm, hub: Arc::new(hub) }
    }

    /// Server-sent events for one listener, until it goes away, the coordinator ends, or its identity counts no more.
    /// - `last`: the id of the last event that it has heard.
    pub fn listen(
        &self,
        last: Option<&str>,
        caller: Option<Arc<Caller>>,
    ) -> impl Stream<Item = Result<Bytes, Infallible>> + Send + use<S> {
        let (news, known) = {
            let mut state = self.hub.lock();
            let mut news = self.hub.news.subscribe();
            if !std::mem::replace(&mut state.is_running, true) {
                tokio::spawn(self.clone().run());
            } else if state.seq > 0 {
                news.mark_changed();
            }
            let number = |id: &str| id.strip_prefix(&*state.start)?.strip_prefix('-')?.parse().ok();
            (news, last.and_then(number).filter(|known: &u64| *known > 0 && *known <= state.seq))
        };
        let listener = Listener { feed: self.clone(), news, known, caller, heard: Instant::now() };
        unfold(listener, Listener::next)
    }

    /// Asks the farm while somebody listens.
    async fn run(self) {
        let mut timer = tokio::time::interval(Self::EVERY);
        timer.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut is_first = true;
        loop {
            tokio::select! {
                _ = timer.tick() => {}
                () = self.farm.ended() => return,
            }
            if !is_first {
                let mut state = self.hub.lock();
                if self.hub.news.receiver_count() == 0 {
                    state.is_running = false;
                    return;
                }
            }
            let is_new = self.look().await;
            if is_new || is_first {
                self.hub.news.send_modify(|news| *news += 1);
            }
            is_first = false;
        }
    }

    /// Asks once; says whether there is something new.
    async fn look(&self) -> bool {
        let listing = self.farm.ask(|reply| Call::List { reply }).await;
        let workers = self.farm.ask(|reply| Call::Workers { reply }).await;
        match (listing, workers) {
            (Ok(Listing { jobs, warnings }), Ok(workers)) => {
                let jobs = jobs.iter().map(|job| (job.job.0, json(&JobJson::from(job)))).collect();
                let quiet = |silent: f64| if silent < Self::SILENCE { 0.0 } else { silent.floor() };
                let worker = |it| json(&WorkerJson::from(it).silent(quiet));
                let workers = workers.iter().map(|it| (it.worker.0, worker(it))).collect();
                self.hub.lock().update(jobs, workers, warnings)
            }
            (Err(refusal), _) | (_, Err(refusal)) => self.cannot(&refusal),
        }
    }

    /// The coordinator does not answer: what is known stays, with a warning.
    fn cannot(&self, refusal: &Refusal) -> bool {
        let mut state = self.hub.lock();
        let of = |kept: &Kept| kept.there.iter().map(|(number, (json, _))| (*number, json.clone())).collect();
        let (jobs, workers) = (of(&state.jobs), of(&state.workers));
        state.update(jobs, workers, vec![refusal.to_string()])
    }
}

impl<S: Send + 'static> Listener<S> {
    /// The next event, as soon as there is one.
    async fn next(mut self) -> Option<(Result<Bytes, Infallible>, Self)> {
        loop {
            if self.caller.as_ref().is_some_and(|caller| !caller.still_counts()) {
                return None;
            }
            let pause = tokio::time::sleep(Feed::<S>::EVERY);
            tokio::select! {
                biased;
                () = self.feed.farm.ended() => return None,
                changed = self.news.changed() => {
                    changed.ok()?;
                    let message = self.feed.hub.lock().message(self.known);
                    if let Some((known, event)) = message {
                        (self.known, self.heard) = (Some(known), Instant::now());
                        return Some((Ok(event), self));
                    }
                }
                () = pause => {
                    if self.heard.elapsed() >= Feed::<S>::ALIVE {
                        self.heard = Instant::now();
                        return Some((Ok(Bytes::from_static(b": alive\n\n")), self));
                    }
                }
            }
        }
    }
}
