//! Repeated reading of the log during the run.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use femc_model::{Epoch, TaskKey};
use femc_queue::LogContents;
use femc_schedule::Fact;
use serde::Serialize;

use crate::farm::Farm;

/// Interval between two copies.
const POLL_INTERVAL: Duration = Duration::from_secs(2);
/// Summary of the log so far.
#[derive(Debug, Default, Serialize)]
pub struct LogSummary {
    /// Number of copies that were read.
    pub copies: u64,
    /// Number of times that a new snapshot had replaced the records.
    pub snapshots: u64,
    /// Number of distinct results that count.
    pub effects: u64,
    /// Largest number of records in a copy.
    pub longest: usize,
    /// Tasks that count twice, although nothing was lost in between.
    pub twice: Vec<String>,
    #[serde(skip)]
    counted: BTreeMap<TaskKey, Epoch>,
    #[serde(skip)]
    snapshot: Option<Vec<u8>>,
    /// Number of records after the snapshot that have been processed.
    #[serde(skip)]
    processed: usize,
}

impl LogSummary {
    /// Reads the log repeatedly until `is_over`.
    pub fn observe(farm: &Farm, is_over: &AtomicBool) -> Self {
        let mut summary = Self::default();
        while !is_over.load(Ordering::SeqCst) {
            summary.read(farm);
            std::thread::sleep(POLL_INTERVAL);
        }
        summary
    }

    /// Kills the coordinators and reads the final log.
    pub fn end(mut self, farm: &Farm) -> Self {
        for coordinator in &farm.coordinators {
            coordinator.kill();
        }
        self.read(farm);
        self
    }

    fn read(&mut self, farm: &Farm) {
        farm.log().into_iter().for_each(|contents| self.process(contents));
    }

    fn process(&mut self, LogContents { snapshot, records, .. }: LogContents) {
        self.copies += 1;
        self.longest = self.longest.max(records.len());
        if self.snapshot != snapshot {
            self.snapshots += 1;
            (self.snapshot, self.processed) = (snapshot, 0);
        }
        for record in records.iter().skip(self.processed) {
            match Fact::decode(record).expect("a fact").1 {
                Fact::Done { task, epoch, .. } => self.count(task, epoch),
                Fact::OutputsLost { task } => drop(self.counted.remove(&task)),
                Fact::Restarted { job, frame } => {
                    self.counted.retain(|task, _| (task.job, task.stage.frame) != (job, frame));
                }
                _ => {}
            }
        }
        self.processed = records.len();
    }

    fn count(&mut self, task: TaskKey, epoch: Epoch) {
        self.effects += 1;
        if let Some(before) = self.counted.insert(task, epoch) {
            self.twice.push(format!("{task}: {} and {}", before.0, epoch.0));
        }
    }
}
