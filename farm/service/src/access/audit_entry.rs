//! Audit entry of a request.

use std::sync::{Arc, Mutex, PoisonError};

use femc_model::JobId;
use femc_trust::{Audit, AuditEvent};

use super::Caller;
use crate::operation::Operation;

/// Audit entry, filled in while the request is processed. Empty if there is no audit log.
#[derive(Debug, Clone, Default)]
pub struct AuditEntry(Option<Arc<Mutex<Entry>>>);

#[derive(Debug, Clone)]
struct Entry {
    operation: Operation,
    event: AuditEvent,
    /// Whether parts of the request have entries of their own.
    has_parts: bool,
}

/// Outcome of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The request succeeded.
    Done,
    /// The request was refused: a right or a valid identity is missing, or a limit is exceeded.
    Refused,
    /// The request failed for another reason.
    Failed,
}

impl AuditEntry {
    /// Maximum number of characters of a text from a client.
    const MAX_TEXT_CHARS: usize = 200;

    /// Starts the entry of the request `path` from `from`.
    pub(super) fn new(operation: Operation, path: &str, from: Option<String>) -> Self {
        let call = match operation {
            Operation::Other | Operation::Health => cut(path),
            known => known.name().to_owned(),
        };
        let event = AuditEvent { who: "unknown".into(), from, call, ..AuditEvent::default() };
        Self(Some(Arc::new(Mutex::new(Entry { operation, event, has_parts: false }))))
    }

    fn update(&self, change: impl FnOnce(&mut AuditEvent)) {
        if let Some(event) = &self.0 {
            // A poisoned lock is safe to use: a panic in the few lines under it leaves no partial change.
            change(&mut event.lock().unwrap_or_else(PoisonError::into_inner).event);
        }
    }

    /// Sets the holder and the credential of the caller.
    pub fn set_caller(&self, caller: &Caller) {
        self.update(|event| (event.who, event.by) = (caller.holder.to_string(), Some(caller.credential.to_string())));
    }

    /// Notes that the farm does not authenticate.
    pub fn set_unauthenticated(&self) {
        self.update(|event| event.who = "anybody".into());
    }

    /// Sets the action that the request asks for.
    pub fn set_action(&self, action: &str) {
        self.update(|event| event.what = Some(cut(action)));
    }

    /// Sets the job of the request.
    pub fn set_job(&self, JobId(job): JobId) {
        self.update(|event| event.job = Some(job));
    }

    /// Starts a separate entry for a part of the request. The request itself then gets no entry, unless it is refused.
    pub fn split_part(&self) -> Self {
        let Some(event) = &self.0 else { return Self(None) };
        let mut entry = event.lock().unwrap_or_else(PoisonError::into_inner);
        let part = Entry { has_parts: false, ..entry.clone() };
        entry.has_parts = true;
        Self(Some(Arc::new(Mutex::new(part))))
    }

    /// Writes the entry, if the operation is a change or was refused.
    /// - `code`: the refusal or the error, in one word.
    /// - `message`: its message.
    pub fn write(&self, audit: &Audit, outcome: Outcome, code: &str, message: &str) {
        let Some(event) = &self.0 else { return };
        let entry = event.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let Entry { operation, event: mut ended, has_parts } = entry;
        if outcome != Outcome::Refused && (has_parts || !operation.is_change()) {
            return;
        }
        ended.outcome = if outcome == Outcome::Done { "ok".into() } else { code.to_owned() };
        ended.why = Some(cut(message)).filter(|why| outcome != Outcome::Done && !why.is_empty());
        if outcome == Outcome::Refused {
            // Refusals are counted per address, without the port, so that a client cannot avoid this with new ports.
            ended.from = ended.from.map(|from| from.rsplit_once(':').map_or(from.clone(), |(ip, _)| ip.to_owned()));
            audit.record_refusal(ended);
        } else {
            audit.record(&ended);
        }
    }
}

fn cut(text: &str) -> String {
    text.chars().take(AuditEntry::MAX_TEXT_CHARS).collect()
}
