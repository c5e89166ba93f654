//! Messages of a worker's session.

use femc_model::{
    Death, FromWorker, HeldLease, Intake, JobId, JobSpec, LeaseStatus, Phase, Registration, RevokeReason, TaskProgress,
    ToWorker, WorkerId,
};

use super::status::parse_intake;
use super::task::{from_lease, from_range, to_lease, to_range};
use super::{ConvertError, convert_all, convert_optional, digest_bytes, parse_digest, required};
use crate::{OLDEST_PROTOCOL, PROTOCOL, wire};

impl From<FromWorker> for wire::FromWorker {
    fn from(message: FromWorker) -> Self {
        use wire::from_worker::Message;
        let message = match message {
            FromWorker::Register(registration) => Message::Register(registration.into()),
            FromWorker::Heartbeat { number, tasks, usage } => Message::Heartbeat(wire::Heartbeat {
                number,
                tasks: tasks.into_iter().map(Into::into).collect(),
                spent: usage.into_iter().map(Into::into).collect(),
            }),
            FromWorker::Completed { task, epoch, result, log, usage } => {
                let (lease, result, log) = (to_lease(task, epoch), Some(result.into()), log.map(Into::into));
                Message::Completed(wire::Completed { lease, result, log, usage: usage.map(Into::into) })
            }
            FromWorker::Failed { task, epoch, failure, log, usage } => {
                let (lease, failure, log) = (to_lease(task, epoch), Some(failure.into()), log.map(Into::into));
                Message::Failed(wire::Failed { lease, failure, log, usage: usage.map(Into::into) })
            }
            FromWorker::Draining => Message::Draining(wire::Empty {}),
            FromWorker::Available => Message::Available(wire::Empty {}),
        };
        Self { message: Some(message) }
    }
}

impl TryFrom<wire::FromWorker> for FromWorker {
    type Error = ConvertError;

    fn try_from(wire: wire::FromWorker) -> Result<Self, ConvertError> {
        use wire::from_worker::Message;
        Ok(match required("message", wire.message)? {
            Message::Many(_) => return Err(ConvertError::Nested),
            Message::Register(registration) => Self::Register(registration.try_into()?),
            Message::Heartbeat(wire::Heartbeat { number, tasks, spent }) => {
                Self::Heartbeat { number, tasks: convert_all(tasks)?, usage: convert_all(spent)? }
            }
            Message::Completed(completed) => {
                let (task, epoch) = from_lease(completed.lease)?;
                let result = required("completed.result", completed.result)?.try_into()?;
                Self::Completed {
                    task,
                    epoch,
                    result,
                    log: convert_optional(completed.log)?,
                    usage: convert_optional(completed.usage)?,
                }
            }
            Message::Failed(failed) => {
                let (task, epoch) = from_lease(failed.lease)?;
                let failure = required("failed.failure", failed.failure)?.try_into()?;
                Self::Failed {
                    task,
                    epoch,
                    failure,
                    log: convert_optional(failed.log)?,
                    usage: convert_optional(failed.usage)?,
                }
            }
            Message::Draining(_) => Self::Draining,
            Message::Available(_) => Self::Available,
        })
    }
}

