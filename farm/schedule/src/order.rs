//! The order of service. Jobs of higher priority come first. Among jobs of equal priority, the owner who has used the least time in
//! relation to his weight comes first. The jobs of one owner are served by age.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use femc_model::JobId;

use crate::UsedTime;

/// Account of an owner.
#[derive(Debug, Clone, Copy, Default)]
struct Account {
    used: UsedTime,
    /// Remaining expected milliseconds of his running leases.
    claimed: u64,
    /// Weight in the latest claim or charge.
    weight: u32,
}

impl Account {
    /// Units of virtual time per millisecond, because weights are whole numbers.
    const VIRTUAL_PER_MS: u64 = 1000;

    /// Returns the owner's virtual time, including his claims.
    fn virtual_time(&self) -> u64 {
        self.used.virtual_time.saturating_add(self.virtual_duration(self.claimed))
    }

    fn virtual_duration(&self, milliseconds: u64) -> u64 {
        milliseconds.saturating_mul(Self::VIRTUAL_PER_MS) / u64::from(self.weight.max(1))
    }

    fn release_claim(&mut self, milliseconds: u64) {
        self.claimed = self.claimed.saturating_sub(milliseconds);
    }
}

/// Jobs whose tasks may be leased, and the used time of their owners.
#[derive(Debug, Clone, Default)]
pub(crate) struct ServiceOrder {
    classes: BTreeMap<Reverse<u8>, BTreeMap<String, BTreeSet<JobId>>>,
    entries: BTreeMap<JobId, (u8, String)>,
    accounts: BTreeMap<String, Account>,
    /// Whether an owner was raised to the level of the others, and that is not durable yet.
    was_leveled: bool,
}

impl ServiceOrder {
    /// Creates an order without jobs, with the time used before.
    pub(crate) fn new(used: &BTreeMap<String, UsedTime>) -> Self {
        let account = |used: &UsedTime| Account { used: *used, ..Account::default() };
        let accounts = used.iter().map(|(owner, used)| (owner.clone(), account(used))).collect();
        Self { accounts, ..Self::default() }
    }

    /// Inserts a job. An owner without jobs is raised to the level of the present owner who has used the least, or, if there is no
    /// present owner, of the owner who has used the most so far. So an absent owner saves up no time, and an owner who came first
    /// is not blocked until a new owner has used as much.
    pub(crate) fn insert(&mut self, job: JobId, priority: u8, owner: &str) {
        if self.entries.get(&job).is_some_and(|(p, o)| *p == priority && o == owner) {
            return;
        }
        if !self.entries.values().any(|(_, known)| known == owner) {
            let used = |owner: &str| self.accounts.get(owner).map_or(0, |known| known.used.virtual_time);
            let present = self.entries.values().map(|(_, known)| used(known)).min();
            let level = present.or_else(|| self.accounts.values().map(|known| known.used.virtual_time).max());
            if let Some(level) = level.filter(|level| used(owner) < *level) {
                self.update_account(owner, |account| account.used.virtual_time = level);
                self.was_leveled = true;
            }
        }
        self.insert_unleveled(job, priority, owner);
    }

    /// Inserts a job without raising its owner, as after a restart.
    pub(crate) fn insert_unleveled(&mut self, job: JobId, priority: u8, owner: &str) {
        self.remove(job);
        self.classes.entry(Reverse(priority)).or_default().entry(owner.to_owned()).or_default().insert(job);
        self.entries.insert(job, (priority, owner.to_owned()));
    }

    /// Removes a job.
    pub(crate) fn remove(&mut self, job: JobId) {
        let Some((priority, owner)) = self.entries.remove(&job) else { return };
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

    /// Returns all jobs, in order of submission.
    pub(crate) fn jobs(&self) -> impl Iterator<Item = JobId> + '_ {
        self.entries.keys().copied()
    }

