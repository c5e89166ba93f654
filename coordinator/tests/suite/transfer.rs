//! Tests of large artifacts over connections that break.

use crate::common::{Cut, Proxy};
use bytes::Bytes;
use femc_coordinator::{ArtifactStorage, Config, Coordinator, Handle};
use femc_model::*;
use femc_proto::{CallError, Client};

const MB: u64 = 1_000_000;
/// Size in bytes of the artifact in these tests.
const SIZE: u64 = 48 * MB;
/// Maximum number of bytes that a cut may cost: the data in flight (4 MiB of window) and a part's framing.
const COST: u64 = 6 * MB;

/// Makes bytes without repetitions.
fn bytes() -> Bytes {
    let mut state = 1u64;
    let word = |_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 32).to_le_bytes()
    };
    (0..SIZE / 8).flat_map(word).collect()
}

async fn farm() -> (tempfile::TempDir, Handle) {
    let folder = tempfile::tempdir().unwrap();
    let config = Config { artifacts: ArtifactStorage::Folder(folder.path().join("artifacts")), ..Config::default() };
    (folder, Coordinator::start(config).await.unwrap())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_upload_that_is_cut_goes_on_where_it_was() {
    let (_folder, farm) = farm().await;
    let cuts = [Cut::Up(30 * MB), Cut::Up(8 * MB), Cut::Up(7 * MB)];
    let proxy = Proxy::start(farm.address(), &cuts).await;
    let client = Client::connect(&proxy.url).await.unwrap();
    let bytes = bytes();
    let artifact = client.put(bytes.clone()).await.unwrap();
    assert_eq!(artifact, Artifact { digest: Digest::compute(&bytes), bytes: SIZE });
    assert_eq!(proxy.traffic.cuts(), 3, "every cut was made");
    println!("{} bytes were sent for {SIZE}", proxy.traffic.up());
    assert!(proxy.traffic.up() < SIZE + 3 * COST, "{} bytes were sent", proxy.traffic.up());
    let direct = Client::connect(&farm.url()).await.unwrap();
    assert_eq!(direct.get(&artifact.digest, SIZE).await.unwrap(), bytes);
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_download_that_is_cut_goes_on_where_it_was() {
    let (_folder, farm) = farm().await;
    let bytes = bytes();
    let artifact = Client::connect(&farm.url()).await.unwrap().put(bytes.clone()).await.unwrap();
    let cuts = [Cut::Down(30 * MB), Cut::Down(8 * MB), Cut::Down(7 * MB)];
    let proxy = Proxy::start(farm.address(), &cuts).await;
    let client = Client::connect(&proxy.url).await.unwrap();
    assert_eq!(client.get(&artifact.digest, SIZE).await.unwrap(), bytes);
    assert_eq!(proxy.traffic.cuts(), 3, "every cut was made");
    println!("{} bytes came for {SIZE}", proxy.traffic.down());
    assert!(proxy.traffic.down() < SIZE + 3 * COST, "{} bytes came", proxy.traffic.down());
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_sender_of_the_same_bytes_goes_on_with_what_is_there() {
    let (_folder, farm) = farm().await;
    let bytes = bytes();
    let proxy = Proxy::start(farm.address(), &[Cut::Up(40 * MB)]).await;
    let first = Client::connect(&proxy.url).await.unwrap();
    // The client sends until the cut and then disconnects.
    let sending = tokio::spawn({
        let bytes = bytes.clone();
        async move { first.put(bytes).await }
    });
    while proxy.traffic.cuts() == 0 {
        tokio::time::sleep(std::time::Duration::from_millis(1)).await;
    }
    sending.abort();
    let rest = Proxy::start(farm.address(), &[]).await;
    let second = Client::connect(&rest.url).await.unwrap();
    assert_eq!(second.put(bytes.clone()).await.unwrap().bytes, SIZE);
    assert_eq!(proxy.traffic.cuts(), 1);
    assert!(rest.traffic.up() < SIZE / 2, "it sent {} bytes", rest.traffic.up());
    assert_eq!(second.get(&Digest::compute(&bytes), SIZE).await.unwrap(), bytes);
    farm.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_transfer_that_gets_nowhere_is_given_up() {
    let (_folder, farm) = farm().await;
    let address = farm.address();
    let client = Client::connect(&farm.url()).await.unwrap();
    farm.stop().await.unwrap();
    let error = client.put(Bytes::from_static(b"a tile")).await.unwrap_err();
    assert!(matches!(&error, CallError::Unreachable { url, .. } if url.contains(&address.to_string())), "{error}");
}
