//! The roster of known workers: their names and numbers, the tasks that they have completed, and the times of their last contacts.
//!
//! When a session ends, its worker may return or not. So a name is kept for a month, also across restarts of the coordinator, as a
//! note beside the log; no fact depends on it. A coordinator that starts after a kill knows last contacts and counts as of its last
//! note. A returning worker gets its old number, and its counts continue.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{OfflineWorker, WorkerId, WorkerStatus};
use serde::{Deserialize, Serialize};

use crate::SnapshotError;

/// First byte of a note: its version. Version 1 can be read and has no numbers. A roster of a later version is not read: its
/// workers become known when they connect.
const VERSION: u8 = 2;

/// Workers by name. Workers with the same name share a last contact; each has its own number.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Roster {
    known: BTreeMap<String, OfflineWorker>,
    /// Numbers by name.
    numbers: BTreeMap<String, Vec<NumberedWorker>>,
    /// Sessions, with the counts of their workers at the start of the session.
    present: BTreeMap<WorkerId, TaskCounts>,
}

/// A worker's number, with its counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct NumberedWorker {
    number: WorkerId,
    counts: TaskCounts,
}

/// Numbers of tasks that a worker has completed, and that have failed there.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
struct TaskCounts {
    completed: u64,
    failed: u64,
}

impl TaskCounts {
    fn from_status(status: &WorkerStatus) -> Self {
        Self { completed: status.completed, failed: status.failed }
    }
}

impl Roster {
    /// Maximum number of known workers.
    const MAX_WORKERS: usize = 1024;
    /// Milliseconds for which a worker stays known after its last contact: 30 days.
    const RETENTION: u64 = 30 * 24 * 3_600_000;

    /// Returns the number of a joining worker: that of an earlier session with this name, or a new one.
    pub fn join(&mut self, name: &str) -> WorkerId {
        let highest = self.numbers.values().flatten().map(|known| known.number.0).max().unwrap_or(0);
        let own = self.numbers.entry(name.to_owned()).or_default();
        let free =
            own.iter().filter(|known| !self.present.contains_key(&known.number)).min_by_key(|known| known.number);
        let known = free.copied().unwrap_or_else(|| {
            let new = NumberedWorker { number: WorkerId(highest + 1), counts: TaskCounts::default() };
            own.push(new);
            new
        });
        self.present.insert(known.number, known.counts);
        known.number
    }

    /// Ends a session. Pass its counts to [`Self::observe`] before.
    pub fn leave(&mut self, worker: WorkerId) {
        self.present.remove(&worker);
    }

    /// Adds the counts of earlier sessions.
    pub fn add_earlier(&self, workers: &mut [WorkerStatus]) {
        for worker in workers {
            let earlier = self.present.get(&worker.worker).copied().unwrap_or_default();
            worker.completed += earlier.completed;
            worker.failed += earlier.failed;
        }
    }

    /// Updates the roster with the connected workers.
    /// - `workers`: with the counts of all their sessions;
    /// - `date`: now, Unix milliseconds.
    pub fn observe(&mut self, workers: &[WorkerStatus], date: u64) {
        for worker in workers {
            for known in self.numbers.get_mut(&worker.name).into_iter().flatten() {
                if known.number == worker.worker {
                    known.counts = TaskCounts::from_status(worker);
                }
            }
            let heard = date.saturating_sub(worker.silent);
            let before = self.known.get(&worker.name).map_or(0, |known| known.last_contact);
            if heard < before {
                continue;
            }
            let WorkerStatus { name, threads, tags, engine, .. } = worker.clone();
            self.known.insert(name.clone(), OfflineWorker { name, threads, tags, engine, last_contact: heard });
        }
        self.known.retain(|_, known| known.last_contact.saturating_add(Self::RETENTION) >= date);
        let surplus = self.known.len().saturating_sub(Self::MAX_WORKERS);
        if surplus > 0 {
            let mut contacts: Vec<(u64, String)> =
                self.known.values().map(|it| (it.last_contact, it.name.clone())).collect();
            contacts.sort_unstable();
            contacts.truncate(surplus);
            contacts.iter().for_each(|(_, name)| drop(self.known.remove(name)));
        }
        let Self { known, numbers, present } = self;
        numbers.retain(|name, own| known.contains_key(name) || own.iter().any(|own| present.contains_key(&own.number)));
    }

