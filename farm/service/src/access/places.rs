//! Transfers at a time: each may have some megabytes in memory, so there are only so many. The others wait, which costs nothing but
//! their streams.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{Limits, Who};

/// Places for uploads and downloads; clones share them.
#[derive(Debug, Clone)]
pub struct Places {
    limits: Limits,
    all: Arc<Semaphore>,
    /// Of each that has some in use.
    of: Arc<Mutex<BTreeMap<Owner, Arc<Semaphore>>>>,
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Owner {
    Connection(u64),
    Caller(String),
}

/// The right to a transfer, until dropped.
#[derive(Debug)]
pub struct Place(#[expect(dead_code, reason = "they are held")] Vec<OwnedSemaphorePermit>);

impl Places {
    /// As many as the limits have.
    pub fn new(limits: &Limits) -> Self {
        Self { limits: *limits, all: Arc::new(Semaphore::new(limits.transfers)), of: Arc::default() }
    }

    /// Waits until there is one: first for one of the caller's own, so that who has many does not keep the others waiting.
    pub async fn take(&self, who: Who) -> Place {
        let Limits { transfers_of_connection, transfers_of_caller, .. } = self.limits;
        let own = self.of(Owner::Connection(who.connection), transfers_of_connection);
        let callers = who.name.map(|name| self.of(Owner::Caller(name), transfers_of_caller));
        let mut held = Vec::new();
        for places in [Some(own), callers, Some(self.all.clone())].into_iter().flatten() {
            // They are never closed.
            held.extend(places.acquire_owned().await.ok());
        }
        Place(held)
    }

    fn of(&self, owner: Owner, most: usize) -> Arc<Semaphore> {
        // A panic within the few lines under this lock leaves nothing half done.
        let mut of = self.of.lock().unwrap_or_else(PoisonError::into_inner);
        // A permit that is held holds its semaphore.
        of.retain(|_, places| Arc::strong_count(places) > 1);
        of.entry(owner).or_insert_with(|| Arc::new(Semaphore::new(most))).clone()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn who_has_many_waits_for_itself_and_not_others() {
        let limits = Limits { transfers: 6, transfers_of_caller: 3, transfers_of_connection: 2, ..Limits::default() };
        let places = Places::new(&limits);
        let take = |name: &str, connection| {
            let who = Who { name: Some(name.into()), connection };
            tokio::time::timeout(Duration::from_secs(60), places.take(who))
        };
        let mut taken = vec![take("ann", 1).await.unwrap(), take("ann", 1).await.unwrap()];
        assert!(take("ann", 1).await.is_err(), "her first machine has two");
        taken.push(take("ann", 2).await.unwrap());
        assert!(take("ann", 3).await.is_err(), "ann has three");
        for connection in [4, 5, 6] {
            taken.push(take("bob", connection).await.unwrap());
        }
        assert!(take("eve", 7).await.is_err(), "all are taken");
        taken.clear();
        drop(take("eve", 8).await.unwrap());
        drop(take("ann", 1).await.unwrap());
        assert!(places.of.lock().unwrap().len() <= 2, "who has no transfers is forgotten");
    }
}
