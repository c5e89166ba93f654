//! Checks the charges of owners against the observed time for which workers held their tasks.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::JobId;
use femc_schedule::UsedTime;

use crate::audit::Violation;
use crate::faults::{Fault, WORKERS};
use crate::leases::SessionNumber;

/// Payers of a session's time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Payers {
    /// Owner of a job.
    Owner(String),
    /// Owners of all jobs that wait for a set of shared stages.
    Shared(JobId, Vec<String>),
}

impl Payers {
    /// Returns the payers of a task of a job.
    pub(crate) fn from_owners(job: JobId, mut owners: Vec<String>) -> Self {
        match owners.pop() {
            Some(owner) if !job.is_shared() => Self::Owner(owner),
            last => Self::Shared(job, owners.into_iter().chain(last).collect()),
        }
    }

    fn owners(&self) -> &[String] {
        match self {
            Self::Owner(owner) => std::slice::from_ref(owner),
            Self::Shared(_, owners) => owners,
        }
    }

    /// Checks whether both have the same owner or the same shared stages.
    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Shared(job, _), Self::Shared(other, _)) => job == other,
            _ => self == other,
        }
    }
}

/// Time of a session that is being charged.
#[derive(Debug)]
struct ChargedTime {
    payers: Payers,
    /// Time since which it belongs to these payers.
    since: Duration,
    /// Time until which it is divided among them.
    divided_until: Duration,
}

/// Time of workers by owner. Each moment belongs to the owner of the oldest lease that the worker holds.
#[derive(Debug)]
pub(crate) struct ChargeAudit {
    /// The coordinators' clocks are right. Then no charge exceeds the observed time plus the unobserved time.
    has_right_clocks: bool,
    /// Links and coordinators have no faults either. Then no charge is below the observed time.
    is_exact: bool,
    /// Longest latency of a message.
    max_latency: Duration,
    /// Time for which workers may have held unobserved leases: a lease lasts until it expires without renewal, and messages of a
    /// frozen worker arrive later.
    unobserved: Duration,
    /// Weights by owner. Owners without an entry have weight one.
    pub(crate) weights: BTreeMap<String, u32>,
    observed: BTreeMap<String, Duration>,
    running: BTreeMap<SessionNumber, ChargedTime>,
    /// Time in which the charge of an owner may differ from the owner's share, because other owners joined or left the division.
    tolerance: BTreeMap<String, Duration>,
    /// Number of changes of a session's payers, by owner.
    changes: BTreeMap<String, u32>,
    /// Latest charge by owner, in milliseconds.
    charged: BTreeMap<String, u64>,
}

impl Default for ChargeAudit {
    fn default() -> Self {
        Self {
            has_right_clocks: true,
            is_exact: true,
            max_latency: Self::OBSERVATION_SLACK,
            unobserved: Duration::ZERO,
            weights: BTreeMap::new(),
            observed: BTreeMap::new(),
            running: BTreeMap::new(),
            tolerance: BTreeMap::new(),
            changes: BTreeMap::new(),
            charged: BTreeMap::new(),
        }
    }
}

impl ChargeAudit {
    /// Time by which the observation of a message may precede or follow its effect.
    const OBSERVATION_SLACK: Duration = Duration::from_millis(30);
    /// Time between a fact and its record in the log.
    const WRITE_DELAY: Duration = Duration::from_millis(400);
    /// Time from the last renewal of a lease to the coordinator's reaction to its expiry.
    const LEASE_TIME: Duration = Duration::from_millis(4_500 + 500);

    /// Prepares for faults that make the observations inexact.
    pub(crate) fn allow_for(&mut self, faults: impl Iterator<Item = Fault>) {
        for fault in faults {
            match fault {
                // These faults and the switch are on the workers' side, so the coordinator's reaction is observed.
                Fault::WorkerDies(..) | Fault::WorkerPartitioned(..) | Fault::WorkerMute(..) => {
                    self.unobserved += Self::LEASE_TIME;
                }
                Fault::LoneWorkerFails(..) => self.unobserved += Self::LEASE_TIME * WORKERS as u32,
                Fault::WorkerFreezes(_, pause) => self.unobserved += Self::LEASE_TIME + pause,
                Fault::ArtifactDamaged(_)
                | Fault::SceneDamaged(_)
                | Fault::StoreFull(_)
                | Fault::StoreUnavailable(_)
                | Fault::StoreSlow(..)
                | Fault::UploadTorn(..)
                | Fault::WrongRead(_) => {}
                Fault::SlowNetwork(most, _) => self.max_latency = self.max_latency.max(Self::OBSERVATION_SLACK + most),
                Fault::CoordinatorDies(pause)
                | Fault::CoordinatorPartitioned(pause)
                | Fault::CoordinatorFreezes(pause) => {
                    self.allow_for_interruption(pause);
                }
                Fault::DiesBeforeWrite(_)
                | Fault::DiesAfterWrite(_)
                | Fault::TornWrite(_)
                | Fault::LeaderChanges
                | Fault::LogFull(_) => self.allow_for_interruption(Duration::ZERO),
                Fault::ClockJumps(..) | Fault::ClockDrifts(..) | Fault::LogLost => {
                    (self.has_right_clocks, self.is_exact) = (false, false);
                }
            }
        }
    }

