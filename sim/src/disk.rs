//! The log's disk. It survives crashes and admits one writer.

use std::future::pending;
use std::io;
use std::time::Duration;

use femc_model::{Artifact, Epoch, TaskKey, TaskResult};
use femc_queue::{Batch, LogContents, Note, NotePage, Queue, QueueError};
use femc_schedule::{DeathEvidence, Fact, Ledger, SnapshotError};

use crate::audit::{Violation, check_log};
use crate::requests::RequestHistory;
use crate::shared::{CrashPoint, Shared, State};
use crate::shared_stages::shared_fact_name;

/// Longest time that the disk takes before and after a write.
const MAX_SEEK: Duration = Duration::from_millis(6);

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
    pub(crate) contents: LogContents,
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
    last_takeover: (usize, Duration),
    /// Epoch of the coordinator that may write.
    epoch: i64,
    /// Number of writes that will fail for lack of space.
    pub(crate) failing_writes: u32,
    pub(crate) snapshots: u32,
    /// Most records beside a snapshot at any time.
    pub(crate) max_records: usize,
}

impl Disk {
    pub(crate) fn tail(&self) -> Tail {
        self.tail
    }

    /// Checks whether a deposed leader may still answer requests.
    pub(crate) fn may_have_deposed_leader(&self) -> bool {
        /// Longer than a deposed leader continues.
        const MAX_DEPOSED_TIME: Duration = Duration::from_secs(12);
        let now = turmoil::sim_elapsed().unwrap_or_default();
        self.last_takeover.1 > Duration::ZERO && now.saturating_sub(self.last_takeover.1) < MAX_DEPOSED_TIME
    }

    fn store_notes(&mut self, Batch { notes, forgotten, .. }: &Batch<'_>) {
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
    fn check_snapshot(&self, snapshot: &[u8]) -> Option<Violation> {
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
    fn check_sizes(&self, task: TaskKey, epoch: Epoch, result: &TaskResult) -> Option<Violation> {
        let size = |stated: Artifact| Some((stated, *self.sizes.get(&stated.digest)?));
        let (stated, bytes) = result.artifacts().filter_map(size).find(|(stated, bytes)| stated.bytes != *bytes)?;
        Some(Violation::WrongSize { task, epoch, stated, bytes })
    }

    /// Loses the log: reports its violations and begins an empty log. The right to write does not change.
    pub(crate) fn lose_log(&mut self) {
        let wrong = check_log(self);
        self.violations.extend(wrong);
        let Disk { reserved, last_takeover: moved, epoch, logs, snapshots, max_records: longest, .. } =
            std::mem::take(&mut self.disk);
        self.disk = Disk {
            reserved,
            last_takeover: moved,
            epoch,
            logs: logs + 1,
            snapshots,
            max_records: longest,
            ..Disk::default()
        };
        self.leases.reset();
        self.history.reset();
        self.charges.reset();
        self.queues.reset();
        self.requests = RequestHistory::default();
        self.accepted.clear();
        self.reported.clear();
        self.damaged_frames.clear();
    }
}

/// Records of the log after which a coordinator makes a snapshot.
pub(crate) const SNAPSHOT_RECORDS: usize = 25;

/// The log, opened by one coordinator.
#[derive(Debug)]
pub(crate) struct Log {
    shared: Shared,
    host: usize,
    epoch: i64,
}

impl Log {
    /// Takes the lead. The previous leader may not write any more.
    pub(crate) fn take_lead(shared: &Shared, host: usize) -> Self {
        let mut state = shared.lock();
        state.disk.epoch += 1;
        if state.disk.last_takeover.0 != host {
            state.disk.last_takeover = (host, turmoil::sim_elapsed().unwrap_or_default());
        }
        Self { shared: shared.clone(), host, epoch: state.disk.epoch }
    }

    /// Writes, unless another coordinator leads, the disk is full, or the process is killed.
    async fn write(&self, write: impl FnOnce(&mut State) -> WriteOutcome) -> Result<(), QueueError> {
        tokio::time::sleep(self.shared.draw_duration(MAX_SEEK)).await;
        let written = {
            let mut state = self.shared.lock();
            if self.crashes_at(&mut state, CrashPoint::Before) {
                WriteOutcome::Torn
            } else {
                self.check_writable(&mut state)?;
                let written = write(&mut state);
                if self.crashes_at(&mut state, CrashPoint::After) { WriteOutcome::Torn } else { written }
            }
        };
        if written == WriteOutcome::Torn {
            pending::<()>().await;
        }
        tokio::time::sleep(self.shared.draw_duration(MAX_SEEK)).await;
        Ok(())
    }

    /// Checks that the coordinator leads and that the disk has space.
    fn check_writable(&self, state: &mut State) -> Result<(), QueueError> {
        if state.disk.epoch != self.epoch {
            state.count_fault("stale leader refused");
            return Err(QueueError::Deposed { epoch: self.epoch });
        }
        if state.disk.failing_writes > 0 {
            state.disk.failing_writes -= 1;
            state.count_fault("log full");
            return Err(io::Error::from(io::ErrorKind::StorageFull).into());
        }
        Ok(())
    }

    /// Checks whether the process is killed at this point.
    fn crashes_at(&self, state: &mut State, at: CrashPoint) -> bool {
        match &mut state.planned_crash {
            Some((left, trap)) if *trap == at => {
                *left = left.saturating_sub(1);
                if *left > 0 {
                    return false;
                }
            }
            _ => return false,
        }
        state.planned_crash = None;
        state.crashed = Some(self.host);
        state.count_fault(match at {
            CrashPoint::Before => "died before a write",
            CrashPoint::Within => "torn write",
            CrashPoint::After => "died after a write",
        });
        true
    }
}

/// Tells whether a write was completed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum WriteOutcome {
    Whole,
    /// The process is killed.
    Torn,
}

impl Queue for Log {
    /// Reports torn records once, and drops them.
    async fn load(&mut self) -> Result<LogContents, QueueError> {
        let contents = &mut self.shared.lock().disk.contents;
        let loaded = contents.clone();
        contents.torn = 0;
        Ok(loaded)
    }