    /// Returns the workers that are not connected, the latest contact first.
    pub fn offline(&self, connected: &[WorkerStatus]) -> Vec<OfflineWorker> {
        let names: BTreeSet<&str> = connected.iter().map(|worker| worker.name.as_str()).collect();
        let mut offline: Vec<OfflineWorker> =
            self.known.values().filter(|known| !names.contains(known.name.as_str())).cloned().collect();
        offline.sort_by(|a, b| b.last_contact.cmp(&a.last_contact).then_with(|| a.name.cmp(&b.name)));
        offline
    }

    /// Encodes the roster as a note beside the log.
    pub fn encode(&self) -> Result<Vec<u8>, SnapshotError> {
        let known: Vec<&OfflineWorker> = self.known.values().collect();
        Ok(postcard::to_extend(&(known, &self.numbers), vec![VERSION])?)
    }

    /// Decodes a note of [`Self::encode`].
    pub fn decode(note: &[u8]) -> Result<Self, SnapshotError> {
        let (known, numbers): (Vec<OfflineWorker>, _) = match note.split_first() {
            Some((&VERSION, known)) => postcard::from_bytes(known)?,
            Some((1, known)) => (postcard::from_bytes(known)?, BTreeMap::new()),
            Some((&found, _)) => return Err(SnapshotError::RosterVersion { found }),
            None => return Err(SnapshotError::Empty),
        };
        let known = known.into_iter().map(|worker| (worker.name.clone(), worker)).collect();
        Ok(Self { known, numbers, present: BTreeMap::new() })
    }
}

#[cfg(test)]
mod tests {
    use femc_model::{Intake, WorkerId};

    use super::*;

    fn worker(name: &str, silent: u64) -> WorkerStatus {
        WorkerStatus {
            worker: WorkerId(1),
            name: name.into(),
            threads: 4,
            tags: vec!["lab".into()],
            tasks: Vec::new(),
            silent,
            completed: 3,
            failed: 0,
            intake: Intake::Open,
            engine: "build".into(),
        }
    }

    fn last_contacts(workers: &[OfflineWorker]) -> Vec<(&str, u64)> {
        workers.iter().map(|it| (it.name.as_str(), it.last_contact)).collect()
    }

    /// Creates a session with these numbers of completed and failed tasks.
    fn session(worker: WorkerId, name: &str, completed: u64, failed: u64) -> WorkerStatus {
        WorkerStatus { worker, completed, failed, ..self::worker(name, 0) }
    }

    fn counts(roster: &Roster, session: WorkerStatus) -> (u64, u64) {
        let mut sessions = [session];
        roster.add_earlier(&mut sessions);
        (sessions[0].completed, sessions[0].failed)
    }

    #[test]
    fn returning_worker_keeps_number_and_counts_even_after_restart() {
        let mut roster = Roster::default();
        let (a, b) = (roster.join("a"), roster.join("b"));
        assert_eq!((a, b), (WorkerId(1), WorkerId(2)));
        assert_eq!(counts(&roster, session(a, "a", 7, 1)), (7, 1));
        roster.observe(&[session(a, "a", 7, 1), session(b, "b", 5, 0)], 1000);
        // The coordinator restarts, and the workers reconnect in another order.
        let mut roster = Roster::decode(&roster.encode().unwrap()).unwrap();
        assert_eq!((roster.join("new"), roster.join("b"), roster.join("a")), (WorkerId(3), b, a));
        assert_eq!(counts(&roster, session(a, "a", 2, 1)), (9, 2));
        // The worker leaves and returns.
        roster.observe(&[session(a, "a", 9, 2)], 2000);
        roster.leave(a);
        assert_eq!(roster.join("a"), a);
        assert_eq!(counts(&roster, session(a, "a", 0, 0)), (9, 2));
    }

