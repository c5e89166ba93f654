//! Failures and refusals. They are enums on both sides, so that no program has to interpret text.

use femc_model::{Failure, JobId, Refusal};

use super::{ConvertError, digest_bytes, parse_digest, required};
use crate::wire;
use wire::failure::{Cause, Killed, Lost, Text};
use wire::refusal::{Field, Forbidden, Lacking, Limit, Reason, Room};

impl From<Failure> for wire::Failure {
    fn from(failure: Failure) -> Self {
        let text = |message| Text { message };
        Self {
            cause: Some(match failure {
                Failure::Scene { message } => Cause::Scene(text(message)),
                Failure::Settings { message } => Cause::Settings(text(message)),
                Failure::Panicked { message } => Cause::Panicked(text(message)),
                Failure::Stalled { seconds } => Cause::Stalled(seconds),
                Failure::LostInputs { digests, message } => {
                    Cause::LostInputs(Lost { digests: digests.iter().map(digest_bytes).collect(), message })
                }
                Failure::Store { message } => Cause::Store(text(message)),
                Failure::Resources { message } => Cause::Resources(text(message)),
                Failure::Cancelled => Cause::Cancelled(wire::Empty {}),
                Failure::Killed { deaths, worker } => Cause::Killed(Killed { deaths, worker }),
                Failure::TooLarge { limit } => Cause::TooLarge(limit),
            }),
        }
    }
}

impl TryFrom<wire::Failure> for Failure {
    type Error = ConvertError;

    fn try_from(wire: wire::Failure) -> Result<Self, ConvertError> {
        Ok(match required("failure.cause", wire.cause)? {
            Cause::Scene(Text { message }) => Self::Scene { message },
            Cause::Settings(Text { message }) => Self::Settings { message },
            Cause::Panicked(Text { message }) => Self::Panicked { message },
            Cause::Stalled(seconds) => Self::Stalled { seconds },
            Cause::LostInputs(Lost { digests, message }) => {
                let digests = digests.iter().map(|bytes| parse_digest("failure.lost_inputs", bytes));
                Self::LostInputs { digests: digests.collect::<Result<_, _>>()?, message }
            }
            Cause::Store(Text { message }) => Self::Store { message },
            Cause::Resources(Text { message }) => Self::Resources { message },
            Cause::Cancelled(_) => Self::Cancelled,
            Cause::Killed(Killed { deaths, worker }) => Self::Killed { deaths, worker },
            Cause::TooLarge(limit) => Self::TooLarge { limit },
        })
    }
}

impl From<Refusal> for wire::Refusal {
    fn from(refusal: Refusal) -> Self {
        Self {
            reason: Some(match refusal {
                Refusal::NoSuchJob { job } => Reason::NoSuchJob(job.0),
                Refusal::Ended { job } => Reason::Ended(job.0),
                Refusal::Invalid { field, message } => Reason::Invalid(Field { field, message }),
                Refusal::StaleEpoch => Reason::StaleEpoch(wire::Empty {}),
                Refusal::NoSuchArtifact { digest } => Reason::NoSuchArtifact(digest_bytes(&digest)),
                Refusal::DigestMismatch { digest } => Reason::DigestMismatch(digest_bytes(&digest)),
                Refusal::TooLarge { what, limit } => Reason::TooLarge(Limit { what, limit }),
                Refusal::MissingArtifacts { digests, count } => {
                    Reason::MissingArtifacts(Lacking { digests: digests.iter().map(digest_bytes).collect(), count })
                }
                Refusal::ArtifactTooLarge { limit } => Reason::ArtifactTooLarge(limit),
                Refusal::Resume { offset } => Reason::Resume(offset),
                Refusal::Unavailable { message } => Reason::Unavailable(message),
                Refusal::NoRoom { place, free } => Reason::NoRoom(Room { place, free }),
                Refusal::Forbidden { who, takes } => Reason::Forbidden(Forbidden { who, takes }),
                Refusal::NoSuchWorker { worker } => Reason::NoSuchWorker(worker),
                Refusal::Unauthenticated { message } => Reason::Unauthenticated(message),
            }),
        }
    }
}

impl TryFrom<wire::Refusal> for Refusal {
    type Error = ConvertError;

    fn try_from(wire: wire::Refusal) -> Result<Self, ConvertError> {
        Ok(match required("refusal.reason", wire.reason)? {
            Reason::NoSuchJob(job) => Self::NoSuchJob { job: JobId(job) },
            Reason::Ended(job) => Self::Ended { job: JobId(job) },
            Reason::Invalid(Field { field, message }) => Self::Invalid { field, message },
            Reason::StaleEpoch(_) => Self::StaleEpoch,
            Reason::NoSuchArtifact(bytes) => Self::NoSuchArtifact { digest: parse_digest("refusal.artifact", &bytes)? },
            Reason::DigestMismatch(bytes) => Self::DigestMismatch { digest: parse_digest("refusal.mismatch", &bytes)? },
            Reason::TooLarge(Limit { what, limit }) => Self::TooLarge { what, limit },
            Reason::MissingArtifacts(Lacking { digests, count }) => {
                let digests =
                    digests.iter().map(|bytes| parse_digest("refusal.missing", bytes)).collect::<Result<_, _>>()?;
                Self::MissingArtifacts { digests, count }
            }
            Reason::ArtifactTooLarge(limit) => Self::ArtifactTooLarge { limit },
            Reason::Resume(offset) => Self::Resume { offset },
            Reason::Unavailable(message) => Self::Unavailable { message },
            Reason::NoRoom(Room { place, free }) => Self::NoRoom { place, free },
            Reason::Forbidden(Forbidden { who, takes }) => Self::Forbidden { who, takes },
            Reason::NoSuchWorker(worker) => Self::NoSuchWorker { worker },
            Reason::Unauthenticated(message) => Self::Unauthenticated { message },
        })
    }
}
