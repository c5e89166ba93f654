//! The log's disk. It survives crashes and admits one writer.

use std::future::pending;
use std::io;
use std::time::Duration;

use femc_model::{Artifact, Epoch, TaskKey, TaskResult};
use femc_queue::{Batch, Contents, Note, Page, Queue, QueueError};
use femc_schedule::{Evidence, Fact, Ledger, SnapshotError};

use crate::audit::{Violation, settled};
use crate::contents::fact_name;
use crate::promises::Answers;
use crate::shared::{Shared, State, Trap};

/// Longest time that the disk takes before and after a write.
const SEEK: Duration = Duration::from_millis(6);

/// Tells whether a write was ever torn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Tail {
    #[default]
    Whole,
    Torn,
}

/// Contents of the log's disk.
#[derive(Debug, Default)]
pub(crate) struct Disk {
    pub(crate) contents: Contents,
    /// All records ever written, also those that snapshots have replaced.
    pub(crate) history: Vec<Vec<u8>>,
    /// Notes beside the log, oldest first.
    pub(crate) notes: Vec<Note>,
    tail: Tail,
    /// Greatest number that a writer has reserved, kept beside the log.
    reserved: u32,
    /// Number of earlier logs.
    pub(crate) logs: u32,
    /// Host that took the lead last from another host, and the time of that.
    moved: (usize, Duration),
    /// Epoch of the coordinator that may write.
    epoch: i64,
    /// Number of writes that will fail for lack of space.
    pub(crate) full: u32,
    pub(crate) snapshots: u32,
    /// Most records beside a snapshot at any time.
    pub(crate) longest: usize,
}

impl Disk {
    pub(crate) fn tail(&self) -> Tail {
        self.tail
    }

    /// Checks whether a deposed leader may still answer requests.
    pub(crate) fn has_ghosts(&self) -> bool {
        /// Longer than a deposed leader continues.
        const HAUNTS: Duration = Duration::from_secs(12);
        let now = turmoil::sim_elapsed().unwrap_or_default();
        self.moved.1 > Duration::ZERO && now.saturating_sub(self.moved.1) < HAUNTS
    }

    fn keep(&mut self, Batch { notes, forgotten, .. }: &Batch<'_>) {
        self.notes.retain(|note| !forgotten.contains(&note.subject));
        self.notes.extend_from_slice(notes);
    }

    /// Returns the ledger that a coordinator would load now.
    pub(crate) fn ledger(&self) -> Result<Ledger, SnapshotError> {
        let mut ledger = self.contents.snapshot.as_deref().map(Ledger::decode).transpose()?.unwrap_or_default();
        for record in &self.contents.records {
            let (now, fact) = Fact::decode(record)?;
            ledger.apply(&fact, now);
        }
        Ok(ledger)
    }

    /// Checks a snapshot before it replaces the previous one and the records since then.
    fn judge(&self, snapshot: &[u8]) -> Option<Violation> {
        let compared = Ledger::decode(snapshot).and_then(|ledger| Ok(ledger == self.ledger()?));
        let records = self.contents.records.len();
        match compared {
            Ok(is_same) => (!is_same).then_some(Violation::SnapshotDiffers { records }),
            Err(error) => Some(error.into()),
        }
    }
}

impl State {
    /// Checks that a counted result states the real sizes of its artifacts.
    fn other_size(&self, task: TaskKey, epoch: Epoch, result: &TaskResult) -> Option<Violation> {
        let size = |stated: Artifact| Some((stated, *self.sizes.get(&stated.digest)?));
        let (stated, bytes) = result.artifacts().filter_map(size).find(|(stated, bytes)| stated.bytes != *bytes)?;
        Some(Violation::Size { task, epoch, stated, bytes })
    }

    /// Loses the log: reports its violations and begins an empty log. The right to write does not change.
    pub(crate) fn lose_log(&mut self) {
        let wrong = settled(self);
        self.wrong.extend(wrong);
        let Disk { reserved, moved, epoch, logs, snapshots, longest, .. } = std::mem::take(&mut self.disk);
        self.disk = Disk { reserved, moved, epoch, logs: logs + 1, snapshots, longest, ..Disk::default() };
        self.leases.anew();
        self.chronicle.anew();
        self.shares.anew();
        self.queues.anew();
        self.answers = Answers::default();
        self.accepted.clear();
        self.reported.clear();
        self.robbed.clear();
    }
}

/// Records of the log after which a coordinator makes a snapshot.
pub(crate) const SNAPSHOT: usize = 25;

/// The log, opened by one coordinator.
#[derive(Debug)]
pub(crate) struct Log {
    shared: Shared,
    host: usize,
    epoch: i64,
}

impl Log {
    /// Takes the lead. The previous leader may not write any more.
    pub(crate) fn lead(shared: &Shared, host: usize) -> Self {
        let mut state = shared.lock();
        state.disk.epoch += 1;
        if state.disk.moved.0 != host {
            state.disk.moved = (host, turmoil::sim_elapsed().unwrap_or_default());
        }
        Self { shared: shared.clone(), host, epoch: state.disk.epoch }
    }

