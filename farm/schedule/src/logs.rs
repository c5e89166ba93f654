//! Logs of attempts. Logs in the store are few (those of failures and of images). They are facts and are kept with the job. Logs of
//! successful tiles are many and small. They are sent with the report, and the latest ones are kept only in memory.

use std::collections::{BTreeSet, VecDeque};

use femc_model::{Epoch, JobId, LogRecord, LogText, Refusal, TaskKey, TaskLog, Tick, WorkerId};

use crate::scheduler::Scheduler;
use crate::{Command, Fact};

/// The latest inline logs of all jobs.
#[derive(Debug, Clone, Default)]
pub(crate) struct RecentLogs {
    records: VecDeque<LogRecord>,
    bytes: usize,
}

impl RecentLogs {
    /// Maximum number of bytes of text.
    const MAX_BYTES: usize = 4 << 20;

    fn push(&mut self, record: LogRecord) {
        self.bytes += record_size(&record);
        self.records.push_back(record);
        while self.bytes > Self::MAX_BYTES {
            let Some(oldest) = self.records.pop_front() else { break };
            self.bytes -= record_size(&oldest);
        }
    }
}

/// Returns the approximate size of a record in bytes.
fn record_size(record: &LogRecord) -> usize {
    let text = match &record.log.text {
        LogText::Inline(text) => text.len(),
        LogText::Stored(_) => 0,
    };
    size_of::<LogRecord>() + record.worker.len() + text
}

impl Scheduler {
    /// Stores the log of an attempt whose lease holds.
    pub(crate) fn store_log(
        &mut self,
        worker: WorkerId,
        task: TaskKey,
        epoch: Epoch,
        log: TaskLog,
        now: Tick,
        out: &mut Vec<Command>,
    ) {
        let known =
            self.table.workers.get(&worker).filter(|_| self.table.lease_held_by(worker, &task, epoch).is_some());
        let Some(known) = known else { return };
        let record = LogRecord { task, epoch, worker: known.registration.name.clone(), reported_at: now, log };
        match record.log.text {
            LogText::Inline(_) => self.recent_logs.push(record),
            LogText::Stored(_) => self.record_fact(Fact::Logged(Box::new(record)), now, out),
        }
    }

    /// Returns the logs of attempts at the tasks of a job and of its shared jobs that were reported since this time, oldest first.
    /// If there are too many, returns all stored logs and the latest of the others.
    pub fn logs(&self, job: JobId, since: Tick) -> Result<Vec<LogRecord>, Refusal> {
        /// Maximum number of records in an answer.
        const MAX_RECORDS: usize = 2048;
        let keys = self.job(job)?.spec.contents.iter().map(|(_, key)| key);
        let shared = keys.flat_map(|key| self.ledger.shared_jobs_of(key)).map(|(_, id, _)| id);
        let jobs: BTreeSet<JobId> = shared.chain([job]).collect();
        let is_new = |record: &&LogRecord| record.reported_at >= since;
        let in_memory = self.recent_logs.records.iter().filter(|record| jobs.contains(&record.task.job));
        let in_memory: Vec<&LogRecord> = in_memory.filter(is_new).collect();
        let mut all: Vec<LogRecord> =
            jobs.iter().flat_map(|job| self.ledger.side.logs(*job)).filter(is_new).cloned().collect();
        // Stored logs, which include those of failures, have priority over logs of tiles.
        let room = MAX_RECORDS.saturating_sub(all.len());
        all.extend(in_memory[in_memory.len().saturating_sub(room)..].iter().copied().cloned());
        all.sort_by_key(|record| (record.reported_at, record.epoch));
        all.drain(..all.len().saturating_sub(MAX_RECORDS));
        Ok(all)
    }
}
