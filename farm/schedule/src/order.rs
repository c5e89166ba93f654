//! The order of service: jobs of higher priority first; among equals the owner who has used the least time for his weight;
//! an owner's own jobs by age.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use femc_model::JobId;

/// Time used, in milliseconds for a weight of [`Order::UNIT`].
type Used = u64;

/// Jobs whose tasks may be leased, and what their owners have used. Forgotten at a restart: then all owners are even.
#[derive(Debug, Clone, Default)]
pub(crate) struct Order {
    classes: BTreeMap<Reverse<u8>, BTreeMap<String, BTreeSet<JobId>>>,
    places: BTreeMap<JobId, (u8, String)>,
    used: BTreeMap<String, Used>,
}

impl Order {
    /// Weights are whole numbers; time is kept this much finer.
    const UNIT: u64 = 1000;

    /// Puts a job at its place. An owner who had nothing to do starts level with the one who has used least: absence saves
    /// nothing up, and nobody is shut out for having come first.
    pub(crate) fn insert(&mut self, job: JobId, priority: u8, owner: &str) {
        if self.places.get(&job).is_some_and(|(p, o)| *p == priority && o == owner) {
            return;
        }
        let is_new = !self.places.values().any(|(_, known)| known == owner);
        self.remove(job);
        if is_new {
            let least = self.places.values().map(|(_, known)| self.used(known)).min().unwrap_or(0);
            let used = self.used.entry(owner.to_owned()).or_default();
            *used = (*used).max(least);
        }
        self.classes.entry(Reverse(priority)).or_default().entry(owner.to_owned()).or_default().insert(job);
        self.places.insert(job, (priority, owner.to_owned()));
    }

    /// Takes a job out.
    pub(crate) fn remove(&mut self, job: JobId) {
        let Some((priority, owner)) = self.places.remove(&job) else { return };
        if let Some(class) = self.classes.get_mut(&Reverse(priority)) {
            if let Some(jobs) = class.get_mut(&owner) {
                jobs.remove(&job);
                if jobs.is_empty() {
                    class.remove(&owner);
                }
            }
            if class.is_empty() {
                self.classes.remove(&Reverse(priority));
            }
        }
    }

    /// All jobs, in order of submission.
    pub(crate) fn jobs(&self) -> impl Iterator<Item = JobId> + '_ {
        self.places.keys().copied()
    }

    /// The jobs as they are served now.
    pub(crate) fn service(&self) -> impl Iterator<Item = JobId> + '_ {
        self.classes.values().flat_map(|class| {
            let mut owners: Vec<_> = class.iter().collect();
            owners.sort_by_key(|&(owner, _)| self.used(owner));
            owners.into_iter().flat_map(|(_, jobs)| jobs.iter().copied())
        })
    }

    /// Time that an owner has used, for his weight.
    fn used(&self, owner: &str) -> Used {
        self.used.get(owner).copied().unwrap_or(0)
    }

    /// An owner of `weight` is given `milliseconds` of a worker.
    pub(crate) fn charge(&mut self, owner: &str, milliseconds: u64, weight: u32) {
        let used = self.used.entry(owner.to_owned()).or_default();
        *used = used.saturating_add(milliseconds.saturating_mul(Self::UNIT) / u64::from(weight.max(1)));
    }

    /// Takes back a charge made too high.
    pub(crate) fn refund(&mut self, owner: &str, milliseconds: u64, weight: u32) {
        let used = self.used.entry(owner.to_owned()).or_default();
        *used = used.saturating_sub(milliseconds.saturating_mul(Self::UNIT) / u64::from(weight.max(1)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn served(order: &Order) -> Vec<u64> {
        order.service().map(|job| job.0).collect()
    }

    #[test]
    fn priority_first_then_the_owner_who_used_least_then_age() {
        let mut order = Order::default();
        for (job, priority, owner) in [(1, 50, "ann"), (2, 50, "ann"), (3, 50, "bob"), (4, 60, "ann")] {
            order.insert(JobId(job), priority, owner);
        }
        assert_eq!(served(&order), [4, 1, 2, 3]);
        order.charge("ann", 1000, 1);
        assert_eq!(served(&order), [4, 3, 1, 2]);
        order.charge("bob", 3000, 4);
        assert_eq!(served(&order), [4, 3, 1, 2], "a weight of four makes 3 s count as 0.75 s");
        order.refund("ann", 900, 1);
        assert_eq!(served(&order), [4, 1, 2, 3]);
        order.insert(JobId(3), 90, "bob");
        assert_eq!(served(&order), [3, 4, 1, 2]);
        [1, 2, 3, 4].into_iter().for_each(|job| order.remove(JobId(job)));
        assert!(served(&order).is_empty() && order.classes.is_empty());
    }

    #[test]
    fn absence_saves_nothing_up() {
        let mut order = Order::default();
        order.insert(JobId(1), 50, "ann");
        order.charge("ann", 3_600_000, 1);
        order.insert(JobId(2), 50, "bob");
        assert_eq!(order.used("bob"), order.used("ann"), "bob is level, not an hour ahead");
        order.charge("bob", 10, 1);
        assert_eq!(served(&order), [1, 2]);
    }
}
