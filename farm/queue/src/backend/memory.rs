//! A log in memory: for tests, and for jobs that need not outlive the process.

use std::sync::{Arc, Mutex, PoisonError};

use crate::{Contents, Queue, QueueError};

/// A log that lives as long as one of its clones.
#[derive(Debug, Clone, Default)]
pub struct Memory(Arc<Mutex<Contents>>);

impl Memory {
    fn with<T>(&self, act: impl FnOnce(&mut Contents) -> T) -> T {
        // A poisoned lock still holds whole batches: each change below is one assignment or one `extend`.
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Queue for Memory {
    async fn load(&mut self) -> Result<Contents, QueueError> {
        Ok(self.with(|contents| contents.clone()))
    }

    async fn append(&mut self, records: &[Vec<u8>]) -> Result<(), QueueError> {
        self.with(|contents| contents.records.extend_from_slice(records));
        Ok(())
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        let fresh = Contents { snapshot: Some(state.to_vec()), ..Contents::default() };
        self.with(|contents| *contents = fresh);
        Ok(())
    }
}
