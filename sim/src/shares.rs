//! Checks the charges of owners against the observed time for which workers held their tasks.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::JobId;
use femc_schedule::Used;

use crate::audit::Violation;
use crate::faults::{Fault, WORKERS};
use crate::leases::SessionNumber;

/// Payers of a session's time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Whose {
    /// Owner of a job.
    Own(String),
    /// Owners of all jobs that wait for a set of shared stages.
    Shared(JobId, Vec<String>),
}

impl Whose {
    /// Returns the payers of a task of a job.
    pub(crate) fn of(job: JobId, mut owners: Vec<String>) -> Self {
        match owners.pop() {
            Some(owner) if !job.is_shared() => Self::Own(owner),
            last => Self::Shared(job, owners.into_iter().chain(last).collect()),
        }
    }

    fn owners(&self) -> &[String] {
        match self {
            Self::Own(owner) => std::slice::from_ref(owner),
            Self::Shared(_, owners) => owners,
        }
    }

    /// Checks whether both have the same owner or the same shared stages.
    fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Shared(job, _), Self::Shared(other, _)) => job == other,
            _ => self == other,
        }
    }
}

/// Time of a session that is being charged.
#[derive(Debug)]
struct Turn {
    whose: Whose,
    /// Time since which it belongs to these payers.
    begun: Duration,
    /// Time until which it is divided among them.
    divided: Duration,
}

/// Time of workers by owner. Each moment belongs to the owner of the oldest lease that the worker holds.
#[derive(Debug)]
pub(crate) struct Shares {
    /// The coordinators' clocks are right. Then no charge exceeds the observed time plus the unobserved time.
    is_timed: bool,
    /// Links and coordinators have no faults either. Then no charge is below the observed time.
    is_exact: bool,
    /// Longest latency of a message.
    way: Duration,
    /// Time for which workers may have held unobserved leases: a lease lasts until it expires without renewal, and messages of a
    /// frozen worker arrive later.
    unseen: Duration,
    /// Weights by owner. Owners without an entry have weight one.
    pub(crate) weights: BTreeMap<String, u32>,
    seen: BTreeMap<String, Duration>,
    under_way: BTreeMap<SessionNumber, Turn>,
    /// Time in which the charge of an owner may differ from the owner's share, because other owners joined or left the division.
    open: BTreeMap<String, Duration>,
    /// Number of changes of a session's payers, by owner.
    changes: BTreeMap<String, u32>,
    /// Latest charge by owner, in milliseconds.
    charged: BTreeMap<String, u64>,
}

impl Default for Shares {
    fn default() -> Self {
        Self {
            is_timed: true,
            is_exact: true,
            way: Self::WAY,
            unseen: Duration::ZERO,
            weights: BTreeMap::new(),
            seen: BTreeMap::new(),
            under_way: BTreeMap::new(),
            open: BTreeMap::new(),
            changes: BTreeMap::new(),
            charged: BTreeMap::new(),
        }
    }
}

impl Shares {
    /// Time by which the observation of a message may precede or follow its effect.
    const WAY: Duration = Duration::from_millis(30);
    /// Time between a fact and its record in the log.
    const WRITE: Duration = Duration::from_millis(400);
    /// Time from the last renewal of a lease to the coordinator's reaction to its expiry.
    const LEASE: Duration = Duration::from_millis(4_500 + 500);

    /// Prepares for faults that make the observations inexact.
    pub(crate) fn expect(&mut self, faults: impl Iterator<Item = Fault>) {
        for fault in faults {
            match fault {
                // These faults and the switch are on the workers' side, so the coordinator's reaction is observed.
                Fault::WorkerDies(..) | Fault::WorkerCut(..) | Fault::WorkerMute(..) => self.unseen += Self::LEASE,
                Fault::AloneAndSick(..) => self.unseen += Self::LEASE * WORKERS as u32,
                Fault::WorkerFreezes(_, pause) => self.unseen += Self::LEASE + pause,
                Fault::ArtifactHarmed(_)
                | Fault::SceneHarmed(_)
                | Fault::StoreFull(_)
                | Fault::StoreAway(_)
                | Fault::StoreSlow(..)
                | Fault::UploadTorn(..)
                | Fault::ReadsAnother(_) => {}
                Fault::Slow(most, _) => self.way = self.way.max(Self::WAY + most),
                Fault::CoordinatorDies(pause) | Fault::CoordinatorCut(pause) | Fault::CoordinatorFreezes(pause) => {
                    self.breaks(pause);
                }
                Fault::DiesBeforeWrite(_)
                | Fault::DiesAfterWrite(_)
                | Fault::TornWrite(_)
                | Fault::LeadChanges
                | Fault::LogFull(_) => self.breaks(Duration::ZERO),
                Fault::ClockJumps(..) | Fault::ClockDrifts(..) | Fault::LogLost => {
                    (self.is_timed, self.is_exact) = (false, false);
                }
            }
        }
    }

