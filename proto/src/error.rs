//! What may go wrong on the way, and refusals as statuses and back.

use femc_model::Refusal;
use prost::Message as _;
use tonic::{Code, Status};

use crate::convert::ConvertError;
use crate::{tls, wire};

/// A call that brought no answer.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The address makes no sense.
    #[error("{url} is no address of a coordinator: {message}")]
    Address {
        /// Address of the coordinator.
        url: String,
        /// What is wrong with it.
        message: String,
    },
    /// The address asks for an identity, and none was given.
    #[error("{url} is encrypted, which takes an identity or a token")]
    NoIdentity {
        /// Address of the coordinator.
        url: String,
    },
    /// A token would cross a network where others can read it.
    #[error("{url} is neither encrypted nor on this machine: the token is not sent there")]
    OpenToken {
        /// Address of the coordinator.
        url: String,
    },
    /// The address is encrypted, and by the token alone the coordinator cannot be known.
    #[error("{url} is encrypted, and the token's file has no certificate of the farm's authority")]
    NoAuthority {
        /// Address of the coordinator.
        url: String,
    },
    /// Nobody answers there, or the connection broke.
    #[error("the coordinator at {url} cannot be reached: {message}")]
    Unreachable {
        /// The address.
        url: String,
        /// Error of the transport.
        message: String,
        /// Cause, as far as the error tells it.
        why: Why,
    },
    /// The coordinator refused the call.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The answer makes no sense.
    #[error("the coordinator's answer makes no sense: {0}")]
    Answer(#[from] ConvertError),
    /// The server failed in another way, or did not understand.
    #[error("the coordinator says {code}: {message}")]
    Status {
        /// gRPC's code.
        code: String,
        /// Message of the server.
        message: String,
    },
}

/// Why a coordinator cannot be reached, as far as the transport tells.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Why {
    /// Nobody is there, the connection broke, or who is there speaks otherwise: [`look`](crate::look) tells.
    #[default]
    Away,
    /// It shows a certificate that the authority of the identity, or of the token, has not issued.
    TheirCertificate,
    /// It does not take the certificate that it was shown.
    OurCertificate,
}

/// A backup that did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// The coordinator.
    #[error(transparent)]
    Call(#[from] CallError),
    /// What it said cannot be kept.
    #[error("the copy cannot be written: {0}")]
    Write(#[from] std::io::Error),
}

/// A server that could not begin or go on.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The transport failed.
    #[error("server: {0}")]
    Transport(#[from] tonic::transport::Error),
    /// The reflection service cannot be built.
    #[error("server reflection: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
    /// The identity cannot be used for TLS.
    #[error("server identity: {0}")]
    Identity(#[from] IdentityError),
}

/// An identity that cannot be used for TLS.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A certificate or the key is not PEM.
    #[error("cannot read a certificate or the key: {0}")]
    Pem(#[from] rustls::pki_types::pem::Error),
    /// The authority's certificate cannot verify clients.
    #[error("cannot verify clients with the authority's certificate: {0}")]
    Authority(#[from] rustls::server::VerifierBuilderError),
    /// TLS refuses the certificate or the key.
    #[error("TLS refuses the certificate or the key: {0}")]
    Tls(#[from] rustls::Error),
}

/// Exhaustive: a new refusal must choose its code.
fn code(refusal: &Refusal) -> Code {
    match refusal {
        Refusal::NoSuchJob { .. } | Refusal::NoSuchArtifact { .. } | Refusal::NoSuchWorker { .. } => Code::NotFound,
        Refusal::Ended { .. } | Refusal::StaleEpoch | Refusal::MissingArtifacts { .. } => Code::FailedPrecondition,
        Refusal::Resume { .. } => Code::OutOfRange,
        Refusal::Invalid { .. } => Code::InvalidArgument,
        Refusal::DigestMismatch { .. } => Code::DataLoss,
        Refusal::TooLarge { .. } | Refusal::ArtifactTooLarge { .. } | Refusal::NoRoom { .. } => Code::ResourceExhausted,
        Refusal::Unavailable { .. } => Code::Unavailable,
        Refusal::Forbidden { .. } => Code::PermissionDenied,
        Refusal::Unauthenticated { .. } => Code::Unauthenticated,
    }
}

pub(crate) fn to_status(refusal: &Refusal) -> Status {
    let details = wire::Refusal::from(refusal.clone()).encode_to_vec();
    Status::with_details(code(refusal), refusal.to_string(), details.into())
}

pub(crate) fn from_status(url: &str, status: &Status) -> CallError {
    if !status.details().is_empty()
        && let Ok(refusal) = wire::Refusal::decode(status.details())
    {
        return refusal.try_into().map_or_else(CallError::Answer, CallError::Refused);
    }
    let message = status.message().to_owned();
    let why = std::error::Error::source(status).map_or(Why::Away, tls::why);
    match status.code() {
        Code::Unavailable | Code::Cancelled | Code::DeadlineExceeded => {
            CallError::Unreachable { url: url.into(), message, why }
        }
        // A connection that breaks within an answer has no code of its own.
        Code::Unknown | Code::Internal if std::error::Error::source(status).is_some() => {
            CallError::Unreachable { url: url.into(), message, why }
        }
        code => CallError::Status { code: format!("{code:?}"), message },
    }
}

impl From<ConvertError> for Status {
    fn from(error: ConvertError) -> Self {
        Self::invalid_argument(error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::tests::refusals;
    use prost_types::FileDescriptorSet;

    /// `NOT_FOUND`
    fn documented(code: Code) -> String {
        let mut out = String::new();
        for c in format!("{code:?}").chars() {
            if c.is_ascii_uppercase() && !out.is_empty() {
                out.push('_');
            }
            out.push(c.to_ascii_uppercase());
        }
        out
    }

    #[test]
    fn a_refusal_s_code_is_the_one_of_its_comment() {
        let all = FileDescriptorSet::decode(wire::DESCRIPTORS).unwrap();
        let file = &all.file[0];
        let at = file.message_type.iter().position(|message| message.name() == "Refusal").unwrap();
        let comment = |number: u32| {
            let field = file.message_type[at].field.iter().position(|field| field.number() == number as i32).unwrap();
            let path = [4, at as i32, 2, field as i32];
            let places = file.source_code_info.iter().flat_map(|info| &info.location);
            places.filter(|place| place.path == path).map(|place| place.leading_comments()).collect::<String>()
        };
        for refusal in refusals() {
            let bytes = wire::Refusal::from(refusal.clone()).encode_to_vec();
            let (number, _) = prost::encoding::decode_key(&mut &bytes[..]).unwrap();
            let (comment, code) = (comment(number), documented(code(&refusal)));
            let is_documented = comment.contains(&format!("Status {code}."));
            // No call is answered by it.
            assert!(is_documented != (refusal == Refusal::StaleEpoch), "{refusal}: {code}, not {comment}");
        }
    }
}