impl From<ToWorker> for wire::ToWorker {
    fn from(message: ToWorker) -> Self {
        use wire::to_worker::Message;
        let message = match message {
            ToWorker::Welcome { worker, heartbeat, lease } => {
                Message::Welcome(wire::Welcome { worker: worker.0, heartbeat, lease })
            }
            ToWorker::Renewed { heartbeat, leases, intake } => {
                let leases = leases.into_iter().map(Into::into).collect();
                Message::Renewed(wire::Renewed { heartbeat, leases, intake: wire::Intake::from(intake).into() })
            }
            ToWorker::Job { job, spec } => Message::Job(wire::Job { job: job.0, spec: Some((*spec).into()) }),
            ToWorker::Assign(assignment) => Message::Assign(assignment.into()),
            ToWorker::Revoke { task, epoch, reason } => {
                let reason = match reason {
                    RevokeReason::JobEnded => wire::RevokeReason::JobEnded,
                    RevokeReason::Expired => wire::RevokeReason::Expired,
                    RevokeReason::Done => wire::RevokeReason::Done,
                };
                Message::Revoke(wire::Revoke { lease: to_lease(task, epoch), reason: reason.into() })
            }
            ToWorker::Accepted { task, epoch } => {
                Message::Accepted(wire::Lease { task: Some(task.into()), epoch: epoch.0 })
            }
            ToWorker::Refused { task, epoch, refusal } => {
                Message::Refused(wire::Refused { lease: to_lease(task, epoch), refusal: Some(refusal.into()) })
            }
            ToWorker::Goodbye => Message::Goodbye(wire::Empty {}),
        };
        Self { message: Some(message) }
    }
}

impl TryFrom<wire::ToWorker> for ToWorker {
    type Error = ConvertError;

    fn try_from(wire: wire::ToWorker) -> Result<Self, ConvertError> {
        use wire::to_worker::Message;
        Ok(match required("message", wire.message)? {
            Message::Many(_) => return Err(ConvertError::Nested),
            Message::Welcome(wire::Welcome { worker, heartbeat, lease }) => {
                Self::Welcome { worker: WorkerId(worker), heartbeat, lease }
            }
            Message::Renewed(wire::Renewed { heartbeat, leases, intake }) => {
                // Older coordinators leave this field out.
                let intake = if intake == 0 { Intake::Open } else { parse_intake("renewed.intake", intake)? };
                Self::Renewed { heartbeat, leases: convert_all(leases)?, intake }
            }
            Message::Job(job) => {
                Self::Job { job: JobId(job.job), spec: Box::new(required("job.spec", job.spec)?.try_into()?) }
            }
            Message::Assign(assignment) => Self::Assign(assignment.try_into()?),
            Message::Revoke(revoke) => {
                let (task, epoch) = from_lease(revoke.lease)?;
                Self::Revoke { task, epoch, reason: reason(revoke.reason)? }
            }
            Message::Accepted(lease) => {
                let (task, epoch) = from_lease(Some(lease))?;
                Self::Accepted { task, epoch }
            }
            Message::Refused(refused) => {
                let (task, epoch) = from_lease(refused.lease)?;
                Self::Refused { task, epoch, refusal: required("refused.refusal", refused.refusal)?.try_into()? }
            }
            Message::Goodbye(_) => Self::Goodbye,
        })
    }
}

fn reason(value: i32) -> Result<RevokeReason, ConvertError> {
    let unknown = ConvertError::Unknown { field: "revoke.reason", value };
    Ok(match wire::RevokeReason::try_from(value).map_err(|_| unknown.clone())? {
        wire::RevokeReason::Unspecified => return Err(unknown),
        wire::RevokeReason::JobEnded => RevokeReason::JobEnded,
        wire::RevokeReason::Expired => RevokeReason::Expired,
        wire::RevokeReason::Done => RevokeReason::Done,
    })
}

impl From<Registration> for wire::Registration {
    fn from(registration: Registration) -> Self {
        let Registration { name, instance, engine, threads, slots, tags, held, death: died } = registration;
        let held = held.into_iter().map(Into::into).collect();
        let protocol = femc_fault::pretended_value(femc_fault::PretendedValue::Protocol);
        let protocol = protocol.and_then(|text| text.parse().ok()).unwrap_or(PROTOCOL);
        Self { protocol, name, instance, engine, threads, slots, tags, held, died: died.map(Into::into) }
    }
}

impl TryFrom<wire::Registration> for Registration {
    type Error = ConvertError;

