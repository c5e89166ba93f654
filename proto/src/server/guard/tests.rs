//! Tests every role against every call, over real encrypted connections, with certificates and tokens.

use std::collections::BTreeSet;
use std::net::SocketAddr;

use bytes::{Buf as _, BufMut as _};
use femc_service::Gate;
use femc_store::Store;
use femc_trust::{Authority, CertificateRequest, Holder, Identity, RevocationList, Role, TokenFile, Tokens};
use prost::Message as _;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::transport::ClientTlsConfig;
use tonic::transport::server::TcpIncoming;
use tonic::{Code, Request, Status};

use crate::{AccessControl, CallError, Client, Dialer, Limits, Server, tls, wire};
use femc_model::Refusal;

const HOLDERS: [&str; 6] = ["coordinator", "worker", "viewer", "submitter", "operator", "admin"];

/// Allowed calls of each role.
const ALLOWED_ROLES: [(&str, &[&str]); 19] = [
    ("Jobs/Submit", &["submitter", "operator", "admin"]),
    ("Jobs/List", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Status", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Watch", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Control", &["submitter", "operator", "admin"]),
    ("Jobs/Frames", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Parts", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Logs", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Attempts", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Usage", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/ListWorkers", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/DrainWorkers", &["operator", "admin"]),
    ("Jobs/Backup", &["admin"]),
    ("Workers/Session", &["worker"]),
    ("Artifacts/Missing", &["worker", "viewer", "submitter", "operator", "admin"]),
    ("Artifacts/Offer", &["worker", "submitter", "operator", "admin"]),
    ("Artifacts/Put", &["worker", "submitter", "operator", "admin"]),
    ("Artifacts/Get", &["worker", "viewer", "submitter", "operator", "admin"]),
    ("Artifacts/Collect", &["admin"]),
];

/// A server without a coordinator: every call that passes the guard fails with "unavailable".
struct TestServer {
    folder: tempfile::TempDir,
    authority: Authority,
    address: SocketAddr,
}

impl TestServer {
    async fn start() -> Self {
        Self::with_limits(Limits::default()).await
    }

    async fn with_limits(limits: Limits) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::init(folder.path(), "farm").unwrap();
        let identity = issue(&authority, "coordinator", 1);
        let revoked = Some(RevocationList::open(authority.revocation_list_path()).unwrap());
        std::fs::write(authority.tokens_path(), "").unwrap();
        let tokens = Some(Tokens::open(authority.tokens_path()).unwrap());
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (calls, _) = mpsc::channel(1);
        let entrance = AccessControl { identity: Some(identity), revoked, tokens, logins: None };
        let server = Server::new(calls, Store::in_memory()).with_access_control(Some(entrance)).with_limits(limits);
        tokio::spawn(server.serve(TcpIncoming::from(listener), std::future::pending()));
        Self { folder, authority, address }
    }

    fn url(&self) -> String {
        format!("https://{}", self.address)
    }

    async fn client_with_identity(&self, identity: Identity) -> Result<Client, CallError> {
        Client::connect_with(&Dialer::tcp().with_identity(identity), &self.url()).await
    }

    async fn client_with_token(&self, pass: TokenFile) -> Result<Client, CallError> {
        Client::connect_with(&Dialer::tcp().with_token(pass), &self.url()).await
    }

    /// Returns the status of a `List` call with this authorization header, which need not be a token.
    async fn list_status(&self, authorization: &str) -> Status {
        let authority = issue(&self.authority, "viewer", 1);
        let tls = tls::client_config_without_certificate(authority.authority());
        call_status(&self.url(), tls, Some(authorization), "Jobs/List").await
    }
}

/// Checks that the call passed the guard; behind it, no coordinator answers.
fn passed_guard<T>(answer: &Result<T, CallError>) -> bool {
    matches!(answer, Err(CallError::Refused(Refusal::Unavailable { .. })))
}

fn holder(kind: &str) -> Holder {
    let name = format!("a-{kind}");
    match kind {
        "coordinator" => Holder::Coordinator { name },
        "worker" => Holder::Worker { name },
        role => Holder::User { name, role: role.parse().unwrap() },
    }
}