    /// Writes, unless another coordinator leads, the disk is full, or the process is killed.
    async fn write(&self, write: impl FnOnce(&mut State) -> Written) -> Result<(), QueueError> {
        tokio::time::sleep(self.shared.pause(SEEK)).await;
        let written = {
            let mut state = self.shared.lock();
            if self.falls(&mut state, Trap::Before) {
                Written::Torn
            } else {
                self.admitted(&mut state)?;
                let written = write(&mut state);
                if self.falls(&mut state, Trap::After) { Written::Torn } else { written }
            }
        };
        if written == Written::Torn {
            pending::<()>().await;
        }
        tokio::time::sleep(self.shared.pause(SEEK)).await;
        Ok(())
    }

    /// Checks that the coordinator leads and that the disk has space.
    fn admitted(&self, state: &mut State) -> Result<(), QueueError> {
        if state.disk.epoch != self.epoch {
            state.fired("stale leader refused");
            return Err(QueueError::Deposed { epoch: self.epoch });
        }
        if state.disk.full > 0 {
            state.disk.full -= 1;
            state.fired("log full");
            return Err(io::Error::from(io::ErrorKind::StorageFull).into());
        }
        Ok(())
    }

    /// Checks whether the process is killed at this point.
    fn falls(&self, state: &mut State, at: Trap) -> bool {
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
            Trap::Within => "torn write",
            Trap::After => "died after a write",
        });
        true
    }
}

/// Tells whether a write was completed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Written {
    Whole,
    /// The process is killed.
    Torn,
}

impl Queue for Log {
    /// Reports torn records once, and drops them.
    async fn load(&mut self) -> Result<Contents, QueueError> {
        let contents = &mut self.shared.lock().disk.contents;
        let loaded = contents.clone();
        contents.torn = 0;
        Ok(loaded)
    }

    /// If a batch is torn, its notes are kept when at least one of its records is.
    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        let mut records = batch.records.to_vec();
        self.write(|state| {
            let written = if self.falls(state, Trap::Within) { Written::Torn } else { Written::Whole };
            if written == Written::Torn {
                let torn = records.split_off(records.len() / 2);
                state.disk.contents.torn = torn.len() as u64;
                state.disk.tail = Tail::Torn;
            }
            if written == Written::Whole || !records.is_empty() {
                state.disk.keep(&batch);
            }
            let now = turmoil::sim_elapsed().unwrap_or_default();
            for (tick, fact) in records.iter().filter_map(|record| Fact::decode(record).ok()) {
                let leased = state.leases.judge(&fact);
                let said = state.chronicle.take(tick, &fact, now, &state.answers.controls);
                state.wrong.extend(leased.into_iter().chain(said));
                fact_name(&fact).into_iter().for_each(|name| state.did(name));
                state.queues.note_record(&fact, now);
                state.shares.divide(&state.chronicle.payers_of_shared(), now);
                match &fact {
                    Fact::Used { owners } => {
                        let charged = state.shares.judge(owners, now);
                        state.wrong.extend(charged);
                    }
                    Fact::Done { task, epoch, result, .. } => {
                        let other = state.other_size(*task, *epoch, result);
                        state.wrong.extend(other);
                    }
                    Fact::Died { task, casualty, .. } if casualty.evidence == Evidence::Journal => {
                        let instance = casualty.instance;
                        let lives = state.lives.values().any(|&other| other == instance);
                        state.wrong.extend(lives.then_some(Violation::Alive { instance, task: *task }));
                    }
                    _ => {}
                }
            }
            state.disk.contents.records.extend_from_slice(&records);
            state.disk.longest = state.disk.longest.max(state.disk.contents.records.len());
            for record in &records {
                state.trace.update(record);
            }
            state.disk.history.extend(records);
            written
        })
        .await
    }

    /// The number is kept beside the log and survives its loss.
    async fn reserve(&mut self, least: u32) -> Result<u32, QueueError> {
        let disk = &mut self.shared.lock().disk;
        disk.reserved = least.max(disk.reserved + 1);
        Ok(disk.reserved)
    }

    async fn notes(&mut self, subject: u64, _from: u64) -> Result<Page, QueueError> {
        let state = self.shared.lock();
        let of_subject = state.disk.notes.iter().filter(|note| note.subject == subject);
        Ok(Page { notes: of_subject.map(|note| note.bytes.clone()).collect(), next: None })
    }

    async fn snapshot(&mut self, snapshot: &[u8]) -> Result<(), QueueError> {
        let fresh = Contents { snapshot: Some(snapshot.to_vec()), ..Contents::default() };
        self.write(|state| {
            let wrong = state.disk.judge(snapshot);
            state.wrong.extend(wrong);
            let records = state.disk.contents.records.len();
            if records < SNAPSHOT {
                state.wrong.push(Violation::Snapshot { records });
            }
            state.disk.contents = fresh;
            state.disk.snapshots += 1;
            Written::Whole
        })
        .await
    }
}
