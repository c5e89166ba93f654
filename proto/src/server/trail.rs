//! What a call leaves in the audit record.

use std::sync::{Arc, Mutex, PoisonError};

use femc_model::JobId;
use femc_trust::{Audit, AuditEvent};
use http::Response;
use tonic::{Code, Request, Status};

use super::guard::Caller;

/// Filled in on the way through a call; empty where there is no record.
#[derive(Debug, Clone, Default)]
pub(super) struct Trail(Option<Arc<Mutex<AuditEvent>>>);

impl Trail {
    /// Most characters of a text from outside.
    const LONGEST: usize = 200;

    /// Of the call `path` from `from`.
    pub(super) fn new(path: &str, from: Option<String>) -> Self {
        let call = cut(path.trim_start_matches('/').trim_start_matches("femc.v1."));
        Self(Some(Arc::new(Mutex::new(AuditEvent { who: "unknown".into(), from, call, ..AuditEvent::default() }))))
    }

    /// That of the call that this request makes.
    pub(super) fn of<T>(request: &Request<T>) -> Self {
        request.extensions().get().cloned().unwrap_or_default()
    }

    fn with(&self, change: impl FnOnce(&mut AuditEvent)) {
        if let Some(event) = &self.0 {
            // A panic within the few lines under this lock leaves nothing half done.
            change(&mut event.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }

    /// Holder and credential of the caller.
    pub(super) fn caller(&self, caller: &Caller) {
        self.with(|event| (event.who, event.by) = (caller.holder.to_string(), Some(caller.credential.to_string())));
    }

    /// Nobody is asked who he is.
    pub(super) fn anybody(&self) {
        self.with(|event| event.who = "anybody".into());
    }

    /// What the call asks for.
    pub(super) fn what(&self, what: &str) {
        self.with(|event| event.what = Some(cut(what)));
    }

    /// Which job it is about.
    pub(super) fn job(&self, JobId(job): JobId) {
        self.with(|event| event.job = Some(job));
    }

    /// Notes it, if it is a change or was refused.
    pub(super) fn end<B>(&self, audit: &Audit, response: &Response<B>) {
        let status = Status::from_header_map(response.headers());
        let code = status.as_ref().map_or(Code::Ok, Status::code);
        let is_refused = matches!(code, Code::Unauthenticated | Code::PermissionDenied | Code::ResourceExhausted);
        let mut ended = AuditEvent::default();
        self.with(|event| ended = event.clone());
        if !is_refused && !is_change(&ended.call) {
            return;
        }
        ended.outcome = if code == Code::Ok { "ok".into() } else { format!("{code:?}") };
        ended.why = status.map(|status| cut(status.message())).filter(|why| !why.is_empty());
        if is_refused {
            // Whoever tries from port after port tries again and again.
            ended.from = ended.from.map(|from| from.rsplit_once(':').map_or(from.clone(), |(ip, _)| ip.to_owned()));
            audit.refused(ended);
        } else {
            audit.note(&ended);
        }
    }
}

/// Whether a call changes what the farm does.
fn is_change(call: &str) -> bool {
    matches!(call, "Jobs/Submit" | "Jobs/Control" | "Jobs/DrainWorkers" | "Workers/Session" | "Artifacts/Collect")
}

fn cut(text: &str) -> String {
    text.chars().take(Trail::LONGEST).collect()
}
