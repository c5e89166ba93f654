//! Limits on concurrent transfers. A transfer may use some megabytes of memory, so their number is limited. Other transfers wait,
//! which costs only their streams.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{CallerKey, Limits};

/// Slots for uploads and downloads. Clones share them.
#[derive(Debug, Clone)]
pub struct TransferSlots {
    limits: Limits,
    all: Arc<Semaphore>,
    /// Slots of each owner that has some in use.
    by_owner: Arc<Mutex<BTreeMap<Owner, Arc<Semaphore>>>>,
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Owner {
    Connection(u64),
    Caller(String),
}

/// A slot for a transfer, held until dropped.
#[derive(Debug)]
pub struct TransferSlot(#[expect(dead_code, reason = "they are held")] Vec<OwnedSemaphorePermit>);

impl TransferSlots {
    /// Makes as many slots as the limits permit.
    pub fn new(limits: &Limits) -> Self {
        Self { limits: *limits, all: Arc::new(Semaphore::new(limits.transfers)), by_owner: Arc::default() }
    }

    /// Waits for a slot: first for one of the connection and the caller, then for one of all. So a caller with many transfers does
    /// not delay other callers.
    pub async fn acquire(&self, key: CallerKey) -> TransferSlot {
        let Limits {
            transfers_per_connection: transfers_of_connection, transfers_per_caller: transfers_of_caller, ..
        } = self.limits;
        let own = self.semaphore(Owner::Connection(key.connection), transfers_of_connection);
        let callers = key.name.map(|name| self.semaphore(Owner::Caller(name), transfers_of_caller));
        let mut held = Vec::new();
        for semaphore in [Some(own), callers, Some(self.all.clone())].into_iter().flatten() {
            // The semaphores are never closed.
            held.extend(semaphore.acquire_owned().await.ok());
        }
        TransferSlot(held)
    }

    fn semaphore(&self, owner: Owner, most: usize) -> Arc<Semaphore> {
        // A poisoned lock is safe to use: a panic in the few lines under it leaves no partial change.
        let mut by_owner = self.by_owner.lock().unwrap_or_else(PoisonError::into_inner);
        // A held permit keeps its semaphore alive.
        by_owner.retain(|_, places| Arc::strong_count(places) > 1);
        by_owner.entry(owner).or_insert_with(|| Arc::new(Semaphore::new(most))).clone()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn who_has_many_waits_for_itself_and_not_others() {
        let limits = Limits { transfers: 6, transfers_per_caller: 3, transfers_per_connection: 2, ..Limits::default() };
        let places = TransferSlots::new(&limits);
        let take = |name: &str, connection| {
            let who = CallerKey { name: Some(name.into()), connection };
            tokio::time::timeout(Duration::from_secs(60), places.acquire(who))
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
        assert!(places.by_owner.lock().unwrap().len() <= 2, "who has no transfers is forgotten");
    }
}
