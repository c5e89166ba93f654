//! What owners are charged, beside the time for which workers were seen to hold something of theirs.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::JobId;
use femc_schedule::Used;

use crate::audit::Violation;
use crate::faults::{Fault, WORKERS};
use crate::leases::SessionNumber;

/// Whose a session's time is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Whose {
    /// Of a job's owner.
    Own(String),
    /// Of all those who wait for what jobs share.
    Shared(JobId, Vec<String>),
}

impl Whose {
    /// That of a task of a job.
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

    /// Whether it is the same owner's, or for the same.
    fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Shared(job, _), Self::Shared(other, _)) => job == other,
            _ => self == other,
        }
    }
}

/// A session's time.
#[derive(Debug)]
struct Turn {
    whose: Whose,
    /// It is whose it is since then.
    begun: Duration,
    /// And divided among its owners until then.
    divided: Duration,
}

/// Time of workers, each moment of which is the owner's of the oldest lease that the worker holds.
#[derive(Debug)]
pub(crate) struct Shares {
    /// Whether the coordinators' clocks are right: then nobody is charged more than was seen, and what nobody could see.
    is_timed: bool,
    /// Whether links and coordinators are well, too: then nobody is charged less.
    is_exact: bool,
    /// Longest way of a message.
    way: Duration,
    /// For which workers may have held something unseen: a lease that nobody renews lasts, and what is frozen comes later.
    unseen: Duration,
    /// By owner; those who are not told have one.
    pub(crate) weights: BTreeMap<String, u32>,
    seen: BTreeMap<String, Duration>,
    under_way: BTreeMap<SessionNumber, Turn>,
    /// Time of which an owner may have been charged more or less than his part, because others began or ceased to wait within it.
    open: BTreeMap<String, Duration>,
    /// How often that has changed, by owner.
    changes: BTreeMap<String, u32>,
    /// As charged last.
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
    /// Of the way of a message, which may be seen earlier or later than it counts.
    const WAY: Duration = Duration::from_millis(30);
    /// Of a fact, which may be written later than it holds.
    const WRITE: Duration = Duration::from_millis(400);
    /// Of a lease, from its last renewal, and of what the coordinator does about it.
    const LEASE: Duration = Duration::from_millis(4_500 + 500);

    /// What may be wrong from now on with what is seen.
    pub(crate) fn expect(&mut self, faults: impl Iterator<Item = Fault>) {
        for fault in faults {
            match fault {
                // These are at the workers' end, as is the switch: what the coordinator does about them is seen.
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

    /// A task has killed its worker.
    pub(crate) fn strikes(&mut self) {
        self.unseen += Self::LEASE;
    }

    /// From now on a session's time is this owner's, or for what these share, or nobody's.
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

    /// Whoever waits for what jobs share may have changed: from now on its time is that of these. What a worker has held of it since
    /// it was charged last is theirs, too.
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

    /// Each owner's part of some time, by weight.
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

    /// A log begins that knows of nothing.
    pub(crate) fn anew(&mut self) {
        self.charged.clear();
    }

    /// What is wrong with what owners are charged: it never goes back, over restarts of the coordinator neither, and is what was
    /// seen.
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
