//! Tests of a client with lying servers, and of its retry time.

use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex};

use tokio_stream::wrappers::{ReceiverStream, UnboundedReceiverStream};
use tokio_stream::{Stream, StreamExt as _};
use tonic::{Code, Request, Response, Status, Streaming};

use super::*;
use crate::{ByteStream, Dialer, UnreachableCause};
use wire::artifacts_server::{Artifacts, ArtifactsServer};

type Replies = Pin<Box<dyn Stream<Item = Result<wire::GetReply, Status>> + Send>>;

/// A server with scripted answers.
#[derive(Default)]
struct ScriptedServer {
    /// Scripted replies to download requests, in order: pieces, and the code with which the transfer is cut. The last reply is
    /// repeated.
    downloads: Vec<(Vec<Bytes>, Option<Code>)>,
    /// Answer to an offer: the first byte wanted; `None`: the artifact is in the store.
    wanted_offset: Option<u64>,
    /// Answer to an upload: the artifact kept.
    stored: Option<Artifact>,
    missing: Vec<Digest>,
    requests: Mutex<ReceivedRequests>,
}

/// Requests and uploads that the server received.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct ReceivedRequests {
    /// First byte wanted and size expected, for each download request.
    downloads: Vec<(u64, Option<u64>)>,
    /// First byte and bytes, for each upload.
    uploads: Vec<(u64, Vec<u8>)>,
}

#[tonic::async_trait]
impl Artifacts for Arc<ScriptedServer> {
    async fn missing(&self, _: Request<wire::MissingRequest>) -> Result<Response<wire::MissingReply>, Status> {
        Ok(Response::new(wire::MissingReply { digests: self.missing.iter().map(digest_bytes).collect() }))
    }

    async fn offer(&self, _: Request<wire::OfferRequest>) -> Result<Response<wire::OfferReply>, Status> {
        let answer = self.wanted_offset.map_or(Answer::There(wire::Empty {}), Answer::From);
        Ok(Response::new(wire::OfferReply { answer: Some(answer) }))
    }

    async fn put(&self, request: Request<Streaming<wire::PutRequest>>) -> Result<Response<wire::PutReply>, Status> {
        let (mut parts, mut from, mut bytes) = (request.into_inner(), 0, Vec::new());
        while let Some(wire::PutRequest { part, offset }) = parts.message().await? {
            match part.unwrap() {
                Part::Digest(_) => from = offset,
                Part::Piece(piece) => bytes.extend_from_slice(&piece),
            }
        }
        self.requests.lock().unwrap().uploads.push((from, bytes));
        Ok(Response::new(wire::PutReply { artifact: self.stored.map(Into::into) }))
    }

    type GetStream = Replies;

    async fn get(&self, request: Request<wire::GetRequest>) -> Result<Response<Replies>, Status> {
        let wire::GetRequest { offset, bytes, .. } = request.into_inner();
        let number = {
            let got = &mut self.requests.lock().unwrap().downloads;
            got.push((offset, bytes));
            got.len()
        };
        let (pieces, ends) = self.downloads[number.min(self.downloads.len()) - 1].clone();
        let pieces = pieces.into_iter().map(|piece| Ok(wire::GetReply { piece }));
        let ends = ends.map(|code| Err(Status::new(code, "cut")));
        Ok(Response::new(Box::pin(tokio_stream::iter(pieces.chain(ends)))))
    }

    async fn collect(&self, _: Request<wire::CollectRequest>) -> Result<Response<wire::CollectReply>, Status> {
        Err(Status::unimplemented("this store does not delete"))
    }
}

