//! The log's disk: it outlives crashes and knows who may write.

use std::future::pending;
use std::io;
use std::time::Duration;

use femc_queue::{Batch, Contents, Note, Page, Queue, QueueError};
use femc_schedule::Fact;

use crate::shared::{Shared, State, Trap};

/// Longest that the disk takes before and after a write.
const SEEK: Duration = Duration::from_millis(6);

/// What is on the log's disk.
#[derive(Debug, Default)]
pub(crate) struct Disk {
    pub(crate) contents: Contents,
    /// All records ever written, whatever snapshots have replaced.
    pub(crate) history: Vec<Vec<u8>>,
    /// What is kept beside the log, oldest first.
    pub(crate) notes: Vec<Note>,
    /// Of the coordinator that may write.
    epoch: i64,
    /// So many writes find no room.
    pub(crate) full: u32,
    pub(crate) snapshots: u32,
    /// Most records that were there at a time beside a snapshot.
    pub(crate) longest: usize,
}

/// The log, in the hands of one coordinator.
#[derive(Debug)]
pub(crate) struct Log {
    shared: Shared,
    host: usize,
    epoch: i64,
}

impl Log {
    /// Takes the lead: whoever had it before may write no more.
    pub(crate) fn lead(shared: &Shared, host: usize) -> Self {
        let mut state = shared.lock();
        state.disk.epoch += 1;
        Self { shared: shared.clone(), host, epoch: state.disk.epoch }
    }

    /// Writes, unless another leads, there is no room, or the process dies over it.
    async fn write(&self, write: impl FnOnce(&mut State)) -> Result<(), QueueError> {
        tokio::time::sleep(self.shared.pause(SEEK)).await;
        if self.falls(Trap::Before) {
            pending::<()>().await;
        }
        {
            let mut state = self.shared.lock();
            if state.disk.epoch != self.epoch {
                state.fired("stale leader refused");
                return Err(QueueError::Deposed { epoch: self.epoch });
            }
            if state.disk.full > 0 {
                state.disk.full -= 1;
                state.fired("log full");
                return Err(io::Error::from(io::ErrorKind::StorageFull).into());
            }
            write(&mut state);
        }
        if self.falls(Trap::After) {
            pending::<()>().await;
        }
        tokio::time::sleep(self.shared.pause(SEEK)).await;
        Ok(())
    }

    /// Whether the process dies here.
    fn falls(&self, at: Trap) -> bool {
        let mut state = self.shared.lock();
        match &mut state.trap {
            Some((left, trap)) if *trap == at => {
                *left = left.saturating_sub(1);
                if *left > 0 {
                    return false;
                }
            }
            _ => return false,
        }
        state.trap = None;
        state.sprung = Some(self.host);
        state.fired(match at {
            Trap::Before => "died before a write",
            Trap::After => "died after a write",
        });
        true
    }
}

impl Queue for Log {
    async fn load(&mut self) -> Result<Contents, QueueError> {
        Ok(self.shared.lock().disk.contents.clone())
    }

    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        let records = batch.records.to_vec();
        self.write(|state| {
            for note in batch.notes {
                state.trace.update(&note.bytes);
            }
            state.disk.notes.retain(|note| !batch.forgotten.contains(&note.subject));
            state.disk.notes.extend_from_slice(batch.notes);
            for (_, fact) in records.iter().filter_map(|record| Fact::decode(record).ok()) {
                let wrong = state.leases.judge(&fact);
                state.wrong.extend(wrong);
            }
            state.disk.contents.records.extend_from_slice(&records);
            state.disk.longest = state.disk.longest.max(state.disk.contents.records.len());
            for record in &records {
                state.trace.update(record);
            }
            state.disk.history.extend(records);
        })
        .await
    }

    async fn notes(&mut self, subject: u64, _from: u64) -> Result<Page, QueueError> {
        let state = self.shared.lock();
        let of_subject = state.disk.notes.iter().filter(|note| note.subject == subject);
        Ok(Page { notes: of_subject.map(|note| note.bytes.clone()).collect(), next: None })
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        let fresh = Contents { snapshot: Some(state.to_vec()), ..Contents::default() };
        self.write(|state| {
            state.disk.contents = fresh;
            state.disk.snapshots += 1;
        })
        .await
    }
}
