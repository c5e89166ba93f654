//! Decoders for every message of the wire, for fuzzing. The generated types stay private.

use femc_model::{
    Artifact, AttemptRecord, Crew, Drain, FrameParts, FrameRecord, FromWorker, JobSpec, JobStatus, LogRecord,
    OwnerUsage, Refusal, ToWorker, WorkerName,
};
use prost::Message;

use crate::JobShape;
use crate::convert::{ConvertError, collect_mode, digest, need};
use crate::many::Many;
use crate::server::Collected;
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
fn there_and_back<W, M>(wire: W) -> bool
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

fn each<W, M>(all: Vec<W>) -> bool
where
    W: Message + Default + From<M>,
    M: TryFrom<W, Error = ConvertError>,
{
    // Check all elements, also those behind an invalid one.
    let senseless = all.into_iter().map(there_and_back::<W, M>).filter(|is_good| !is_good).count();
    senseless == 0
}

fn are_digests(all: &[Vec<u8>]) -> bool {
    all.iter().all(|bytes| digest("digest", bytes).is_ok())
}

/// Splits a message into its batch, like a session.
fn messages<W, M>(wire: W) -> bool
where
    W: Many + Default + From<M>,
    M: TryFrom<W, Error = ConvertError>,
{
    match wire.split() {
        Ok(many) => each::<W, M>(many),
        Err(one) => there_and_back::<W, M>(one),
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
    SubmitRequest => |wire| need("job", wire.job).is_ok_and(there_and_back::<_, JobSpec>);
    SubmitReply => |_| true;
    ListRequest => |_| true;
    ListReply => |wire| each::<_, JobStatus>(wire.jobs);
    StatusRequest => |_| true;
    JobStatus => there_and_back::<_, JobStatus>;
    WatchRequest => |_| true;
    ControlRequest => |wire| {
        need("control", wire.control).and_then(femc_model::Control::try_from).is_ok()
    };
    ControlReply => |_| true;
    FramesRequest => |_| true;
    FramesReply => |wire| each::<_, FrameRecord>(wire.frames);
    PartsRequest => |_| true;
    PartsReply => |wire| each::<_, FrameParts>(wire.frames);
    LogsRequest => |_| true;
    LogsReply => |wire| each::<_, LogRecord>(wire.logs);
    AttemptsRequest => |_| true;
    AttemptsReply => |wire| match wire.part {
        Some(wire::attempts_reply::Part::Job(job)) => there_and_back::<_, JobShape>(job),
        Some(wire::attempts_reply::Part::Attempts(page)) => each::<_, AttemptRecord>(page.attempts),
        None => false,
    };
    BackupRequest => |_| true;
    BackupReply => |wire| match wire.part {
        Some(wire::backup_reply::Part::Artifacts(some)) => each::<_, Artifact>(some.artifacts),
        Some(wire::backup_reply::Part::Log(_)) => true,
        None => false,
    };
    UsageRequest => |_| true;
    // Seconds travel as doubles, so sums beyond 2^53 microseconds are rounded.
    UsageReply => |wire| wire.usage.into_iter().all(|usage| OwnerUsage::try_from(usage).is_ok());
    ListWorkersRequest => |_| true;
    ListWorkersReply => there_and_back::<_, Crew>;
    DrainWorkersRequest => there_and_back::<_, (WorkerName, Drain)>;
    DrainWorkersReply => |_| true;
    FromWorker => messages::<_, FromWorker>;
    ToWorker => messages::<_, ToWorker>;
    MissingRequest => |wire| are_digests(&wire.digests);
    MissingReply => |wire| are_digests(&wire.digests);
    OfferRequest => |wire| digest("digest", &wire.digest).is_ok();
    OfferReply => |wire| wire.answer.is_some();
    PutRequest => |wire| match wire.part {
        Some(wire::put_request::Part::Digest(bytes)) => digest("digest", &bytes).is_ok(),
        Some(wire::put_request::Part::Piece(_)) => true,
        None => false,
    };
    PutReply => |wire| need("artifact", wire.artifact).is_ok_and(there_and_back::<_, Artifact>);
    GetRequest => |wire| digest("digest", &wire.digest).is_ok();
    GetReply => |_| true;
    CollectRequest => |wire| collect_mode(wire.mode).is_ok();
    CollectReply => there_and_back::<_, Collected>;
    Refusal => there_and_back::<_, Refusal>;
};
