//! What a request leaves in the audit record.

use std::sync::{Arc, Mutex, PoisonError};

use femc_model::JobId;
use femc_trust::{Audit, AuditEvent};

use super::Caller;
use crate::operation::Operation;

/// Filled in on the way through a request; empty where there is no record.
#[derive(Debug, Clone, Default)]
pub struct Trail(Option<Arc<Mutex<Entry>>>);

#[derive(Debug, Clone)]
struct Entry {
    operation: Operation,
    event: AuditEvent,
    /// Its parts have lines of their own.
    is_told: bool,
}

/// How a request ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It was done.
    Done,
    /// It was refused for want of a right, of a known identity, or because of a limit.
    Refused,
    /// It was not done for another reason.
    Failed,
}

impl Trail {
    /// Most characters of a text from outside.
    const LONGEST: usize = 200;

    /// Of the request `path` from `from`.
    pub(super) fn new(operation: Operation, path: &str, from: Option<String>) -> Self {
        let call = match operation {
            Operation::Other | Operation::Health => cut(path),
            known => known.name().to_owned(),
        };
        let event = AuditEvent { who: "unknown".into(), from, call, ..AuditEvent::default() };
        Self(Some(Arc::new(Mutex::new(Entry { operation, event, is_told: false }))))
    }

    fn with(&self, change: impl FnOnce(&mut AuditEvent)) {
        if let Some(event) = &self.0 {
            // A panic within the few lines under this lock leaves nothing half done.
            change(&mut event.lock().unwrap_or_else(PoisonError::into_inner).event);
        }
    }

    /// Holder and credential of the caller.
    pub fn caller(&self, caller: &Caller) {
        self.with(|event| (event.who, event.by) = (caller.holder.to_string(), Some(caller.credential.to_string())));
    }

    /// Nobody is asked who he is.
    pub fn anybody(&self) {
        self.with(|event| event.who = "anybody".into());
    }

    /// What the request asks for.
    pub fn what(&self, what: &str) {
        self.with(|event| event.what = Some(cut(what)));
    }

    /// Which job it is about.
    pub fn job(&self, JobId(job): JobId) {
        self.with(|event| event.job = Some(job));
    }

    /// A line of its own for a part of the request; the request as a whole gets none then, unless it is refused.
    pub fn part(&self) -> Self {
        let Some(event) = &self.0 else { return Self(None) };
        let mut entry = event.lock().unwrap_or_else(PoisonError::into_inner);
        let part = Entry { is_told: false, ..entry.clone() };
        entry.is_told = true;
        Self(Some(Arc::new(Mutex::new(part))))
    }

    /// Notes it, if it is a change or was refused.
    /// - `code`: of the refusal or the error, in one word.
    /// - `why`: what its message said.
    pub fn end(&self, audit: &Audit, outcome: Outcome, code: &str, why: &str) {
        let Some(event) = &self.0 else { return };
        let entry = event.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let Entry { operation, event: mut ended, is_told } = entry;
        if outcome != Outcome::Refused && (is_told || !operation.is_change()) {
            return;
        }
        ended.outcome = if outcome == Outcome::Done { "ok".into() } else { code.to_owned() };
        ended.why = Some(cut(why)).filter(|why| outcome != Outcome::Done && !why.is_empty());
        if outcome == Outcome::Refused {
            // Whoever tries from port after port tries again and again.
            ended.from = ended.from.map(|from| from.rsplit_once(':').map_or(from.clone(), |(ip, _)| ip.to_owned()));
            audit.refused(ended);
        } else {
            audit.note(&ended);
        }
    }
}

fn cut(text: &str) -> String {
    text.chars().take(Trail::LONGEST).collect()
}
