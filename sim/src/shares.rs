//! What owners are charged, beside the time for which workers were seen to hold something of theirs.

use std::collections::BTreeMap;
use std::time::Duration;

use femc_schedule::Used;

use crate::audit::Violation;
use crate::leases::SessionNumber;

/// Time of workers, each moment of which is the owner's of the oldest lease that the worker holds.
#[derive(Debug, Default)]
pub(crate) struct Shares {
    /// Whether nothing goes wrong with links, clocks and coordinators: then what is seen on the way is what they do.
    pub(crate) is_calm: bool,
    seen: BTreeMap<String, Duration>,
    /// Whose time a session's is, and since when.
    under_way: BTreeMap<SessionNumber, (String, Duration)>,
    /// How often that has changed.
    changes: u32,
    /// As charged last.
    charged: BTreeMap<String, u64>,
}

impl Shares {
    /// Of the way of a message, which may be seen earlier or later than it counts.
    const WAY: Duration = Duration::from_millis(30);
    /// Of a fact, which may be written later than it holds.
    const WRITE: Duration = Duration::from_millis(400);

    /// From now on a session's time is this owner's, or nobody's.
    pub(crate) fn turns(&mut self, session: SessionNumber, owner: Option<String>, now: Duration) {
        if self.under_way.get(&session).map(|(owner, _)| owner) == owner.as_ref() {
            return;
        }
        self.changes += 1;
        if let Some((before, since)) = self.under_way.remove(&session) {
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
            let (held, slack) = (Duration::from_millis(used.held), Self::WRITE * 3 + Self::WAY * self.changes);
            let is_off = self.is_calm && (held > seen + slack || held + slack < seen);
            if used.held < before || is_off {
                let [held, seen] = [held, seen].map(|time| time.as_millis() as u64);
                wrong.push(Violation::Charged { owner: owner.clone(), before, held, seen });
            }
        }
        wrong
    }
}