    fn try_from(wire: wire::Registration) -> Result<Self, ConvertError> {
        let wire::Registration { protocol, name, instance, engine, threads, slots, tags, held, died } = wire;
        if !(OLDEST_PROTOCOL..=PROTOCOL).contains(&protocol) {
            return Err(ConvertError::Protocol { found: protocol });
        }
        if slots == 0 || slots > 1024 {
            return Err(ConvertError::Range { field: "registration.slots" });
        }
        let texts = [&name, &engine].into_iter().chain(&tags);
        if tags.len() > JobSpec::MAX_TAGS
            || texts.into_iter().any(|text| text.len() > JobSpec::MAX_NAME || text.contains(char::is_control))
        {
            return Err(ConvertError::Range { field: "registration.name, engine or tags" });
        }
        Ok(Self {
            name,
            instance,
            engine,
            threads,
            slots,
            tags,
            held: convert_all(held)?,
            death: convert_optional(died)?,
        })
    }
}

impl From<Death> for wire::Death {
    fn from(Death { instance, computing }: Death) -> Self {
        Self { instance, computing: computing.into_iter().map(Into::into).collect() }
    }
}

impl TryFrom<wire::Death> for Death {
    type Error = ConvertError;

    fn try_from(wire::Death { instance, computing }: wire::Death) -> Result<Self, ConvertError> {
        if computing.len() > Self::MAX_TASKS {
            return Err(ConvertError::Range { field: "died.computing" });
        }
        Ok(Self { instance, computing: convert_all(computing)? })
    }
}

impl From<HeldLease> for wire::HeldLease {
    fn from(held: HeldLease) -> Self {
        let HeldLease { task, epoch, steps, job } = held;
        Self { lease: to_lease(task, epoch), job: digest_bytes(&job), steps: to_range(&steps) }
    }
}

impl TryFrom<wire::HeldLease> for HeldLease {
    type Error = ConvertError;

    fn try_from(wire: wire::HeldLease) -> Result<Self, ConvertError> {
        let (task, epoch) = from_lease(wire.lease)?;
        let steps = from_range("held.steps", wire.steps)?;
        Ok(Self { task, epoch, steps, job: parse_digest("held.job", &wire.job)? })
    }
}

impl From<LeaseStatus> for wire::LeaseLeft {
    fn from(lease: LeaseStatus) -> Self {
        let LeaseStatus { task, epoch, remaining: left } = lease;
        Self { lease: to_lease(task, epoch), left }
    }
}

impl TryFrom<wire::LeaseLeft> for LeaseStatus {
    type Error = ConvertError;

    fn try_from(wire: wire::LeaseLeft) -> Result<Self, ConvertError> {
        let (task, epoch) = from_lease(wire.lease)?;
        Ok(Self { task, epoch, remaining: wire.left })
    }
}

impl From<TaskProgress> for wire::TaskProgress {
    fn from(progress: TaskProgress) -> Self {
        let TaskProgress { task, epoch, phase, units } = progress;
        let phase = match phase {
            Phase::Waiting => wire::Phase::Waiting,
            Phase::Preparing => wire::Phase::Preparing,
            Phase::Working => wire::Phase::Working,
            Phase::Uploading => wire::Phase::Uploading,
        };
        Self { lease: to_lease(task, epoch), phase: phase.into(), units }
    }
}

impl TryFrom<wire::TaskProgress> for TaskProgress {
    type Error = ConvertError;

    fn try_from(wire: wire::TaskProgress) -> Result<Self, ConvertError> {
        let (task, epoch) = from_lease(wire.lease)?;
        let unknown = ConvertError::Unknown { field: "progress.phase", value: wire.phase };
        let phase = match wire::Phase::try_from(wire.phase).map_err(|_| unknown.clone())? {
            wire::Phase::Unspecified => return Err(unknown),
            wire::Phase::Waiting => Phase::Waiting,
            wire::Phase::Preparing => Phase::Preparing,
            wire::Phase::Working => Phase::Working,
            wire::Phase::Uploading => Phase::Uploading,
        };
        Ok(Self { task, epoch, phase, units: wire.units })
    }
}