fn issue(authority: &Authority, kind: &str, days: u32) -> Identity {
    authority.issue(&CertificateRequest { holder: holder(kind), hosts: vec![], days }).unwrap()
}

/// A codec that passes bytes unchanged.
#[derive(Debug, Default, Clone, Copy)]
struct RawCodec;

impl Codec for RawCodec {
    type Encode = Vec<u8>;
    type Decode = Vec<u8>;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        *self
    }

    fn decoder(&mut self) -> Self {
        *self
    }
}

impl Encoder for RawCodec {
    type Item = Vec<u8>;
    type Error = Status;

    fn encode(&mut self, item: Vec<u8>, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put_slice(&item);
        Ok(())
    }
}

impl Decoder for RawCodec {
    type Item = Vec<u8>;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Vec<u8>>, Status> {
        let bytes = buffer.chunk().to_vec();
        buffer.advance(bytes.len());
        Ok(Some(bytes))
    }
}

/// Returns the status of a call with an empty message.
async fn call_status(url: &str, tls: ClientTlsConfig, authorization: Option<&str>, call: &str) -> Status {
    let endpoint = tonic::transport::Endpoint::from_shared(url.to_owned()).unwrap().tls_config(tls).unwrap();
    let mut grpc = tonic::client::Grpc::new(endpoint.connect().await.unwrap());
    grpc.ready().await.unwrap();
    let path = format!("/femc.v1.{call}").parse().unwrap();
    let mut request = Request::new(tokio_stream::once(Vec::new()));
    if let Some(text) = authorization {
        request.metadata_mut().insert("authorization", text.parse().unwrap());
    }
    let answer = grpc.streaming(request, path, RawCodec).await;
    answer.map_or_else(|status| status, |_| Status::ok(""))
}

#[tokio::test]
async fn every_role_may_call_what_the_table_says_and_nothing_else() {
    let services = prost_types::FileDescriptorSet::decode(wire::DESCRIPTORS).unwrap().file;
    let services = services.iter().filter(|file| file.package() == "femc.v1").flat_map(|file| &file.service);
    let calls: BTreeSet<String> = services
        .flat_map(|service| service.method.iter().map(|method| format!("{}/{}", service.name(), method.name())))
        .collect();
    assert_eq!(
        calls,
        ALLOWED_ROLES.iter().map(|(call, _)| (*call).to_owned()).collect(),
        "each call stands in the table"
    );
    let farm = TestServer::start().await;
    for name in HOLDERS {
        let identity = issue(&farm.authority, name, 1);
        let by_certificate = Some((tls::client_config(&identity), None));
        let by_token = farm.authority.issue_token(holder(name), 1).ok().map(|pass| {
            (
                tls::client_config_without_certificate(pass.authority().unwrap()),
                Some(format!("Bearer {}", pass.token().secret())),
            )
        });
        assert_eq!(by_token.is_none(), name == "coordinator", "a coordinator has no token");
        for (tls, token) in by_certificate.into_iter().chain(by_token) {
            let code = async |call| call_status(&farm.url(), tls.clone(), token.as_deref(), call).await.code();
            for (call, may) in ALLOWED_ROLES {
                let code = code(call).await;
                assert_ne!(code, Code::Unauthenticated, "{name} {call}");
                assert_eq!(code != Code::PermissionDenied, may.contains(&name), "{name} {call}: {code:?}");
            }
            let unknown = code("Jobs/Own").await;
            assert_eq!(
                unknown == Code::PermissionDenied,
                name != "admin",
                "{name}: calls outside the table require admin"
            );
        }
    }
}

#[tokio::test]
async fn who_shows_nothing_may_call_nothing() {
    let farm = TestServer::start().await;
    let authority = issue(&farm.authority, "admin", 1);
    for call in ALLOWED_ROLES.map(|(call, _)| call).into_iter().chain(["Jobs/Own"]) {
        let status =
            call_status(&farm.url(), tls::client_config_without_certificate(authority.authority()), None, call).await;
        assert_eq!(status.code(), Code::Unauthenticated, "{call}");
        assert!(status.message().contains("neither a certificate nor a token"), "{status:?}");
    }
}