    /// Returns the jobs in their present order of service.
    pub(crate) fn jobs_by_service(&self) -> impl Iterator<Item = JobId> + '_ {
        self.classes.values().flat_map(|class| {
            // A single owner needs no sorting.
            let only = if class.len() == 1 { class.values().next() } else { None };
            let mut owners: Vec<_> = class.iter().filter(|_| only.is_none()).collect();
            owners.sort_by_cached_key(|&(owner, _)| self.virtual_time(owner));
            only.into_iter().chain(owners.into_iter().map(|(_, jobs)| jobs)).flatten().copied()
        })
    }

    fn virtual_time(&self, owner: &str) -> u64 {
        self.accounts.get(owner).map_or(0, Account::virtual_time)
    }

    fn update_account(&mut self, owner: &str, change: impl FnOnce(&mut Account)) {
        if let Some(account) = self.accounts.get_mut(owner) {
            return change(account);
        }
        let mut account = Account::default();
        change(&mut account);
        self.accounts.insert(owner.to_owned(), account);
    }

    /// Adds a lease's expected milliseconds to the claims of an owner with this weight.
    pub(crate) fn claim(&mut self, owner: &str, milliseconds: u64, weight: u32) {
        self.update_account(owner, |account| {
            account.weight = weight;
            account.claimed = account.claimed.saturating_add(milliseconds);
        });
    }

    /// Subtracts the remaining expected milliseconds of an ended lease from the claims of its owner.
    pub(crate) fn release_claim(&mut self, owner: &str, milliseconds: u64) {
        self.update_account(owner, |account| account.release_claim(milliseconds));
    }

    /// Charges an owner with this weight for milliseconds of a worker, some of which were claimed.
    pub(crate) fn charge(&mut self, owner: &str, milliseconds: u64, claimed: u64, weight: u32) {
        self.update_account(owner, |account| {
            account.release_claim(claimed);
            account.weight = weight;
            account.used.charged = account.used.charged.saturating_add(milliseconds);
            account.used.virtual_time =
                account.used.virtual_time.saturating_add(account.virtual_duration(milliseconds));
        });
    }

    /// Returns the used time of owners, in the order of their names.
    pub(crate) fn used_times(&self) -> impl Iterator<Item = (&str, UsedTime)> {
        self.accounts.iter().map(|(owner, account)| (owner.as_str(), account.used))
    }

    /// Removes owners without jobs and claims, except those for whom `is_kept` holds.
    pub(crate) fn remove_absent(&mut self, is_kept: impl Fn(&str) -> bool) {
        let present: BTreeSet<&str> = self.entries.values().map(|(_, owner)| owner.as_str()).collect();
        self.accounts
            .retain(|owner, account| account.claimed > 0 || present.contains(owner.as_str()) || is_kept(owner));
    }

    /// Returns whether an owner was raised to the level of the others since the last call.
    pub(crate) fn take_leveled(&mut self) -> bool {
        std::mem::take(&mut self.was_leveled)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn served(order: &ServiceOrder) -> Vec<u64> {
        order.jobs_by_service().map(|job| job.0).collect()
    }

    #[test]
    fn priority_first_then_the_owner_who_used_least_then_age() {
        let mut order = ServiceOrder::default();
        for (job, priority, owner) in [(1, 50, "ann"), (2, 50, "ann"), (3, 50, "bob"), (4, 60, "ann")] {
            order.insert(JobId(job), priority, owner);
        }
        assert_eq!(served(&order), [4, 1, 2, 3]);
        order.claim("ann", 1000, 1);
        assert_eq!(served(&order), [4, 3, 1, 2]);
        order.claim("bob", 3000, 4);
        assert_eq!(served(&order), [4, 3, 1, 2], "a weight of four makes 3 s count as 0.75 s");
        order.charge("ann", 100, 100, 1);
        assert_eq!(served(&order), [4, 3, 1, 2], "what is charged of a claim counts once");
        order.release_claim("ann", 900);
        assert_eq!(served(&order), [4, 1, 2, 3]);
        order.insert(JobId(3), 90, "bob");
        assert_eq!(served(&order), [3, 4, 1, 2]);
        let used: Vec<_> = order.used_times().map(|(owner, used)| (owner, used.charged)).collect();
        assert_eq!(used, [("ann", 100), ("bob", 0)]);
        [1, 2, 3, 4].into_iter().for_each(|job| order.remove(JobId(job)));
        assert!(served(&order).is_empty() && order.classes.is_empty());
    }

    #[test]
    fn absence_saves_nothing_up() {
        let mut order = ServiceOrder::default();
        order.insert(JobId(1), 50, "ann");
        order.charge("ann", 3_600_000, 0, 1);
        order.insert(JobId(2), 50, "bob");
        assert_eq!(order.virtual_time("bob"), order.virtual_time("ann"), "bob is level, not an hour ahead");
        order.charge("bob", 10, 0, 1);
        assert_eq!(served(&order), [1, 2]);
    }

    #[test]
    fn owner_new_to_an_idle_farm_is_level_with_earlier_owners() {
        let mut order = ServiceOrder::default();
        order.insert(JobId(1), 50, "ann");
        order.charge("ann", 3_600_000, 0, 1);
        order.remove(JobId(1));
        order.insert(JobId(2), 50, "bob");
        order.insert(JobId(3), 50, "ann");
        assert_eq!(order.virtual_time("bob"), order.virtual_time("ann"), "bob would go first for an hour");
    }
}
