//! What owners are charged, beside the time for which workers were seen to hold something of theirs.

use std::collections::BTreeMap;
use std::time::Duration;

use femc_schedule::Used;

use crate::audit::Violation;
use crate::faults::{Fault, WORKERS};
use crate::leases::SessionNumber;

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
    seen: BTreeMap<String, Duration>,
    /// Whose time a session's is, and since when.
    under_way: BTreeMap<SessionNumber, (String, Duration)>,
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
            seen: BTreeMap::new(),
            under_way: BTreeMap::new(),
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
                Fault::WorkerFreezes(_, pause) => self.unseen += Self::LEASE + pause,
                Fault::ArtefactHarmed(_)
                | Fault::SceneHarmed(_)
                | Fault::StoreFull(_)
                | Fault::StoreAway(_)
                | Fault::StoreSlow(..)
                | Fault::UploadTorn(..) => {}
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

    /// From now on a session's time is this owner's, or nobody's.
    pub(crate) fn turns(&mut self, session: SessionNumber, owner: Option<String>, now: Duration) {
        if self.under_way.get(&session).map(|(owner, _)| owner) == owner.as_ref() {
            return;
        }
        let before = self.under_way.remove(&session);
        for owner in before.iter().map(|(owner, _)| owner).chain(&owner) {
            *self.changes.entry(owner.clone()).or_default() += 1;
        }
        if let Some((before, since)) = before {
            *self.seen.entry(before).or_default() += now.saturating_sub(since);
        }
        if let Some(owner) = owner {
            self.under_way.insert(session, (owner, now));
        }
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
            let under_way = self.under_way.values().filter(|(other, _)| other == owner);
            let under_way: Duration = under_way.map(|(_, since)| now.saturating_sub(*since)).sum();
            let seen = self.seen.get(owner).copied().unwrap_or_default() + under_way;
            let changes = self.changes.get(owner).copied().unwrap_or(0);
            let (held, slack) = (Duration::from_millis(used.held), Self::WRITE * 3 + self.way * changes);
            let is_off = self.is_timed && held > seen + slack + self.unseen || self.is_exact && held + slack < seen;
            if used.held < before || is_off {
                let [held, seen] = [held, seen].map(|time| time.as_millis() as u64);
                wrong.push(Violation::Charged { owner: owner.clone(), before, held, seen });
            }
        }
        wrong
    }
}
