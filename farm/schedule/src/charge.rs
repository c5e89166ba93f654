//! Charging owners for the time of workers. Each moment of a worker is charged to the owner of the oldest lease that the worker
//! holds, however that lease ends. So an hour of a worker is charged as one hour, whether the worker holds one lease or seventy. If
//! a worker holds one lease at a time, an owner is charged exactly for the time of his leases.
//!
//! A running lease is a claim of its owner. Its expected duration, less the part already charged, counts in the order of service
//! from its first moment until it ends.
//!
//! Charges become durable every few seconds, whatever happens to the leases. A killed coordinator loses at most that part of each
//! worker's time, and its log does not grow with the number of tasks.

use femc_model::{JobId, Tick, UsageSums, WorkerId};

use crate::lease_table::{Charge, Lease, LeaseKey};
use crate::scheduler::Scheduler;
use crate::{Command, Fact, UsedTime};

impl Scheduler {
    /// Milliseconds between two facts about the usage of owners.
    pub const CHARGE_INTERVAL: u64 = 5_000;

    /// Adds the expected milliseconds of a new lease to the claims of the job's owner.
    pub(crate) fn claim(&mut self, job: JobId, milliseconds: u64) {
        // The time of a shared job is charged to the owners of all jobs that share it, as it is used.
        let Some(job) = self.ledger.jobs.get(&job).filter(|known| known.shared.is_none()) else { return };
        self.order.claim(&job.spec.owner, milliseconds, self.config.weight(&job.spec.owner));
    }

    /// Charges a worker's time until now.
    fn charge_worker(&mut self, worker: WorkerId) {
        let bill = self.table.take_charge(worker, self.now);
        bill.into_iter().for_each(|bill| self.charge(bill));
    }

    fn charge(&mut self, Charge { job, milliseconds, expected }: Charge) {
        let Some(job) = self.ledger.jobs.get(&job).filter(|_| milliseconds > 0) else { return };
        if job.shared.is_some() {
            for (owner, part) in self.split_charge(job, milliseconds) {
                self.meter.add(&owner, UsageSums { worker_ms: part, ..UsageSums::default() });
                self.order.charge(&owner, part, 0, self.config.weight(&owner));
            }
            return;
        }
        self.meter.add(&job.spec.owner, UsageSums { worker_ms: milliseconds, ..UsageSums::default() });
        self.order.charge(&job.spec.owner, milliseconds, expected, self.config.weight(&job.spec.owner));
    }

    /// Ends a lease, for whatever reason.
    pub(crate) fn release_lease(&mut self, key: &LeaseKey) -> Option<Lease> {
        let (lease, bill) = self.table.release(key, &self.config, self.now)?;
        bill.into_iter().for_each(|bill| self.charge(bill));
        if let Some(job) = self.ledger.jobs.get(&key.0.job).filter(|known| known.shared.is_none()) {
            self.order.release_claim(&job.spec.owner, lease.claim);
        }
        Some(lease)
    }

    /// Hands a lease over to another session of its worker; `false`: there is no such lease.
    pub(crate) fn hand_over(&mut self, key: &LeaseKey, to: WorkerId, now: Tick) -> bool {
        let Some(from) = self.table.leases.get(key).map(|lease| lease.worker) else { return false };
        [from, to].into_iter().for_each(|worker| self.charge_worker(worker));
        self.table.hand_over(key, to, &self.config, now)
    }

    /// Charges the running leases, and makes changed charges durable.
    pub(crate) fn record_charges(&mut self, now: Tick, out: &mut Vec<Command>) {
        self.next_charge = now.after(Self::CHARGE_INTERVAL);
        let workers: Vec<WorkerId> = self.table.workers.keys().copied().collect();
        workers.into_iter().for_each(|worker| self.charge_worker(worker));
        let known = self.ledger.side.used_times();
        let news =
            self.order.used_times().filter(|(owner, used)| known.get(*owner).copied().unwrap_or_default() != *used);
        let owners: Vec<(String, UsedTime)> = news.map(|(owner, used)| (owner.to_owned(), used)).collect();
        if !owners.is_empty() {
            self.record_fact(Fact::TimeCharged { owners }, now, out);
            let known = self.ledger.side.used_times();
            self.order.remove_absent(|owner| known.contains_key(owner));
        }
    }

    /// Returns the usage of each owner up to the last event, by owner. Uncharged time of running leases is not included.
    pub fn used_times(&self) -> impl Iterator<Item = (&str, UsedTime)> {
        self.order.used_times()
    }
}
