//! A log in memory: for tests, and for jobs that need not outlive the process.

use std::fs::File;
use std::sync::{Arc, Mutex, PoisonError};

use crate::{Batch, Contents, Note, Page, Queue, QueueError};

/// A log that lives until its last clone is dropped.
#[derive(Debug, Clone, Default)]
pub struct Memory(Arc<Mutex<Kept>>);

#[derive(Debug, Default)]
struct Kept {
    contents: Contents,
    /// Notes with their numbers, ascending.
    notes: Vec<(u64, Note)>,
    numbers: u64,
}

impl Memory {
    fn with<T>(&self, act: impl FnOnce(&mut Kept) -> T) -> T {
        // A poisoned lock still holds whole batches: no operation below stops halfway.
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Queue for Memory {
    async fn load(&mut self) -> Result<Contents, QueueError> {
        Ok(self.with(|kept| kept.contents.clone()))
    }

    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        self.with(|kept| {
            kept.contents.records.extend_from_slice(batch.records);
            kept.notes.retain(|(_, note)| !batch.forgotten.contains(&note.subject));
            for note in batch.notes {
                kept.numbers += 1;
                kept.notes.push((kept.numbers, note.clone()));
            }
        });
        Ok(())
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        let fresh = Contents { snapshot: Some(state.to_vec()), ..Contents::default() };
        self.with(|kept| kept.contents = fresh);
        Ok(())
    }

    async fn copy(&mut self) -> Result<File, QueueError> {
        Err(QueueError::NoCopy { instead: "it is in memory; start the coordinator with --store sqlite:PATH" })
    }

    async fn notes(&mut self, subject: u64, from: u64) -> Result<Page, QueueError> {
        Ok(self.with(|kept| {
            let later = kept.notes.iter().filter(|(number, note)| *number >= from && note.subject == subject);
            Page::of(later.map(|(number, note)| (*number, Some(note.bytes.clone()))))
        }))
    }
}