    fn breaks(&mut self, pause: Duration) {
        self.is_exact = false;
        self.unseen += (Self::LEASE + pause) * WORKERS as u32;
    }

    /// Notes that a task has killed its worker.
    pub(crate) fn strikes(&mut self) {
        self.unseen += Self::LEASE;
    }

    /// Assigns the time of a session to new payers, or to nobody, from now on.
    pub(crate) fn turns(&mut self, session: SessionNumber, whose: Option<Whose>, now: Duration) {
        let before = self.under_way.get(&session).map(|turn| &turn.whose);
        if before
            .zip(whose.as_ref())
            .map_or(before.is_none() && whose.is_none(), |(before, whose)| before.is_like(whose))
        {
            return;
        }
        let before = self.under_way.remove(&session);
        for owner in before.iter().map(|turn| &turn.whose).chain(&whose).flat_map(Whose::owners) {
            *self.changes.entry(owner.clone()).or_default() += 1;
        }
        if let Some(before) = before {
            self.settle(&before.whose, now.saturating_sub(before.divided));
        }
        if let Some(whose) = whose {
            self.under_way.insert(session, Turn { whose, begun: now, divided: now });
        }
    }

    /// Updates the payers of shared stages. From now on, the time belongs to the new payers. They also pay for the time that
    /// workers have held since the last charge.
    pub(crate) fn divide(&mut self, payers: &BTreeMap<JobId, Vec<String>>, now: Duration) {
        let mut changed = Vec::new();
        for turn in self.under_way.values_mut() {
            let Whose::Shared(job, owners) = &turn.whose else { continue };
            let Some(payers) = payers.get(job).filter(|payers| *payers != owners) else { continue };
            let after = Whose::Shared(*job, payers.clone());
            let before = std::mem::replace(&mut turn.whose, after);
            let divided = now.saturating_sub(std::mem::replace(&mut turn.divided, now));
            let open = now.saturating_sub(turn.begun) + Self::WRITE;
            let owners: BTreeSet<String> = before.owners().iter().chain(payers).cloned().collect();
            changed.push((before, divided, open, owners));
        }
        for (before, divided, open, owners) in changed {
            self.settle(&before, divided);
            owners.into_iter().for_each(|owner| *self.open.entry(owner).or_default() += open);
        }
    }

    /// Divides a time among owners by weight.
    fn parts<'a>(&'a self, whose: &'a Whose, time: Duration) -> impl Iterator<Item = (&'a String, Duration)> {
        let weight = |owner: &String| self.weights.get(owner).copied().unwrap_or(1).max(1);
        let sum: u32 = whose.owners().iter().map(weight).sum();
        whose.owners().iter().map(move |owner| (owner, time * weight(owner) / sum))
    }

    fn settle(&mut self, whose: &Whose, time: Duration) {
        let parts: Vec<(String, Duration)> =
            self.parts(whose, time).map(|(owner, part)| (owner.clone(), part)).collect();
        parts.into_iter().for_each(|(owner, part)| *self.seen.entry(owner).or_default() += part);
    }

    /// Begins an empty log.
    pub(crate) fn anew(&mut self) {
        self.charged.clear();
    }

    /// Checks the charges of owners. They never decrease, not even over restarts of the coordinator, and they agree with the
    /// observed time.
    pub(crate) fn judge(&mut self, owners: &[(String, Used)], now: Duration) -> Vec<Violation> {
        let mut wrong = Vec::new();
        for (owner, used) in owners {
            let before = self.charged.insert(owner.clone(), used.held).unwrap_or(0);
            let running = self.under_way.values().map(|turn| (&turn.whose, now.saturating_sub(turn.divided)));
            let parts = running.flat_map(|(whose, time)| self.parts(whose, time));
            let under_way: Duration = parts.filter(|(other, _)| *other == owner).map(|(_, part)| part).sum();
            let open = self.open.get(owner).copied().unwrap_or_default();
            let seen = self.seen.get(owner).copied().unwrap_or_default() + under_way;
            let changes = self.changes.get(owner).copied().unwrap_or(0);
            let (held, slack) = (Duration::from_millis(used.held), Self::WRITE * 3 + self.way * changes + open);
            let is_off = self.is_timed && held > seen + slack + self.unseen || self.is_exact && held + slack < seen;
            if used.held < before || is_off {
                let [held, seen] = [held, seen].map(|time| time.as_millis() as u64);
                wrong.push(Violation::Charged { owner: owner.clone(), before, held, seen });
            }
        }
        wrong
    }
}
