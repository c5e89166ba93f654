//! Errors of calls, and the conversion of refusals to and from gRPC statuses.

use femc_model::Refusal;
use prost::Message as _;
use tonic::{Code, Status};

use crate::convert::ConvertError;
use crate::{tls, wire};

/// A failed call.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The address is invalid.
    #[error("invalid coordinator address {url}: {message}")]
    Address {
        /// Address of the coordinator.
        url: String,
        /// Description of the error.
        message: String,
    },
    /// The address is encrypted and needs an identity or a token, but neither was given.
    #[error("{url} is encrypted and requires an identity or a token")]
    NoIdentity {
        /// Address of the coordinator.
        url: String,
    },
    /// The token would cross a network on which others can read it.
    #[error("the token is not sent to {url}: the address is not encrypted and not on this machine")]
    InsecureToken {
        /// Address of the coordinator.
        url: String,
    },
    /// The address is encrypted, but the token's file has no certificate to verify the coordinator with.
    #[error("{url} is encrypted, but the token file has no certificate of the farm's authority")]
    NoAuthority {
        /// Address of the coordinator.
        url: String,
    },
    /// The address does not answer, or the connection broke.
    #[error("the coordinator at {url} cannot be reached: {message}")]
    Unreachable {
        /// Address of the coordinator.
        url: String,
        /// Error of the transport.
        message: String,
        /// Cause, if the error reveals it.
        cause: UnreachableCause,
    },
    /// The coordinator refused the call.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The coordinator's answer is invalid.
    #[error("invalid answer from the coordinator: {0}")]
    Answer(#[from] ConvertError),
    /// The server failed in another way, or did not understand the call.
    #[error("the coordinator answered {code}: {message}")]
    Status {
        /// gRPC status code.
        code: String,
        /// Message of the server.
        message: String,
    },
}

/// Cause why a coordinator cannot be reached, if the transport reveals it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum UnreachableCause {
    /// The address does not answer, the connection broke, or the server speaks another protocol; [`probe_address`](crate::probe_address)
    /// distinguishes them.
    #[default]
    Connection,
    /// The server's certificate was not issued by the authority of the identity or token.
    ServerCertificate,
    /// The server rejects the client's certificate.
    ClientCertificate,
}

/// Error of a backup.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// The call failed.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The copy cannot be written.
    #[error("cannot write the backup: {0}")]
    Write(#[from] std::io::Error),
}

/// Error of a server that cannot start or continue.
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

/// Error of an identity that cannot be used for TLS.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A certificate or the key is not valid PEM.
    #[error("cannot read a certificate or the key: {0}")]
    Pem(#[from] rustls::pki_types::pem::Error),
    /// The authority's certificate cannot verify clients.
    #[error("cannot verify clients with the authority's certificate: {0}")]
    Authority(#[from] rustls::server::VerifierBuilderError),
    /// TLS refuses the certificate or the key.
    #[error("TLS rejects the certificate or the key: {0}")]
    Tls(#[from] rustls::Error),
}

/// Returns the gRPC code of a refusal. The match is exhaustive, so a new refusal must choose its code.
fn grpc_code(refusal: &Refusal) -> Code {
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
    Status::with_details(grpc_code(refusal), refusal.to_string(), details.into())
}

pub(crate) fn from_status(url: &str, status: &Status) -> CallError {
    if !status.details().is_empty()
        && let Ok(refusal) = wire::Refusal::decode(status.details())
    {
        return refusal.try_into().map_or_else(CallError::Answer, CallError::Refused);
    }
    let message = status.message().to_owned();
    let cause = std::error::Error::source(status).map_or(UnreachableCause::Connection, tls::unreachable_cause);
    match status.code() {
        Code::Unavailable | Code::Cancelled | Code::DeadlineExceeded => {
            CallError::Unreachable { url: url.into(), message, cause }
        }
        // A connection that breaks within an answer has no gRPC code of its own.
        Code::Unknown | Code::Internal if std::error::Error::source(status).is_some() => {
            CallError::Unreachable { url: url.into(), message, cause }
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

    /// Returns the code as the .proto writes it, such as `NOT_FOUND`.
    fn proto_code_name(code: Code) -> String {
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
            let (comment, code) = (comment(number), proto_code_name(grpc_code(&refusal)));
            let is_documented = comment.contains(&format!("Status {code}."));
            // `StaleEpoch` is not the answer of any call, so it has no documented status.
            assert!(is_documented != (refusal == Refusal::StaleEpoch), "{refusal}: {code}, not {comment}");
        }
    }
}
