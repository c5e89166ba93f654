//! A log in memory: for tests, and for jobs that need not outlive the process.

use std::fs::File;
use std::sync::{Arc, Mutex, PoisonError};

use crate::{Batch, LogContents, Note, NotePage, Queue, QueueError};

/// A log that lives until its last clone is dropped.
#[derive(Debug, Clone, Default)]
pub struct Memory(Arc<Mutex<MemoryState>>);

#[derive(Debug, Default)]
struct MemoryState {
    contents: LogContents,
    /// Notes with their numbers, ascending.
    notes: Vec<(u64, Note)>,
    last_number: u64,
}

impl Memory {
    fn with_state<T>(&self, act: impl FnOnce(&mut MemoryState) -> T) -> T {
        // A poisoned lock still holds whole batches: no operation below stops halfway.
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Queue for Memory {
    async fn load(&mut self) -> Result<LogContents, QueueError> {
        Ok(self.with_state(|state| state.contents.clone()))
    }

    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        self.with_state(|state| {
            state.contents.records.extend_from_slice(batch.records);
            state.notes.retain(|(_, note)| !batch.forgotten.contains(&note.subject));
            for note in batch.notes {
                state.last_number += 1;
                state.notes.push((state.last_number, note.clone()));
            }
        });
        Ok(())
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        let fresh = LogContents { snapshot: Some(state.to_vec()), ..LogContents::default() };
        self.with_state(|kept| kept.contents = fresh);
        Ok(())
    }

    async fn copy(&mut self) -> Result<File, QueueError> {
        Err(QueueError::NoCopy { instead: "it is in memory; start the coordinator with --store sqlite:PATH" })
    }

    async fn notes(&mut self, subject: u64, from: u64) -> Result<NotePage, QueueError> {
        Ok(self.with_state(|state| {
            let later = state.notes.iter().filter(|(number, note)| *number >= from && note.subject == subject);
            NotePage::from_notes(later.map(|(number, note)| (*number, Some(note.bytes.clone()))))
        }))
    }
}