    fn allow_for_interruption(&mut self, pause: Duration) {
        self.is_exact = false;
        self.unobserved += (Self::LEASE_TIME + pause) * WORKERS as u32;
    }

    /// Notes that a task has killed its worker.
    pub(crate) fn allow_for_kill(&mut self) {
        self.unobserved += Self::LEASE_TIME;
    }

    /// Assigns the time of a session to new payers, or to nobody, from now on.
    pub(crate) fn set_payers(&mut self, session: SessionNumber, payers: Option<Payers>, now: Duration) {
        let before = self.running.get(&session).map(|turn| &turn.payers);
        if before
            .zip(payers.as_ref())
            .map_or(before.is_none() && payers.is_none(), |(before, whose)| before.is_same(whose))
        {
            return;
        }
        let before = self.running.remove(&session);
        for owner in before.iter().map(|turn| &turn.payers).chain(&payers).flat_map(Payers::owners) {
            *self.changes.entry(owner.clone()).or_default() += 1;
        }
        if let Some(before) = before {
            self.credit(&before.payers, now.saturating_sub(before.divided_until));
        }
        if let Some(whose) = payers {
            self.running.insert(session, ChargedTime { payers: whose, since: now, divided_until: now });
        }
    }

    /// Updates the payers of shared stages. From now on, the time belongs to the new payers. They also pay for the time that
    /// workers have held since the last charge.
    pub(crate) fn divide(&mut self, payers: &BTreeMap<JobId, Vec<String>>, now: Duration) {
        let mut changed = Vec::new();
        for turn in self.running.values_mut() {
            let Payers::Shared(job, owners) = &turn.payers else { continue };
            let Some(payers) = payers.get(job).filter(|payers| *payers != owners) else { continue };
            let after = Payers::Shared(*job, payers.clone());
            let before = std::mem::replace(&mut turn.payers, after);
            let divided = now.saturating_sub(std::mem::replace(&mut turn.divided_until, now));
            let open = now.saturating_sub(turn.since) + Self::WRITE_DELAY;
            let owners: BTreeSet<String> = before.owners().iter().chain(payers).cloned().collect();
            changed.push((before, divided, open, owners));
        }
        for (before, divided, open, owners) in changed {
            self.credit(&before, divided);
            owners.into_iter().for_each(|owner| *self.tolerance.entry(owner).or_default() += open);
        }
    }

    /// Divides a time among owners by weight.
    fn split<'a>(&'a self, payers: &'a Payers, time: Duration) -> impl Iterator<Item = (&'a String, Duration)> {
        let weight = |owner: &String| self.weights.get(owner).copied().unwrap_or(1).max(1);
        let sum: u32 = payers.owners().iter().map(weight).sum();
        payers.owners().iter().map(move |owner| (owner, time * weight(owner) / sum))
    }

    fn credit(&mut self, payers: &Payers, time: Duration) {
        let parts: Vec<(String, Duration)> =
            self.split(payers, time).map(|(owner, part)| (owner.clone(), part)).collect();
        parts.into_iter().for_each(|(owner, part)| *self.observed.entry(owner).or_default() += part);
    }

    /// Begins an empty log.
    pub(crate) fn reset(&mut self) {
        self.charged.clear();
    }

    /// Checks the charges of owners. They never decrease, not even over restarts of the coordinator, and they agree with the
    /// observed time.
    pub(crate) fn check_charges(&mut self, owners: &[(String, UsedTime)], now: Duration) -> Vec<Violation> {
        let mut wrong = Vec::new();
        for (owner, used) in owners {
            let before = self.charged.insert(owner.clone(), used.charged).unwrap_or(0);
            let running = self.running.values().map(|turn| (&turn.payers, now.saturating_sub(turn.divided_until)));
            let parts = running.flat_map(|(whose, time)| self.split(whose, time));
            let under_way: Duration = parts.filter(|(other, _)| *other == owner).map(|(_, part)| part).sum();
            let open = self.tolerance.get(owner).copied().unwrap_or_default();
            let seen = self.observed.get(owner).copied().unwrap_or_default() + under_way;
            let changes = self.changes.get(owner).copied().unwrap_or(0);
            let (held, slack) =
                (Duration::from_millis(used.charged), Self::WRITE_DELAY * 3 + self.max_latency * changes + open);
            let is_off =
                self.has_right_clocks && held > seen + slack + self.unobserved || self.is_exact && held + slack < seen;
            if used.charged < before || is_off {
                let [held, seen] = [held, seen].map(|time| time.as_millis() as u64);
                wrong.push(Violation::WrongCharge { owner: owner.clone(), before, held, seen });
            }
        }
        wrong
    }
}
