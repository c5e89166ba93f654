//! Decoders for every message of the wire, for fuzzing. The generated types stay private.

use femc_model::{
    Artifact, AttemptRecord, Drain, FrameParts, FrameRecord, FromWorker, JobSpec, JobStatus, LogRecord, OwnerUsage,
    Refusal, ToWorker, WorkerList, WorkerSelector,
};
use prost::Message;

use crate::JobShape;
use crate::batch::Batch;
use crate::convert::{ConvertError, collect_mode, parse_digest, required};
use crate::server::CollectReport;
use crate::wire;

/// Descriptors of all messages: a `FileDescriptorSet`.
pub const DESCRIPTORS: &[u8] = wire::DESCRIPTORS;

/// A decoder of one message type.
#[derive(Debug, Clone, Copy)]
pub struct Decoder {
    /// Name of the message in `femc.v1`.
    pub message: &'static str,
    /// Checks that bytes are a valid message of this type.
    /// - panics: if the decoded message changes when it is encoded and decoded again.
    pub decode: fn(&[u8]) -> bool,
}

/// Decodes a message, encodes it, decodes it again, and checks that nothing changed.
fn round_trips<W, M>(wire: W) -> bool
where
    W: Message + Default + From<M>,
    M: TryFrom<W, Error = ConvertError>,
{
    let Ok(model) = M::try_from(wire) else { return false };
    let sent = W::from(model).encode_to_vec();
    let received = W::decode(&sent[..]).map(M::try_from);
    let Ok(Ok(model)) = received else { panic!("cannot decode the forwarded message") };
    assert_eq!(W::from(model).encode_to_vec(), sent, "the forwarded message differs");
    true
}

fn all_round_trip<W, M>(all: Vec<W>) -> bool
where
    W: Message + Default + From<M>,
    M: TryFrom<W, Error = ConvertError>,
{
    // Check all elements, also those behind an invalid one.
    let invalid = all.into_iter().map(round_trips::<W, M>).filter(|is_good| !is_good).count();
    invalid == 0
}

fn are_digests(all: &[Vec<u8>]) -> bool {
    all.iter().all(|bytes| parse_digest("digest", bytes).is_ok())
}

/// Splits a message into its batch, like a session.
fn batch_round_trips<W, M>(wire: W) -> bool
where
    W: Batch + Default + From<M>,
    M: TryFrom<W, Error = ConvertError>,
{
    match wire.split() {
        Ok(many) => all_round_trip::<W, M>(many),
        Err(one) => round_trips::<W, M>(one),
    }
}

macro_rules! decoders {
    ($($message:ident => $understand:expr;)*) => {
        &[$(Decoder {
            message: stringify!($message),
            decode: |bytes| {
                let understand: fn(wire::$message) -> bool = $understand;
                wire::$message::decode(bytes).is_ok_and(understand)
            },
        }),*]
    };
}

/// Decoders of every request and reply message, and of the refusals in statuses.
pub const DECODERS: &[Decoder] = decoders! {
    SubmitRequest => |wire| required("job", wire.job).is_ok_and(round_trips::<_, JobSpec>);
    SubmitReply => |_| true;
    ListRequest => |_| true;
    ListReply => |wire| all_round_trip::<_, JobStatus>(wire.jobs);
    StatusRequest => |_| true;
    JobStatus => round_trips::<_, JobStatus>;
    WatchRequest => |_| true;
    ControlRequest => |wire| {
        required("control", wire.control).and_then(femc_model::Control::try_from).is_ok()
    };
    ControlReply => |_| true;
    FramesRequest => |_| true;
    FramesReply => |wire| all_round_trip::<_, FrameRecord>(wire.frames);
    PartsRequest => |_| true;
    PartsReply => |wire| all_round_trip::<_, FrameParts>(wire.frames);
    LogsRequest => |_| true;
    LogsReply => |wire| all_round_trip::<_, LogRecord>(wire.logs);
    AttemptsRequest => |_| true;
    AttemptsReply => |wire| match wire.part {
        Some(wire::attempts_reply::Part::Job(job)) => round_trips::<_, JobShape>(job),
        Some(wire::attempts_reply::Part::Attempts(page)) => all_round_trip::<_, AttemptRecord>(page.attempts),
        None => false,
    };
    BackupRequest => |_| true;
    BackupReply => |wire| match wire.part {
        Some(wire::backup_reply::Part::Artifacts(some)) => all_round_trip::<_, Artifact>(some.artifacts),
        Some(wire::backup_reply::Part::Log(_)) => true,
        None => false,
    };
    UsageRequest => |_| true;
    // Seconds travel as doubles, so sums beyond 2^53 microseconds are rounded.
    UsageReply => |wire| wire.usage.into_iter().all(|usage| OwnerUsage::try_from(usage).is_ok());
    ListWorkersRequest => |_| true;
    ListWorkersReply => round_trips::<_, WorkerList>;
    DrainWorkersRequest => round_trips::<_, (WorkerSelector, Drain)>;
    DrainWorkersReply => |_| true;
    FromWorker => batch_round_trips::<_, FromWorker>;
    ToWorker => batch_round_trips::<_, ToWorker>;
    MissingRequest => |wire| are_digests(&wire.digests);
    MissingReply => |wire| are_digests(&wire.digests);
    OfferRequest => |wire| parse_digest("digest", &wire.digest).is_ok();
    OfferReply => |wire| wire.answer.is_some();
    PutRequest => |wire| match wire.part {
        Some(wire::put_request::Part::Digest(bytes)) => parse_digest("digest", &bytes).is_ok(),
        Some(wire::put_request::Part::Piece(_)) => true,
        None => false,
    };
    PutReply => |wire| required("artifact", wire.artifact).is_ok_and(round_trips::<_, Artifact>);
    GetRequest => |wire| parse_digest("digest", &wire.digest).is_ok();
    GetReply => |_| true;
    CollectRequest => |wire| collect_mode(wire.mode).is_ok();
    CollectReply => round_trips::<_, CollectReport>;
    Refusal => round_trips::<_, Refusal>;
};

/// Decodes the job of an encoded `SubmitRequest`.
pub fn decode_submission(bytes: &[u8]) -> Option<JobSpec> {
    wire::SubmitRequest::decode(bytes).ok()?.job?.try_into().ok()
}