/// Returns a client of a server in this process.
async fn client(server: impl Artifacts) -> Client {
    let (send, connections) = tokio::sync::mpsc::unbounded_channel();
    let server = ArtifactsServer::new(server);
    let connections = UnboundedReceiverStream::new(connections).map(Ok::<_, io::Error>);
    tokio::spawn(tonic::transport::Server::builder().add_service(server).serve_with_incoming(connections));
    let dial = Dialer::from_fn(move |_, _| {
        let (ours, theirs) = tokio::io::duplex(1 << 16);
        let sent = send.send(ByteStream::new(theirs)).map_err(|_| io::ErrorKind::ConnectionRefused.into());
        Box::pin(async move { sent.map(|()| ByteStream::new(ours)) })
    });
    Client::connect_with(&dial, "http://farm:1").await.unwrap()
}

/// Returns a client of a server that sends exactly these pieces.
async fn client_receiving(pieces: &[&'static [u8]]) -> Client {
    let pieces = pieces.iter().copied().map(Bytes::from_static).collect();
    client(Arc::new(ScriptedServer { downloads: vec![(pieces, None)], ..ScriptedServer::default() })).await
}

const CONTENT: &[u8] = b"the light of a tile";

fn is_mismatch(outcome: &Result<Bytes, CallError>, of: &Digest) -> bool {
    matches!(outcome, Err(CallError::Refused(Refusal::DigestMismatch { digest })) if digest == of)
}

#[tokio::test(start_paused = true)]
async fn bytes_that_mismatch_digest_are_refused_at_any_size() {
    let artifact = Artifact::from_bytes(CONTENT);
    for pieces in [&[CONTENT][..], &[b"the light ", b"of a tile"], &[b"", b"the light of a til", b"", b"e"]] {
        let client = client_receiving(pieces).await;
        assert_eq!(client.get(&artifact.digest, 1_000).await.unwrap(), CONTENT);
        assert_eq!(client.get(&artifact.digest, artifact.bytes).await.unwrap(), CONTENT, "as many as the limit");
        assert_eq!(client.get_exactly(&artifact).await.unwrap(), CONTENT);
    }
    let lies: [&[&'static [u8]]; 10] = [
        &[],
        &[b""],
        &[b"t"],
        &[b"the light of a til"],
        &[b"he light of a tile"],
        &[b"the light of a tilE"],
        &[b"The light of a tile"],
        &[b"of a tile", b"the light "],
        &[b"the light of a tile", b"\0"],
        &[CONTENT, CONTENT],
    ];
    for pieces in lies {
        let client = client_receiving(pieces).await;
        for outcome in [client.get(&artifact.digest, 1_000).await, client.get_exactly(&artifact).await] {
            assert!(is_mismatch(&outcome, &artifact.digest), "{pieces:?}: {outcome:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn bytes_of_unexpected_size_are_refused_despite_right_digest() {
    let Artifact { digest, bytes } = Artifact::from_bytes(CONTENT);
    for known in [0, 1, bytes - 1, bytes + 1, 1 << 40, u64::MAX] {
        let server =
            Arc::new(ScriptedServer { downloads: vec![(vec![CONTENT.into()], None)], ..ScriptedServer::default() });
        let outcome = client(server.clone()).await.get_exactly(&Artifact { digest, bytes: known }).await;
        assert!(is_mismatch(&outcome, &digest), "{known} bytes: {outcome:?}");
        let heard = server.requests.lock().unwrap().clone();
        assert_eq!(heard.downloads, [(0, Some(known))], "a damaged artifact is requested only once");
    }
    // An empty artifact, too.
    let nothing = Artifact::from_bytes(b"");
    assert_eq!(client_receiving(&[]).await.get_exactly(&nothing).await.unwrap(), "");
    let outcome = client_receiving(&[]).await.get_exactly(&Artifact { bytes: 1, ..nothing }).await;
    assert!(is_mismatch(&outcome, &nothing.digest), "{outcome:?}");
}

#[tokio::test(start_paused = true)]
async fn no_more_is_taken_in_than_the_limit_however_much_comes() {
    /// A server that sends pieces for as long as the client reads.
    struct EndlessServer;

    #[tonic::async_trait]
    impl Artifacts for EndlessServer {
        async fn missing(&self, _: Request<wire::MissingRequest>) -> Result<Response<wire::MissingReply>, Status> {
            Err(Status::unimplemented(""))
        }

        async fn offer(&self, _: Request<wire::OfferRequest>) -> Result<Response<wire::OfferReply>, Status> {
            Err(Status::unimplemented(""))
        }

        async fn put(&self, _: Request<Streaming<wire::PutRequest>>) -> Result<Response<wire::PutReply>, Status> {
            Err(Status::unimplemented(""))
        }

        type GetStream = Replies;

        async fn get(&self, _: Request<wire::GetRequest>) -> Result<Response<Replies>, Status> {
            let (send, receive) = tokio::sync::mpsc::channel(1);
            tokio::spawn(async move { while send.send(Ok(wire::GetReply { piece: CONTENT.into() })).await.is_ok() {} });
            Ok(Response::new(Box::pin(ReceiverStream::new(receive))))
        }

        async fn collect(&self, _: Request<wire::CollectRequest>) -> Result<Response<wire::CollectReply>, Status> {
            Err(Status::unimplemented(""))
        }
    }

    let artifact = Artifact::from_bytes(CONTENT);
    let client = client(EndlessServer).await;
    for limit in [0, artifact.bytes, 10 * artifact.bytes - 1] {
        let outcome = client.get(&artifact.digest, limit).await;
        let is_refused =
            matches!(outcome, Err(CallError::Refused(Refusal::ArtifactTooLarge { limit: told })) if told == limit);
        assert!(is_refused, "{limit} bytes: {outcome:?}");
    }
    let outcome = client.get_exactly(&artifact).await;
    assert!(is_mismatch(&outcome, &artifact.digest), "{outcome:?}");
}

#[tokio::test(start_paused = true)]
async fn a_transfer_that_was_cut_is_checked_as_a_whole() {
    let artifact = Artifact::from_bytes(CONTENT);
    let (first, rest) = CONTENT.split_at(10);
    let cut = (vec![Bytes::from_static(first)], Some(Code::Unavailable));
    for (second, is_right) in
        [(rest, true), (CONTENT, false), (first, false), (&rest[1..], false), (b"of a tale", false)]
    {
        let gives = vec![cut.clone(), (vec![Bytes::from_static(second)], None)];
        let server = Arc::new(ScriptedServer { downloads: gives, ..ScriptedServer::default() });
        let outcome = client(server.clone()).await.get(&artifact.digest, 1_000).await;
        match is_right {
            true => assert_eq!(outcome.unwrap(), CONTENT),
            false => assert!(is_mismatch(&outcome, &artifact.digest), "{second:?}: {outcome:?}"),
        }
        assert_eq!(
            server.requests.lock().unwrap().downloads,
            [(0, None), (10, None)],
            "the transfer resumes at its byte"
        );
    }
}

#[tokio::test(start_paused = true)]
async fn put_fails_if_server_kept_another_artifact() {
    let artifact = Artifact::from_bytes(CONTENT);
    let others = [
        Artifact::from_bytes(b"the light of a tale"),
        Artifact { bytes: artifact.bytes + 1, ..artifact },
        Artifact { bytes: artifact.bytes - 1, ..artifact },
        Artifact { bytes: 0, ..artifact },
    ];
    for kept in others {
        let server =
            Arc::new(ScriptedServer { wanted_offset: Some(0), stored: Some(kept), ..ScriptedServer::default() });
        let outcome = client(server).await.put(CONTENT.into()).await;
        let is_refused = matches!(&outcome, Err(CallError::Refused(Refusal::DigestMismatch { digest })) if *digest == artifact.digest);
        assert!(is_refused, "{kept:?}: {outcome:?}");
    }
    let mute = Arc::new(ScriptedServer { wanted_offset: Some(0), stored: None, ..ScriptedServer::default() });
    assert!(matches!(client(mute).await.put(CONTENT.into()).await, Err(CallError::Answer(_))));
}

#[tokio::test(start_paused = true)]
async fn upload_starts_at_wanted_offset_or_at_zero_if_past_end() {
    let artifact = Artifact::from_bytes(CONTENT);
    for (wants, from) in [(0, 0), (7, 7), (18, 18), (19, 19), (20, 0), (u64::MAX, 0)] {
        let server = Arc::new(ScriptedServer {
            wanted_offset: Some(wants),
            stored: Some(artifact),
            ..ScriptedServer::default()
        });
        assert_eq!(client(server.clone()).await.put(CONTENT.into()).await.unwrap(), artifact);
        let put = server.requests.lock().unwrap().uploads.clone();
        assert_eq!(put, [(from, CONTENT[from as usize..].to_vec())], "from {wants} on");
    }
    let has_it = Arc::new(ScriptedServer::default());
    assert_eq!(client(has_it.clone()).await.put(CONTENT.into()).await.unwrap(), artifact);
    assert_eq!(*has_it.requests.lock().unwrap(), ReceivedRequests::default());
    // The artifact is longer than two pieces and not a multiple of a piece.
    let large: Bytes = (0..2 * MAX_PIECE_SIZE + 3).map(|at| (at / 251) as u8).collect();
    let server = Arc::new(ScriptedServer {
        wanted_offset: Some(5),
        stored: Some(Artifact::from_bytes(&large)),
        ..ScriptedServer::default()
    });
    client(server.clone()).await.put(large.clone()).await.unwrap();
    assert!(server.requests.lock().unwrap().uploads == [(5, large[5..].to_vec())]);
}

#[tokio::test(start_paused = true)]
async fn only_offered_artifacts_are_sent_though_server_misses_others() {
    let all = ["one", "two", "one", "three"].map(Bytes::from);
    let missing = [&all[0], &all[3], &Bytes::from_static(b"four")].map(|bytes| Digest::compute(bytes)).to_vec();
    let server = Arc::new(ScriptedServer { missing, ..ScriptedServer::default() });
    assert_eq!(client(server).await.put_all(&all).await.unwrap(), 8, "one and three, once");
}

#[tokio::test(start_paused = true)]
async fn cut_long_transfer_resumes_and_transfer_without_progress_ends() {
    let cut = || CallError::Unreachable {
        url: "http://farm".into(),
        message: "cut".into(),
        cause: UnreachableCause::Connection,
    };
    let mut patience = RetryState::new(Direction::Up);
    for reached in 1..=3 {
        patience.advance_to(reached);
        // The transfer works for a minute before it is cut.
        tokio::time::sleep(Duration::from_secs(60)).await;
        patience.wait_before_retry(cut()).await.unwrap();
    }
    let begun = Instant::now();
    while patience.wait_before_retry(cut()).await.is_ok() {}
    assert!(begun.elapsed() <= RetryState::MAX_STALL);
}

#[tokio::test(start_paused = true)]
async fn an_upload_that_another_gets_on_with_is_not_given_up() {
    let resume = |offset| CallError::Refused(Refusal::Resume { offset });
    let mut patience = RetryState::new(Direction::Up);
    for offset in 1..=3 {
        patience.wait_before_retry(resume(offset)).await.unwrap();
        // The client waited for the other sender, which was cut again.
        tokio::time::sleep(RetryState::MAX_STALL).await;
    }
    patience.wait_before_retry(resume(3)).await.expect_err("nobody gets on");
}

#[tokio::test(start_paused = true)]
async fn wrong_bytes_of_earlier_sender_do_not_spoil_upload() {
    let digest = Digest::compute(b"bytes of this sender");
    let mismatch = || CallError::Refused(Refusal::DigestMismatch { digest });
    let mut patience = RetryState::new(Direction::Up);
    patience.wait_before_retry(mismatch()).await.expect_err("all bytes were its own");
    patience.advance_to(100);
    patience.wait_before_retry(mismatch()).await.expect("the other's bytes are forgotten");
    let mut patience = RetryState::new(Direction::Down);
    patience.advance_to(100);
    patience.wait_before_retry(mismatch()).await.expect_err("it is damaged, however often one asks");
}