    #[test]
    fn workers_of_the_same_name_have_a_number_each() {
        let mut roster = Roster::default();
        let (first, second) = (roster.join("a"), roster.join("a"));
        assert_ne!(first, second);
        roster.observe(&[session(first, "a", 3, 0), session(second, "a", 4, 0)], 1000);
        roster.leave(second);
        assert_eq!(roster.join("a"), second, "the first is still there");
        assert_eq!(counts(&roster, session(second, "a", 1, 0)), (5, 0));
        assert_eq!(counts(&roster, session(first, "a", 3, 0)), (3, 0));
    }

    #[test]
    fn numbers_are_forgotten_with_the_name() {
        let mut roster = Roster::default();
        let (a, b) = (roster.join("a"), roster.join("b"));
        roster.observe(&[session(a, "a", 7, 1), session(b, "b", 0, 0)], 1000);
        roster.leave(a);
        let later = 2000 + Roster::RETENTION;
        roster.observe(&[session(b, "b", 0, 0)], later);
        assert_eq!(roster.join("c"), WorkerId(3));
        let back = roster.join("a");
        assert_eq!((back, counts(&roster, session(back, "a", 0, 0))), (WorkerId(4), (0, 0)));
    }

    #[test]
    fn a_note_without_numbers_is_read() {
        let mut roster = Roster::default();
        roster.observe(&[worker("a", 0)], 1000);
        let known: Vec<&OfflineWorker> = roster.known.values().collect();
        let note = postcard::to_extend(&known, vec![1]).unwrap();
        assert_eq!(Roster::decode(&note), Ok(roster));
    }

    #[test]
    fn offline_worker_keeps_its_last_contact_even_after_restart() {
        let mut roster = Roster::default();
        roster.observe(&[worker("a", 10), worker("b", 0)], 1000);
        assert_eq!(roster.offline(&[worker("a", 10), worker("b", 0)]), []);
        roster.observe(&[worker("a", 5)], 2000);
        assert_eq!(last_contacts(&roster.offline(&[worker("a", 5)])), [("b", 1000)]);
        let again = Roster::decode(&roster.encode().unwrap()).unwrap();
        assert_eq!(again, roster);
        assert_eq!(
            last_contacts(&again.offline(&[])),
            [("a", 1995), ("b", 1000)],
            "all workers are offline, the latest contact first"
        );
        assert_eq!(again.offline(&[worker("b", 0), worker("a", 0)]), []);
    }

    #[test]
    fn of_several_of_one_name_the_one_that_was_heard_last_counts() {
        let mut roster = Roster::default();
        roster.observe(&[worker("a", 1), worker("a", 500)], 1000);
        assert_eq!(last_contacts(&roster.offline(&[])), [("a", 999)]);
    }

    #[test]
    fn names_that_are_never_back_do_not_pile_up() {
        let mut roster = Roster::default();
        for number in 0..3000 {
            roster.observe(&[worker(&number.to_string(), 0)], number);
        }
        let offline = roster.offline(&[]);
        assert_eq!((offline.len(), offline[0].last_contact, offline[1023].last_contact), (1024, 2999, 1976));
        roster.observe(&[worker("late", 0)], 2999 + Roster::RETENTION);
        assert_eq!(last_contacts(&roster.offline(&[])), [("late", 2999 + Roster::RETENTION), ("2999", 2999)]);
    }

    #[test]
    fn a_note_that_is_cut_or_of_another_version_is_refused() {
        let mut roster = Roster::default();
        roster.observe(&[worker("a", 0)], 1000);
        let note = roster.encode().unwrap();
        for end in 0..note.len() {
            assert!(Roster::decode(&note[..end]).is_err(), "cut at {end}");
        }
        assert_eq!(Roster::decode(&[9]), Err(SnapshotError::RosterVersion { found: 9 }));
    }
}
