//! Leases that a session may claim, according to the worker's own clock.
//!
//! The worker does not know when the coordinator received a heartbeat, but it knows when it sent it. If the answer says that a
//! lease holds for another 5 s, the lease holds at least until 5 s after the heartbeat was sent. The worker relies on a sixteenth
//! less, because clocks run at different rates. The worker neither reports nor renews a task whose lease it does not claim. It may
//! still compute that task, and it claims the lease again when the coordinator says that it holds.
//!
//! Claims belong to one session. A new session begins with none. Leases from an earlier session are claimed when an answer names
//! them.

use std::collections::BTreeMap;
use std::time::Duration;

use femc_model::{Epoch, LeaseStatus, TaskKey};
use tokio::time::Instant;

/// The leases of a session.
#[derive(Debug)]
pub(crate) struct Claims {
    /// Time when the worker sent the latest message that the coordinator has surely received.
    last_contact: Instant,
    /// Longest silence of the coordinator before the session counts as lost.
    max_silence: Duration,
    /// Heartbeats not yet answered: number and sending time.
    unanswered: BTreeMap<u64, Instant>,
    last: u64,
    deadlines: BTreeMap<(TaskKey, Epoch), Instant>,
}

impl Claims {
    /// Time limit for the coordinator's first message.
    pub(crate) const WELCOME_TIMEOUT: Duration = Duration::from_secs(10);
    /// Divisor of the safety margin: the worker does not rely on the last `1 / MARGIN` of a lease.
    const MARGIN: u32 = 16;

    /// Creates the claims of a session whose registration is sent at `now`.
    pub(crate) fn new(now: Instant) -> Self {
        Self {
            last_contact: now,
            max_silence: Self::WELCOME_TIMEOUT,
            unanswered: BTreeMap::new(),
            last: 0,
            deadlines: BTreeMap::new(),
        }
    }

    /// Records that the coordinator accepted the registration.
    /// - `lease`: lease duration in milliseconds.
    pub(crate) fn on_welcome(&mut self, lease: u64) {
        self.max_silence = reliable_part(lease);
    }

    /// Records that a heartbeat is sent at `now`; returns the heartbeat's number.
    pub(crate) fn next_heartbeat(&mut self, now: Instant) -> u64 {
        self.last += 1;
        self.unanswered.insert(self.last, now);
        self.last
    }

    /// Records the answer to a heartbeat: exactly these leases hold.
    pub(crate) fn on_renewed(&mut self, heartbeat: u64, leases: &[LeaseStatus]) {
        let Some(sent) = self.unanswered.remove(&heartbeat) else { return };
        self.unanswered.retain(|&number, _| number > heartbeat);
        self.last_contact = self.last_contact.max(sent);
        self.deadlines =
            leases.iter().map(|lease| ((lease.task, lease.epoch), sent + reliable_part(lease.remaining))).collect();
    }

    /// Records a new lease. The coordinator granted it after the worker sent the last answered heartbeat.
    /// - `lease`: lease duration in milliseconds.
    pub(crate) fn on_assigned(&mut self, key: (TaskKey, Epoch), lease: u64) {
        self.deadlines.insert(key, self.last_contact + reliable_part(lease));
    }

    /// Drops the claim to a lease that has ended.
    pub(crate) fn remove(&mut self, key: &(TaskKey, Epoch)) {
        self.deadlines.remove(key);
    }

    /// Checks that the lease surely holds at `now`.
    pub(crate) fn holds(&self, key: &(TaskKey, Epoch), now: Instant) -> bool {
        self.deadlines.get(key).is_some_and(|until| now < *until)
    }

    /// Returns the time at which all leases count as lost unless the coordinator sends something before.
    pub(crate) fn session_deadline(&self) -> Instant {
        self.last_contact + self.max_silence
    }
}

/// Returns the part of a lease that the worker relies on.
fn reliable_part(milliseconds: u64) -> Duration {
    let whole = Duration::from_millis(milliseconds);
    whole - whole / Claims::MARGIN
}

#[cfg(test)]
mod tests {
    use femc_model::{JobId, Stage, StageKind};

    use super::*;

    fn key(index: u32) -> (TaskKey, Epoch) {
        let stage = Stage { frame: 1, round: 0, number: 0, kind: StageKind::Render };
        (TaskKey { job: JobId(1), stage, index }, Epoch(9))
    }

    fn left(index: u32, left: u64) -> LeaseStatus {
        let (task, epoch) = key(index);
        LeaseStatus { task, epoch, remaining: left }
    }

    #[test]
    fn lease_counts_from_sending_of_answered_heartbeat() {
        let start = Instant::now();
        let at = |milliseconds| start + Duration::from_millis(milliseconds);
        let mut claims = Claims::new(start);
        claims.on_welcome(1600);
        claims.on_assigned(key(1), 1600);
        assert!(claims.holds(&key(1), at(1499)) && !claims.holds(&key(1), at(1500)));
        assert_eq!((claims.next_heartbeat(at(100)), claims.next_heartbeat(at(1000))), (1, 2));
        // The lease counts from the sending time, no matter how late the answer arrives.
        claims.on_renewed(1, &[left(1, 1600)]);
        assert!(claims.holds(&key(1), at(1599)) && !claims.holds(&key(1), at(1600)));
        assert_eq!(claims.session_deadline(), at(1600));
        claims.on_assigned(key(2), 1600);
        assert!(!claims.holds(&key(2), at(1600)), "it may have been granted right after the first heartbeat");
        claims.on_renewed(2, &[left(1, 160), left(2, 1600)]);
        assert!(!claims.holds(&key(1), at(1150)), "a task that does not move is not renewed");
        assert!(claims.holds(&key(2), at(2499)));
    }

    #[test]
    fn unnamed_lease_is_over_and_stale_answers_change_nothing() {
        let start = Instant::now();
        let mut claims = Claims::new(start);
        claims.on_assigned(key(1), 1600);
        let (first, second) = (claims.next_heartbeat(start), claims.next_heartbeat(start));
        claims.on_renewed(second, &[left(2, 1600)]);
        assert!(!claims.holds(&key(1), start) && claims.holds(&key(2), start));
        claims.on_renewed(first, &[left(1, 1600)]);
        claims.on_renewed(77, &[left(1, 1600)]);
        assert!(!claims.holds(&key(1), start) && claims.holds(&key(2), start));
        claims.remove(&key(2));
        assert!(!claims.holds(&key(2), start));
    }
}