    /// If a batch is torn, its notes are kept when at least one of its records is.
    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        let mut records = batch.records.to_vec();
        self.write(|state| {
            let written =
                if self.crashes_at(state, CrashPoint::Within) { WriteOutcome::Torn } else { WriteOutcome::Whole };
            if written == WriteOutcome::Torn {
                let torn = records.split_off(records.len() / 2);
                state.disk.contents.torn = torn.len() as u64;
                state.disk.tail = Tail::Torn;
            }
            if written == WriteOutcome::Whole || !records.is_empty() {
                state.disk.store_notes(&batch);
            }
            let now = turmoil::sim_elapsed().unwrap_or_default();
            for (tick, fact) in records.iter().filter_map(|record| Fact::decode(record).ok()) {
                let leased = state.leases.check_fact(&fact);
                let recorded = state.history.apply(tick, &fact, now, &state.requests.controls);
                state.violations.extend(leased.into_iter().chain(recorded));
                shared_fact_name(&fact).into_iter().for_each(|name| state.count_action(name));
                state.queues.observe_fact(&fact, now);
                state.charges.divide(&state.history.payers_of_shared(), now);
                match &fact {
                    Fact::TimeCharged { owners } => {
                        let charged = state.charges.check_charges(owners, now);
                        state.violations.extend(charged);
                    }
                    Fact::Done { task, epoch, result, .. } => {
                        let other = state.check_sizes(*task, *epoch, result);
                        state.violations.extend(other);
                    }
                    Fact::WorkerDied { task, death: casualty, .. } if casualty.evidence == DeathEvidence::Journal => {
                        let instance = casualty.instance;
                        let lives = state.processes.values().any(|&other| other == instance);
                        state.violations.extend(lives.then_some(Violation::FalseDeath { instance, task: *task }));
                    }
                    _ => {}
                }
            }
            state.disk.contents.records.extend_from_slice(&records);
            state.disk.max_records = state.disk.max_records.max(state.disk.contents.records.len());
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

    async fn notes(&mut self, subject: u64, _from: u64) -> Result<NotePage, QueueError> {
        let state = self.shared.lock();
        let of_subject = state.disk.notes.iter().filter(|note| note.subject == subject);
        Ok(NotePage { notes: of_subject.map(|note| note.bytes.clone()).collect(), next: None })
    }

    async fn snapshot(&mut self, snapshot: &[u8]) -> Result<(), QueueError> {
        let fresh = LogContents { snapshot: Some(snapshot.to_vec()), ..LogContents::default() };
        self.write(|state| {
            let wrong = state.disk.check_snapshot(snapshot);
            state.violations.extend(wrong);
            let records = state.disk.contents.records.len();
            if records < SNAPSHOT_RECORDS {
                state.violations.push(Violation::EarlySnapshot { records });
            }
            state.disk.contents = fresh;
            state.disk.snapshots += 1;
            WriteOutcome::Whole
        })
        .await
    }
}
