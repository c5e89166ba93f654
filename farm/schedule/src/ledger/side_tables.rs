//! Tables of the ledger beside its jobs: drained workers, logs, builds, usage by owner.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use femc_model::{AttemptOutcome, Digest, Drain, JobId, LogRecord, LogText, Month, OwnerUsage, UsageSums};
use serde::{Deserialize, Serialize};

use crate::UsedTime;

/// The ledger's tables beside its jobs.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct SideTables {
    /// Processes of workers that an operator has drained, the latest at the end.
    drained: Vec<u64>,
    /// Stored logs of attempts, oldest first.
    logs: BTreeMap<JobId, VecDeque<LogRecord>>,
    /// Frames in progress with results that count, and the build of the engine that made these.
    builds: BTreeMap<JobId, BTreeMap<u32, String>>,
    /// Used time by owner.
    used_times: BTreeMap<String, UsedTime>,
    /// Usage by month and owner.
    #[serde(deserialize_with = "femc_model::since_version_11")]
    usage: BTreeMap<(Month, String), UsageSums>,
}

impl SideTables {
    /// Maximum number of drained workers in the table. It is limited because processes end without notice that they will not come
    /// back.
    const MAX_DRAINED: usize = 4096;

    /// Maximum number of logs of a job.
    const MAX_LOGS: usize = 512;

    /// Number of a job's first failures whose logs are always kept: they often show the cause of later failures.
    const FIRST_FAILURES: usize = 64;

    /// Maximum number of owners without a job whose used time is kept.
    const MAX_ABSENT: usize = 4096;

    /// Maximum number of rows of usage: with 100 owners, 54 years.
    const MAX_USAGE_ROWS: usize = 1 << 16;

    /// Stores the used time of these owners. If too many owners have no job, removes those with the lowest virtual time.
    /// - `present`: returns the owners with jobs.
    pub(super) fn set_used_times<'a>(
        &mut self,
        owners: &[(String, UsedTime)],
        present: impl Fn() -> BTreeSet<&'a str>,
    ) {
        self.used_times.extend(owners.iter().cloned());
        if self.used_times.len() <= Self::MAX_ABSENT {
            return;
        }
        let present = present();
        let absent = self.used_times.iter().filter(|(owner, _)| !present.contains(owner.as_str()));
        let mut absent: Vec<(UsedTime, String)> = absent.map(|(owner, used)| (*used, owner.clone())).collect();
        absent.sort_unstable_by_key(|(used, _)| std::cmp::Reverse(used.virtual_time));
        for (_, owner) in absent.split_off(absent.len().min(Self::MAX_ABSENT)) {
            self.used_times.remove(&owner);
        }
    }

    /// Returns the durable used time by owner.
    pub(crate) fn used_times(&self) -> &BTreeMap<String, UsedTime> {
        &self.used_times
    }

    /// Replaces the usage of these owners and months. Beyond the limit, the earliest months are removed.
    pub(super) fn set_usage(&mut self, usage: &[OwnerUsage]) {
        self.usage.extend(usage.iter().map(|row| ((row.month, row.owner.clone()), row.sums)));
        while self.usage.len() > Self::MAX_USAGE_ROWS {
            self.usage.pop_first();
        }
    }

    /// Returns the durable usage of an owner in a month.
    pub(crate) fn usage_of(&self, month: Month, owner: &str) -> UsageSums {
        self.usage.get(&(month, owner.to_owned())).copied().unwrap_or_default()
    }

    /// Returns the durable usage by month and owner.
    pub(crate) fn usage_rows(&self) -> impl Iterator<Item = OwnerUsage> + '_ {
        self.usage.iter().map(|((month, owner), sums)| OwnerUsage { month: *month, owner: owner.clone(), sums: *sums })
    }

    pub(super) fn set_build(&mut self, job: JobId, frame: u32, engine: &str) {
        self.builds.entry(job).or_default().insert(frame, engine.to_owned());
    }

    /// Removes the build of a frame that is finished or restarts.
    pub(super) fn remove_build(&mut self, job: JobId, frame: u32) {
        let Some(frames) = self.builds.get_mut(&job) else { return };
        frames.remove(&frame);
        if frames.is_empty() {
            self.builds.remove(&job);
        }
    }

    /// Returns the build that made a frame's results, if there are any.
    pub(crate) fn build_of(&self, job: JobId, frame: u32) -> Option<&str> {
        self.builds.get(&job)?.get(&frame).map(String::as_str)
    }

    /// Returns the frames of a job that have a build.
    pub(crate) fn builds_of(&self, job: JobId) -> impl Iterator<Item = (u32, &str)> + '_ {
        self.builds.get(&job).into_iter().flatten().map(|(&frame, build)| (frame, build.as_str()))
    }

    /// Stores a log. Returns artifacts that are no longer referenced. Beyond the limit, logs of successful attempts are removed
    /// first. Of the failures, the first ones and the latest ones are kept.
    pub(super) fn add_log(&mut self, record: &LogRecord) -> Vec<Digest> {
        let logs = self.logs.entry(record.task.job).or_default();
        logs.push_back(record.clone());
        if logs.len() <= Self::MAX_LOGS {
            return Vec::new();
        }
        let done = logs.iter().position(|record| record.log.outcome == AttemptOutcome::Done);
        let oldest = done.unwrap_or(Self::FIRST_FAILURES);
        logs.remove(oldest).iter().filter_map(stored_digest).collect()
    }

    /// Removes everything about a job.
    pub(super) fn remove_job(&mut self, job: JobId) {
        self.logs.remove(&job);
        self.builds.remove(&job);
    }

    pub(crate) fn logs(&self, job: JobId) -> impl Iterator<Item = &LogRecord> + '_ {
        self.logs.get(&job).into_iter().flatten()
    }

    pub(super) fn for_each_artifact(&self, visit: impl FnMut(Digest)) {
        self.logs.values().flatten().filter_map(stored_digest).for_each(visit);
    }

    pub(super) fn set_drain(&mut self, instance: u64, drain: Drain) {
        self.drained.retain(|&other| other != instance);
        if drain == Drain::Begin {
            self.drained.push(instance);
            let surplus = self.drained.len().saturating_sub(Self::MAX_DRAINED);
            self.drained.drain(..surplus);
        }
    }

    pub(crate) fn is_drained(&self, instance: u64) -> bool {
        self.drained.contains(&instance)
    }
}

