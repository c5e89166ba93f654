//! Tests of coordinators that lose their database, or each other.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use femc_coordinator::{ArtifactStorage, Config, Coordinator, Handle, Leadership, LogStorage};
use femc_model::{Digest, Grid, JobId, JobNotes, JobSpec, testing};
use femc_proto::{CallError, Client};
use femc_queue::testing::ScratchDatabase;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;

const SILENCE: Duration = Duration::from_millis(1200);
/// Time limit, longer than anything here takes on a loaded machine.
const TEST_TIMEOUT: Duration = Duration::from_secs(60);

/// State of the connection to the database.
#[derive(Debug, Clone, Copy, PartialEq)]
enum LinkState {
    Open,
    /// Connections stay open, but nothing arrives.
    Silent,
    /// Connections break, and new ones are refused.
    Broken,
}

/// Starts a proxy to the database at `url`. Returns its switch and its URL.
async fn database_proxy(url: &str) -> (watch::Sender<LinkState>, String) {
    let (head, tail) = url.split_once('@').unwrap();
    let (place, path) = tail.split_once('/').unwrap();
    let (place, listener) = (Arc::<str>::from(place), TcpListener::bind("127.0.0.1:0").await.unwrap());
    let url = format!("{head}@{}/{path}", listener.local_addr().unwrap());
    let (set, way) = watch::channel(LinkState::Open);
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            tokio::spawn(relay(near, place.clone(), way.clone()));
        }
    });
    (set, url)
}

async fn relay(mut near: TcpStream, place: Arc<str>, mut state: watch::Receiver<LinkState>) {
    if *state.borrow() == LinkState::Broken {
        return;
    }
    let mut far = TcpStream::connect(&*place).await.unwrap();
    tokio::select! {
        _ = tokio::io::copy_bidirectional(&mut near, &mut far) => return,
        _ = state.wait_for(|way| *way != LinkState::Open) => {}
    }
    // Both ends stay open and nothing arrives, until the proxy is set to broken.
    if *state.borrow() == LinkState::Silent {
        let _ = state.wait_for(|way| *way == LinkState::Broken).await;
    }
}

async fn coordinator(url: &str, artifacts: &Path) -> Handle {
    let log = LogStorage::Postgres { database: url.parse().unwrap(), silence: SILENCE };
    let artifacts = ArtifactStorage::Folder(artifacts.to_owned());
    Coordinator::start(Config { log, artifacts, ..Config::default() }).await.unwrap()
}

async fn wait_for_leadership(farm: &Handle, wanted: impl Fn(&Leadership) -> bool) -> Leadership {
    let mut standing = farm.leadership();
    let heard = tokio::time::timeout(TEST_TIMEOUT, standing.wait_for(wanted)).await;
    heard.expect("it stays as it is").unwrap().clone()
}

async fn client_of_leader(farm: &Handle) -> Client {
    wait_for_leadership(farm, |standing| *standing == Leadership::Leader).await;
    Client::connect(&farm.url()).await.unwrap()
}

async fn submit(client: &Client) -> JobId {
    let spec = JobSpec {
        name: "fog".into(),
        bundle: Digest::compute(b"bundle"),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![1, 2],
        grid: Grid { film: [64, 64], tile: 16 },
        graph: testing::frame_graph(Grid { film: [64, 64], tile: 16 }.sizes(), &[16], 0),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    };
    client.put(b"bundle".as_slice().into()).await.unwrap();
    client.submit(None, spec).await.unwrap()
}

async fn jobs(client: &Client) -> Vec<JobId> {
    client.list().await.unwrap().iter().map(|status| status.job).collect()
}

#[tokio::test]
async fn coordinator_resumes_when_its_lost_database_is_back() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let folder = tempfile::tempdir().unwrap();
    let (set, url) = database_proxy(&scratch.url()).await;
    let farm = coordinator(&url, folder.path()).await;
    let client = client_of_leader(&farm).await;
    let job = submit(&client).await;
    set.send(LinkState::Broken).unwrap();
    let standing = wait_for_leadership(&farm, |standing| *standing != Leadership::Leader).await;
    assert!(matches!(standing, Leadership::Disconnected { .. }), "{standing:?}");
    let refused = Client::connect(&farm.url()).await.map(drop);
    assert!(matches!(refused, Err(CallError::Unreachable { .. })), "who does not lead does not listen: {refused:?}");
    set.send(LinkState::Open).unwrap();
    let again = client_of_leader(&farm).await;
    assert_eq!(jobs(&again).await, [job]);
    assert_eq!(jobs(&client).await, [job], "a client mends itself");
    assert!(submit(&again).await > job);
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn leader_without_its_database_falls_silent_and_another_leads() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let folder = tempfile::tempdir().unwrap();
    let (set, url) = database_proxy(&scratch.url()).await;
    let one = coordinator(&url, folder.path()).await;
    let client = client_of_leader(&one).await;
    let first = submit(&client).await;
    let two = coordinator(&scratch.url(), folder.path()).await;
    let heard = wait_for_leadership(&two, |standing| *standing != Leadership::Standby { leader: None }).await;
    assert_eq!(heard, Leadership::Standby { leader: Some(one.url()) });
    let watch = client.watch(first).await.unwrap();
    set.send(LinkState::Silent).unwrap();
    // This request cannot become durable, so it is never acknowledged.
    let lost = tokio::spawn({
        let client = client.clone();
        async move { client.control(first, femc_model::Control::Pause).await }
    });
    let taken = client_of_leader(&two).await;
    // The old leader has given up its role before the new one could lead. Its clients will soon see its end.
    assert!(*one.leadership().borrow() != Leadership::Leader || client.list().await.is_err(), "two answer");
    assert!(lost.await.unwrap().is_err());
    let mut watch = watch;
    while let Ok(Some(_)) = watch.next().await {}
    assert_eq!(jobs(&taken).await, [first]);
    assert_eq!(taken.status(first).await.unwrap().state, femc_model::JobState::Queued);
    let second = submit(&taken).await;
    set.send(LinkState::Broken).unwrap();
    set.send(LinkState::Open).unwrap();
    let heard = wait_for_leadership(&one, |standing| matches!(standing, Leadership::Standby { leader: Some(_) })).await;
    assert_eq!(heard, Leadership::Standby { leader: Some(two.url()) });
    drop(taken);
    two.stop().await.unwrap();
    assert_eq!(jobs(&client_of_leader(&one).await).await, [first, second], "it has read the log anew");
    one.stop().await.unwrap();
}

#[tokio::test]
async fn an_idle_leader_that_is_deposed_stops_answering_by_itself() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let folder = tempfile::tempdir().unwrap();
    let farm = coordinator(&scratch.url(), folder.path()).await;
    let client = client_of_leader(&farm).await;
    let job = submit(&client).await;
    scratch.tamper("UPDATE femc.leader SET epoch = epoch + 1").await;
    wait_for_leadership(&farm, |standing| *standing != Leadership::Leader).await;
    // There is no other coordinator, so it leads again, in a new term.
    assert_eq!(jobs(&client_of_leader(&farm).await).await, [job]);
    assert_eq!(scratch.query_number("SELECT epoch FROM femc.leader").await, 3);
    farm.stop().await.unwrap();
}

#[tokio::test]
async fn a_coordinator_that_stands_by_stops_when_it_is_told() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let folder = tempfile::tempdir().unwrap();
    let one = coordinator(&scratch.url(), folder.path()).await;
    client_of_leader(&one).await;
    let two = coordinator(&scratch.url(), folder.path()).await;
    two.stop().await.unwrap();
    one.stop().await.unwrap();
}
