//! Every role against every call, over real encrypted connections.

use std::collections::BTreeSet;
use std::net::SocketAddr;

use bytes::{Buf as _, BufMut as _};
use femc_store::Store;
use femc_trust::{Authority, Holder, Identity, Issue, Revoked, Role};
use prost::Message as _;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::transport::server::TcpIncoming;
use tonic::{Code, Request, Status};

use crate::{CallError, Client, Dial, Entrance, Server, tls, wire};
use femc_model::Refusal;

const HOLDERS: [&str; 6] = ["coordinator", "worker", "viewer", "submitter", "operator", "admin"];

/// Who may call what.
const TABLE: [(&str, &[&str]); 18] = [
    ("Jobs/Submit", &["submitter", "operator", "admin"]),
    ("Jobs/List", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Status", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Watch", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Control", &["submitter", "operator", "admin"]),
    ("Jobs/Frames", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Parts", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Logs", &["viewer", "submitter", "operator", "admin"]),
    ("Jobs/Attempts", &["viewer", "submitter", "operator", "admin"]),
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

/// A server that answers whoever gets past the guard that it is stopping.
struct Farm {
    folder: tempfile::TempDir,
    authority: Authority,
    address: SocketAddr,
}

impl Farm {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::init(folder.path(), "farm").unwrap();
        let identity = issue(&authority, "coordinator", 1);
        let revoked = Some(Revoked::open(authority.revoked()).unwrap());
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (calls, _) = mpsc::channel(1);
        let server = Server::new(calls, Store::memory()).behind(Some(Entrance { identity, revoked }));
        tokio::spawn(server.serve(TcpIncoming::from(listener), std::future::pending()));
        Self { folder, authority, address }
    }

    fn url(&self) -> String {
        format!("https://{}", self.address)
    }

    async fn client(&self, identity: Identity) -> Result<Client, CallError> {
        Client::connect_by(&Dial::tcp().with(identity), &self.url()).await
    }
}

fn issue(authority: &Authority, kind: &str, days: u32) -> Identity {
    let name = format!("a-{kind}");
    let holder = match kind {
        "coordinator" => Holder::Coordinator { name },
        "worker" => Holder::Worker { name },
        role => Holder::User { name, role: role.parse().unwrap() },
    };
    authority.issue(&Issue { holder, hosts: vec![], days }).unwrap()
}

/// Bytes as they are.
#[derive(Debug, Default, Clone, Copy)]
struct Raw;

impl Codec for Raw {
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

impl Encoder for Raw {
    type Item = Vec<u8>;
    type Error = Status;

    fn encode(&mut self, item: Vec<u8>, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put_slice(&item);
        Ok(())
    }
}

impl Decoder for Raw {
    type Item = Vec<u8>;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Vec<u8>>, Status> {
        let bytes = buffer.chunk().to_vec();
        buffer.advance(bytes.len());
        Ok(Some(bytes))
    }
}

/// What an empty message gets.
async fn outcome(farm: &Farm, identity: &Identity, call: &str) -> Code {
    let endpoint =
        tonic::transport::Endpoint::from_shared(farm.url()).unwrap().tls_config(tls::client(identity)).unwrap();
    let mut grpc = tonic::client::Grpc::new(endpoint.connect().await.unwrap());
    grpc.ready().await.unwrap();
    let path = format!("/femc.v1.{call}").parse().unwrap();
    let answer = grpc.streaming(Request::new(tokio_stream::once(Vec::new())), path, Raw).await;
    answer.map_or_else(|status| status.code(), |_| Code::Ok)
}

#[tokio::test]
async fn every_role_may_call_what_the_table_says_and_nothing_else() {
    let services = prost_types::FileDescriptorSet::decode(wire::DESCRIPTORS).unwrap().file;
    let services = services.iter().filter(|file| file.package() == "femc.v1").flat_map(|file| &file.service);
    let calls: BTreeSet<String> = services
        .flat_map(|service| service.method.iter().map(|method| format!("{}/{}", service.name(), method.name())))
        .collect();
    assert_eq!(calls, TABLE.iter().map(|(call, _)| (*call).to_owned()).collect(), "each call stands in the table");
    let farm = Farm::start().await;
    for holder in HOLDERS {
        let identity = issue(&farm.authority, holder, 1);
        for (call, may) in TABLE {
            let code = outcome(&farm, &identity, call).await;
            assert_ne!(code, Code::Unauthenticated, "{holder} {call}");
            assert_eq!(code != Code::PermissionDenied, may.contains(&holder), "{holder} {call}: {code:?}");
        }
        let unknown = outcome(&farm, &identity, "Jobs/Own").await;
        assert_eq!(unknown == Code::PermissionDenied, holder != "admin", "{holder}: what is not named takes an admin");
    }
}

#[tokio::test]
async fn who_does_not_belong_is_not_let_in() {
    let farm = Farm::start().await;
    let admin = issue(&farm.authority, "admin", 1);
    let works = farm.client(admin.clone()).await.unwrap();
    assert!(matches!(works.list().await, Err(CallError::Refused(Refusal::Unavailable { .. }))), "past the guard");

    let other = Authority::init(&farm.folder.path().join("other"), "farm").unwrap();
    let expired = issue(&farm.authority, "admin", 0);
    // Certificates count whole seconds.
    tokio::time::sleep(std::time::Duration::from_millis(1100)).await;
    for (what, identity) in [("another authority's", issue(&other, "admin", 1)), ("expired", expired)] {
        let heard = async { farm.client(identity).await?.list().await }.await;
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
        farm.client(admin).await.unwrap().list().await,
        Err(CallError::Refused(Refusal::Forbidden { .. }))
    ));
}

#[tokio::test]
async fn a_worker_s_certificate_does_not_make_a_coordinator() {
    let farm = Farm::start().await;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("https://{}", listener.local_addr().unwrap());
    let (calls, _) = mpsc::channel(1);
    let identity = issue(&farm.authority, "worker", 1);
    let server = Server::new(calls, Store::memory()).behind(Some(Entrance { identity, revoked: None }));
    tokio::spawn(server.serve(TcpIncoming::from(listener), std::future::pending()));
    let admin = Dial::tcp().with(issue(&farm.authority, "admin", 1));
    let heard = Client::connect_by(&admin, &url).await;
    assert!(matches!(heard, Err(CallError::Unreachable { .. })), "{heard:?}");
}

#[test]
fn roles_grow() {
    for (call, _) in TABLE {
        let right = super::Right::of(&format!("/femc.v1.{call}"));
        let may = |role| right.is_of(&Holder::User { name: "ann".into(), role });
        assert!(Role::ALL.windows(2).all(|pair| may(pair[1]) || !may(pair[0])), "{call}");
    }
}
