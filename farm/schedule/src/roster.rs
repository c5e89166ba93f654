//! The workers that have been there: who they were, and when they were heard of last.
//!
//! A session ends and nobody knows whether its worker will be back, so a name is kept for a month, also over the coordinator's
//! restarts: as a note beside the log, which no fact depends on. A coordinator that is killed knows last contacts as they were at
//! its last note.

use std::collections::{BTreeMap, BTreeSet};

use femc_model::{OfflineWorker, WorkerStatus};

use crate::SnapshotError;

/// First byte of a note; a roster of another version is not read: workers are known again when they come.
const VERSION: u8 = 1;

/// Workers by name. Several of one name are one here.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Roster {
    known: BTreeMap<String, OfflineWorker>,
}

impl Roster {
    /// Most workers that are known.
    const MOST: usize = 1024;
    /// Milliseconds for which one is known that has not been heard of: 30 days.
    const KEPT: u64 = 30 * 24 * 3_600_000;

    /// Takes notice of those that are there.
    /// - `date`: now, Unix milliseconds.
    pub fn observe(&mut self, workers: &[WorkerStatus], date: u64) {
        for worker in workers {
            let heard = date.saturating_sub(worker.silent);
            let before = self.known.get(&worker.name).map_or(0, |known| known.heard);
            if heard < before {
                continue;
            }
            let WorkerStatus { name, threads, tags, engine, .. } = worker.clone();
            self.known.insert(name.clone(), OfflineWorker { name, threads, tags, engine, heard });
        }
        self.known.retain(|_, known| known.heard.saturating_add(Self::KEPT) >= date);
        let surplus = self.known.len().saturating_sub(Self::MOST);
        if surplus > 0 {
            let mut heard: Vec<(u64, String)> = self.known.values().map(|it| (it.heard, it.name.clone())).collect();
            heard.sort_unstable();
            heard.truncate(surplus);
            heard.iter().for_each(|(_, name)| drop(self.known.remove(name)));
        }
    }

    /// Those that are not there, the latest first.
    pub fn offline(&self, there: &[WorkerStatus]) -> Vec<OfflineWorker> {
        let names: BTreeSet<&str> = there.iter().map(|worker| worker.name.as_str()).collect();
        let mut offline: Vec<OfflineWorker> =
            self.known.values().filter(|known| !names.contains(known.name.as_str())).cloned().collect();
        offline.sort_by(|a, b| b.heard.cmp(&a.heard).then_with(|| a.name.cmp(&b.name)));
        offline
    }

    /// As a note beside the log.
    pub fn encode(&self) -> Result<Vec<u8>, SnapshotError> {
        let known: Vec<&OfflineWorker> = self.known.values().collect();
        Ok(postcard::to_extend(&known, vec![VERSION])?)
    }

    /// What [`Self::encode`] wrote.
    pub fn decode(note: &[u8]) -> Result<Self, SnapshotError> {
        let known: Vec<OfflineWorker> = match note.split_first() {
            Some((&VERSION, known)) => postcard::from_bytes(known)?,
            Some((&found, _)) => return Err(SnapshotError::RosterVersion { found }),
            None => return Err(SnapshotError::Empty),
        };
        Ok(Self { known: known.into_iter().map(|worker| (worker.name.clone(), worker)).collect() })
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

    fn heard(workers: &[OfflineWorker]) -> Vec<(&str, u64)> {
        workers.iter().map(|it| (it.name.as_str(), it.heard)).collect()
    }

    #[test]
    fn who_is_gone_is_known_with_the_last_contact_until_it_is_back_also_after_a_restart() {
        let mut roster = Roster::default();
        roster.observe(&[worker("a", 10), worker("b", 0)], 1000);
        assert_eq!(roster.offline(&[worker("a", 10), worker("b", 0)]), []);
        roster.observe(&[worker("a", 5)], 2000);
        assert_eq!(heard(&roster.offline(&[worker("a", 5)])), [("b", 1000)]);
        let again = Roster::decode(&roster.encode().unwrap()).unwrap();
        assert_eq!(again, roster);
        assert_eq!(heard(&again.offline(&[])), [("a", 1995), ("b", 1000)], "nobody has come yet: the latest first");
        assert_eq!(again.offline(&[worker("b", 0), worker("a", 0)]), []);
    }

    #[test]
    fn of_several_of_one_name_the_one_that_was_heard_last_counts() {
        let mut roster = Roster::default();
        roster.observe(&[worker("a", 1), worker("a", 500)], 1000);
        assert_eq!(heard(&roster.offline(&[])), [("a", 999)]);
    }

    #[test]
    fn names_that_are_never_back_do_not_pile_up() {
        let mut roster = Roster::default();
        for number in 0..3000 {
            roster.observe(&[worker(&number.to_string(), 0)], number);
        }
        let offline = roster.offline(&[]);
        assert_eq!((offline.len(), offline[0].heard, offline[1023].heard), (1024, 2999, 1976));
        roster.observe(&[worker("late", 0)], 2999 + Roster::KEPT);
        assert_eq!(heard(&roster.offline(&[])), [("late", 2999 + Roster::KEPT), ("2999", 2999)]);
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