#[tokio::test]
async fn wrong_cut_expired_or_removed_token_is_refused_with_reason() {
    let farm = TestServer::start().await;
    let pass = farm.authority.issue_token(holder("admin"), 1).unwrap();
    let secret = pass.token().secret();
    let works = farm.client_with_token(pass.clone()).await.unwrap();
    assert!(passed_guard(&works.list().await) && passed_guard(&works.list().await), "the owner may repeat calls");

    let line = std::fs::read_to_string(farm.authority.tokens_path()).unwrap();
    let digest = line.split_whitespace().nth(2).unwrap();
    assert!(!line.contains(&secret[5..]), "the farm does not keep the token");
    let unknown = femc_trust::Token::random().unwrap().secret();
    for (what, header, why) in [
        ("nothing", String::new(), "cut short"),
        ("no token", "Bearer".into(), "cut short"),
        ("another scheme", format!("Basic {secret}"), "cut short"),
        ("cut by one", format!("Bearer {}", &secret[..secret.len() - 1]), "cut short"),
        ("one more", format!("Bearer {secret}0"), "cut short"),
        ("its digest", format!("Bearer femc_{digest}"), "does not know"),
        ("self-made", format!("Bearer {unknown}"), "does not know"),
        ("long", format!("Bearer {}", "x".repeat(4000)), "cut short"),
    ] {
        let status = farm.list_status(&header).await;
        assert_eq!(status.code(), Code::Unauthenticated, "{what}");
        assert!(status.message().contains(why) && !status.message().contains(&secret), "{what}: {status:?}");
    }

    let until = |end: &str| {
        let kept = line.split_whitespace().take(3).chain([end]).collect::<Vec<_>>().join(" ");
        std::fs::write(farm.authority.tokens_path(), format!("{kept}\n")).unwrap();
    };
    until("2001-01-01");
    let refused = works.list().await;
    assert!(
        matches!(&refused, Err(CallError::Refused(Refusal::Unauthenticated { message })) if message.contains("expired"))
    );
    until("2999-01-01");
    assert!(passed_guard(&works.list().await));
    assert_eq!(farm.authority.revoke("a-admin").unwrap(), 1);
    let refused = works.list().await;
    assert!(matches!(refused, Err(CallError::Refused(Refusal::Unauthenticated { .. }))), "{refused:?}");
    let again = farm.client_with_token(pass).await.unwrap().list().await;
    assert!(matches!(again, Err(CallError::Refused(Refusal::Unauthenticated { .. }))), "replayed: {again:?}");
}

#[tokio::test]
async fn an_open_session_ends_when_its_token_is_removed() {
    let farm = TestServer::start().await;
    let pass = farm.authority.issue_token(holder("worker"), 1).unwrap();
    let tokens = Tokens::open(farm.authority.tokens_path()).unwrap();
    let gate = Gate::new(Some((None, Some(tokens))), Limits::default(), None);
    let caller = gate.caller_of_token(&pass.token().secret()).unwrap();
    assert!(caller.is_valid());
    farm.authority.revoke("a-worker").unwrap();
    assert!(!caller.is_valid());
    farm.authority.issue_token(holder("worker"), 1).unwrap();
    assert!(!caller.is_valid(), "a new token of an old name does not count as the old token");
}

#[tokio::test]
async fn flooding_caller_is_slowed_then_refused_and_others_are_not() {
    let limits = Limits { rate: 10, burst: 5, ..Limits::default() };
    let farm = TestServer::with_limits(limits).await;
    let [ann, bob] = ["admin", "viewer"].map(|kind| farm.authority.issue_token(holder(kind), 1).unwrap());
    let (ann, bob) = (farm.client_with_token(ann).await.unwrap(), farm.client_with_token(bob).await.unwrap());
    let begun = std::time::Instant::now();
    let calls: Vec<_> = (0..60)
        .map(|_| {
            let ann = ann.clone();
            tokio::spawn(async move { ann.list().await })
        })
        .collect();
    let mut outcomes = Vec::new();
    for call in calls {
        outcomes.push(call.await.unwrap());
    }
    let refused = |heard: &Result<_, CallError>| matches!(heard, Err(CallError::Refused(Refusal::TooLarge { what, limit: 10 })) if what.contains("admin a-admin"));
    let passed = outcomes.iter().filter(|heard| passed_guard(heard)).count();
    assert_eq!(passed + outcomes.iter().filter(|heard| refused(heard)).count(), 60, "{outcomes:?}");
    // Five calls at once, ten after waiting, and more on a slow machine.
    let most = 15 + 10 * (1 + begun.elapsed().as_secs() as usize);
    assert!((15..=most).contains(&passed), "{passed} passed");
    assert!(passed_guard(&bob.list().await), "limits apply per caller");
}

