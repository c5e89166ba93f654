//! What went wrong with a task that is not done.

use std::collections::BTreeSet;

use femc_model::{Epoch, Failure};
use serde::{Deserialize, Serialize};

use crate::{Casualty, Evidence};

/// Attempts after which a task is put aside. A constant of the ledger, so that a log means the same to every program.
const ATTEMPTS: u32 = 3;

/// Deaths of workers after which a task is put aside.
const DEATHS: usize = 5;

/// Failed attempts of a task that is not done, and workers that died of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Trouble {
    attempts: u32,
    /// The latest at the end; of each lease one.
    deaths: Vec<Casualty>,
    pub(crate) failure: Failure,
    /// Leases up to this one are over, of whatever they are told later.
    until: Epoch,
}

impl Trouble {
    pub(super) fn new(failure: Failure) -> Self {
        Self { attempts: 0, deaths: Vec::new(), failure, until: Epoch(0) }
    }

    pub(crate) fn is_quarantined(&self) -> bool {
        self.attempts >= ATTEMPTS || self.is_deadly()
    }

    /// Deaths that are only presumed may be one machine's own: they count beside those of another.
    fn is_deadly(&self) -> bool {
        let known = self.deaths.iter().filter(|death| death.evidence == Evidence::Journal).count();
        let workers: BTreeSet<&str> = self.deaths.iter().map(|death| death.worker.as_str()).collect();
        known >= DEATHS || (self.deaths.len() >= DEATHS && workers.len() > 1)
    }

    /// How often it was tried, with whatever came of it.
    pub(crate) fn tries(&self) -> u32 {
        self.attempts + self.deaths.len() as u32
    }

    /// Whether this lease was over when the last failure was counted: what its worker has to say was heard.
    pub(super) fn is_over(&self, epoch: Epoch) -> bool {
        epoch <= self.until
    }

    pub(super) fn failed(&mut self, until: Epoch, failure: &Failure) {
        self.attempts += 1;
        self.until = self.until.max(until);
        self.failure = failure.clone();
    }

    pub(super) fn died(&mut self, casualty: &Casualty) {
        match self.deaths.iter_mut().find(|known| known.epoch == casualty.epoch) {
            Some(known) => known.evidence = known.evidence.max(casualty.evidence),
            None => self.deaths.push(casualty.clone()),
        }
        // Of one worker alone they put nothing aside, however many: a few tell as much.
        let oldest = || self.deaths.iter().position(|death| death.evidence == Evidence::Presumed);
        if self.deaths.len() > 2 * DEATHS
            && let Some(oldest) = oldest()
        {
            self.deaths.remove(oldest);
        }
        self.failure = Failure::Killed { deaths: self.deaths.len() as u32, worker: casualty.worker.clone() };
    }

    /// A process lives: what is not put aside yet has not killed it. Returns whether anything is left.
    pub(super) fn lives(&mut self, instance: u64) -> bool {
        if self.is_quarantined() {
            return true;
        }
        let before = self.deaths.len();
        self.deaths.retain(|death| (death.instance, death.evidence) != (instance, Evidence::Presumed));
        self.deaths.len() == before || self.tries() > 0
    }

    /// Processes of which a presumed death counts.
    pub(super) fn presumed_dead(&self) -> impl Iterator<Item = u64> + '_ {
        self.deaths.iter().filter(|death| death.evidence == Evidence::Presumed).map(|death| death.instance)
    }
}