fn stored_digest(record: &LogRecord) -> Option<Digest> {
    match &record.log.text {
        LogText::Stored(artifact) => Some(artifact.digest),
        LogText::Inline(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use crate::{Fact, Ledger};

    use super::*;

    #[test]
    fn snapshot_has_side_tables_and_a_truncated_one_is_refused() {
        let mut ledger = Ledger::default();
        ledger.apply(&Fact::Drained { instance: 5, drain: Drain::Begin }, femc_model::Tick(4));
        let new = ledger.encode().unwrap();
        assert_eq!(Ledger::decode(&new), Ok(ledger.clone()));
        assert!(ledger.side.is_drained(5) && !ledger.side.is_drained(6));
        for end in 0..new.len() {
            assert!(Ledger::decode(&new[..end]).is_err(), "cut at {end}");
        }
        ledger.apply(&Fact::Drained { instance: 5, drain: Drain::Undo }, femc_model::Tick(5));
        assert!(!ledger.side.is_drained(5));
    }

    #[test]
    fn owners_without_jobs_are_remembered_by_most_usage() {
        let mut side = SideTables::default();
        let owner = |number: usize| (number.to_string(), UsedTime { charged: 1, virtual_time: number as u64 });
        let names: Vec<String> = (0..10).map(|number: usize| number.to_string()).collect();
        for number in 0..SideTables::MAX_ABSENT + 20 {
            side.set_used_times(&[owner(number)], || names.iter().map(String::as_str).collect());
        }
        assert_eq!(side.used_times().len(), 10 + SideTables::MAX_ABSENT);
        assert!(
            !side.used_times().contains_key("10")
                && !side.used_times().contains_key("19")
                && side.used_times().contains_key("20")
        );
    }
}