#[tokio::test]
async fn a_token_is_not_sent_where_others_can_read_it() {
    let farm = TestServer::start().await;
    let pass = farm.authority.issue_token(holder("admin"), 1).unwrap();
    for url in ["http://10.0.0.1:7878", "http://farm.lan:7878,http://127.0.0.1:7878"] {
        let heard = Client::connect_with(&Dialer::tcp().with_token(pass.clone()), url).await;
        assert!(matches!(heard, Err(CallError::InsecureToken { .. })), "{heard:?}");
    }
    let bare = TokenFile::parse(&pass.token().secret()).unwrap();
    let heard = farm.client_with_token(bare).await;
    assert!(matches!(heard, Err(CallError::NoAuthority { .. })), "{heard:?}");
}

#[tokio::test]
async fn who_does_not_belong_is_not_let_in() {
    let farm = TestServer::start().await;
    let admin = issue(&farm.authority, "admin", 1);
    let works = farm.client_with_identity(admin.clone()).await.unwrap();
    assert!(passed_guard(&works.list().await), "past the guard");

    let other = Authority::init(&farm.folder.path().join("other"), "farm").unwrap();
    let expired = issue(&farm.authority, "admin", 0);
    // Certificate times have a resolution of a second.
    tokio::time::sleep(std::time::Duration::from_millis(1100)).await;
    for (what, identity) in [("another authority's", issue(&other, "admin", 1)), ("expired", expired)] {
        let heard = async { farm.client_with_identity(identity).await?.list().await }.await;
        assert!(matches!(heard, Err(CallError::Unreachable { .. })), "{what}: {heard:?}");
    }
    assert!(matches!(Client::connect(&farm.url()).await, Err(CallError::NoIdentity { .. })));
    let plain = async { Client::connect(&format!("http://{}", farm.address)).await?.list().await };
    assert!(matches!(plain.await, Err(CallError::Unreachable { .. })));

    farm.authority.revoke("a-admin").unwrap();
    let refused = works.list().await;
    assert!(
        matches!(refused, Err(CallError::Refused(Refusal::Forbidden { .. }))),
        "an open connection too: {refused:?}"
    );
    assert!(matches!(
        farm.client_with_identity(admin).await.unwrap().list().await,
        Err(CallError::Refused(Refusal::Forbidden { .. }))
    ));
}

#[tokio::test]
async fn a_worker_s_certificate_does_not_make_a_coordinator() {
    let farm = TestServer::start().await;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("https://{}", listener.local_addr().unwrap());
    let (calls, _) = mpsc::channel(1);
    let identity = issue(&farm.authority, "worker", 1);
    let entrance = AccessControl { identity: Some(identity), revoked: None, tokens: None, logins: None };
    let server = Server::new(calls, Store::in_memory()).with_access_control(Some(entrance));
    tokio::spawn(server.serve(TcpIncoming::from(listener), std::future::pending()));
    let admin = Dialer::tcp().with_identity(issue(&farm.authority, "admin", 1));
    let heard = Client::connect_with(&admin, &url).await;
    assert!(matches!(heard, Err(CallError::Unreachable { .. })), "{heard:?}");
}

#[test]
fn roles_grow() {
    for (call, _) in ALLOWED_ROLES {
        let right = super::operation(&format!("/femc.v1.{call}")).right();
        let may = |role| right.is_held_by(&Holder::User { name: "ann".into(), role });
        assert!(Role::ALL.windows(2).all(|pair| may(pair[1]) || !may(pair[0])), "{call}");
    }
}
