//! Conformance tests that every artifact store must pass.

use std::time::Duration;

use bytes::Bytes;
use femc_model::{Artifact, Digest};
use femc_require::Prerequisite;
use femc_store::object_store::ObjectStoreExt as _;
use femc_store::{Integrity, Novelty, Store, StoreError, Sweep, artifact_path};

async fn conforms(store: &Store) {
    let bytes = Bytes::from_static(b"a tile");
    let digest = Digest::compute(&bytes);
    assert!(!store.has(&digest).await.unwrap());
    assert!(matches!(store.get(&digest).await, Err(StoreError::Missing { .. })));
    assert_eq!(store.put(bytes.clone()).await.unwrap(), Artifact { digest, bytes: 6 });
    assert_eq!(store.put(bytes.clone()).await.unwrap().digest, digest, "a second time changes nothing");
    assert_eq!(store.get(&digest).await.unwrap(), bytes);
    assert!(store.has(&digest).await.unwrap());
    assert_eq!(store.size(&digest).await.unwrap(), Some(6));
    assert_eq!(store.list().await.unwrap(), [Artifact { digest, bytes: 6 }]);

    let listing = store.listing().await.unwrap();
    let age = listing[0].last_modified.elapsed().unwrap_or_default();
    assert!(listing.len() == 1 && age.as_secs() < 3600, "kept just now, give or take the clocks: {listing:?}");

    let others: Vec<Digest> = (0..100u8).map(|i| Digest::compute(&[i])).collect();
    let asked: Vec<Digest> = others.iter().take(50).chain([&digest]).chain(&others[50..]).copied().collect();
    assert_eq!(store.missing(&asked).await.unwrap(), others);

    // Larger than a part, and not a multiple of one.
    let large: Vec<u8> = (0..20_000_003u32).map(|i| (i * 7 + i / 251) as u8).collect();
    let digest = Digest::compute(&large);
    let mut upload = store.upload(digest);
    for (before, piece) in large.chunks(3_000_000).enumerate() {
        assert_eq!(upload.size(), before as u64 * 3_000_000);
        upload.write(piece).await.unwrap();
    }
    assert_eq!(upload.size(), large.len() as u64);
    assert!(!store.has(&digest).await.unwrap(), "not there before it is whole");
    let whole = Artifact { digest, bytes: large.len() as u64 };
    assert_eq!(upload.finish().await.unwrap(), (whole, Novelty::Older));
    assert_eq!(store.get(&digest).await.unwrap(), large);
    let (send, mut receive) = tokio::sync::mpsc::channel(64);
    store.read(&digest, 19_000_000, 400_000, &send).await.unwrap();
    drop(send);
    let mut tail = Vec::new();
    while let Some(piece) = receive.recv().await {
        let piece = piece.unwrap();
        assert!(piece.len() <= 400_000);
        tail.extend_from_slice(&piece);
    }
    assert_eq!(tail, large[19_000_000..]);
    assert_eq!(store.read_range(&digest, 4_000_000..4_000_100).await.unwrap(), large[4_000_000..4_000_100]);
    let beyond = store.read_range(&digest, 20_000_000..20_000_004).await;
    assert!(beyond.is_err(), "four bytes where three are left: {beyond:?}");

    for size in [10, 20_000_000] {
        let announced = Digest::compute(b"something else");
        let mut upload = store.upload(announced);
        upload.write(&large[..size]).await.unwrap();
        assert!(matches!(upload.finish().await, Err(StoreError::Mismatch { .. })));
        assert!(!store.has(&announced).await.unwrap(), "others' bytes are not kept under this name");
    }
    let mut given_up = store.upload(digest);
    given_up.write(&large[..9_000_000]).await.unwrap();
    drop(given_up);

    let small = store.clone().with_limit(5);
    assert!(matches!(small.put(bytes.clone()).await, Err(StoreError::TooLarge { limit: 5 })));
    assert!(matches!(small.upload(digest).write(&bytes).await, Err(StoreError::TooLarge { limit: 5 })));

    let exact = store.clone().with_limit(6);
    assert_eq!(exact.put(bytes.clone()).await.unwrap().bytes, 6, "as many as the limit");
    exact.upload(digest).write(&bytes).await.unwrap();

    store.remove(&digest).await.unwrap();
    store.remove(&digest).await.unwrap();
    assert!(!store.has(&digest).await.unwrap());

    for novelty in [Novelty::New, Novelty::Older] {
        let mut upload = store.upload(Digest::compute(b"small"));
        upload.write(b"small").await.unwrap();
        assert_eq!(upload.finish().await.unwrap(), (Artifact::from_bytes(b"small"), novelty));
    }

    // Two simultaneous puts of the same bytes both succeed.
    let same = Bytes::from(vec![7; 300_000]);
    let both = tokio::join!(store.put(same.clone()), store.put(same.clone()));
    assert_eq!(both.0.unwrap(), both.1.unwrap());
    assert_eq!(store.get(&Digest::compute(&same)).await.unwrap(), same);
}

/// Returns damaged variants of `whole`: empty, shorter, changed and longer ones.
fn damaged_variants(whole: &[u8]) -> Vec<(String, Vec<u8>)> {
    let size = whole.len();
    let mut cuts: Vec<usize> = [0, 1, size / 2, size - 1].into_iter().filter(|&cut| cut < size).collect();
    cuts.dedup();
    let mut all: Vec<_> = cuts.iter().map(|&cut| (format!("cut at {cut}"), whole[..cut].to_vec())).collect();
    for at in [0, size / 2, size - 1] {
        let mut flipped = whole.to_vec();
        flipped[at] ^= 0x10;
        all.push((format!("flipped at {at}"), flipped));
    }
    // As after a crash: the size is right, but the end never reached the disk.
    let mut torn = whole.to_vec();
    torn[size / 2..].fill(0);
    all.push(("torn".into(), torn));
    all.push(("longer".into(), [whole, b"rubbish"].concat()));
    all
}

/// Method of replacing damaged bytes.
#[derive(Debug, Clone, Copy)]
enum ReplaceMethod {
    Put,
    /// For the large artifact, one full part and a smaller one; for the small one, a single put.
    Upload,
}

/// Checks that damage of any kind is detected, and that the artifact can be stored again.
async fn heals(store: &Store) {
    // The large artifact is written in several parts and read in several blocks.
    let large: Vec<u8> = (0..9_000_003u32).map(|i| (i * 7 + i / 251) as u8).collect();
    for whole in [b"a tile of some bytes".to_vec(), large] {
        let whole = Bytes::from(whole);
        let Artifact { digest, bytes } = Artifact::from_bytes(&whole);
        let all = damaged_variants(&whole);
        // For the large artifact, only every second kind of damage is tested.
        let step = if whole.len() < 1000 { 1 } else { 2 };
        for (harm, damaged) in all.into_iter().step_by(step) {
            for method in [ReplaceMethod::Put, ReplaceMethod::Upload] {
                let plant = || async {
                    store.put(whole.clone()).await.unwrap();
                    store.objects().put(&artifact_path(&digest), damaged.clone().into()).await.unwrap();
                };
                let is_gone = || async { !store.has(&digest).await.unwrap() };
                plant().await;
                assert_eq!(store.verify(&digest).await.unwrap(), Integrity::Damaged, "{harm}");
                assert!(is_gone().await, "{harm}: what is damaged is removed");
                assert_eq!(store.verify(&digest).await.unwrap(), Integrity::Missing, "{harm}");

                plant().await;
                assert!(matches!(store.get(&digest).await, Err(StoreError::Missing { .. })), "{harm}");
                assert!(is_gone().await, "{harm}: nor by reading");

                plant().await;
                for offset in [0, bytes / 2] {
                    let (send, mut receive) = tokio::sync::mpsc::channel(64);
                    let reading = tokio::spawn({
                        let store = store.clone();
                        async move { store.read(&digest, offset, 1 << 20, &send).await }
                    });
                    while receive.recv().await.is_some() {}
                    let outcome = reading.await.unwrap();
                    let is_reported = matches!(outcome, Err(StoreError::Mismatch { .. } | StoreError::Missing { .. }));
                    assert!(is_reported, "{harm}, read from {offset}: {outcome:?}");
                    assert!(is_gone().await, "{harm}, read from {offset}");
                }

                // Store over the damaged artifact, like a client that has not checked before.
                plant().await;
                match method {
                    ReplaceMethod::Put => drop(store.put(whole.clone()).await.unwrap()),
                    ReplaceMethod::Upload => {
                        let mut upload = store.upload(digest);
                        upload.write(&whole).await.unwrap();
                        upload.finish().await.unwrap();
                    }
                }
                assert_eq!(store.get(&digest).await.unwrap(), whole, "{harm}, {method:?}");

                plant().await;
                if damaged.len() as u64 != bytes {
                    assert_eq!(store.missing(&[digest]).await.unwrap(), [digest], "{harm}");
                    assert!(is_gone().await, "{harm}");
                }
                // One store remembers the artifact from before the damage; a fresh one has an empty cache.
                store.put(whole.clone()).await.unwrap();
                assert_eq!(
                    store.verify_unless_recent(&Artifact { digest, bytes }).await.unwrap(),
                    Integrity::Intact(bytes)
                );
                let fresh = Store::from_object_store("the same", store.objects().clone());
                store.objects().put(&artifact_path(&digest), damaged.clone().into()).await.unwrap();
                assert_eq!(fresh.missing(&[digest]).await.unwrap(), [digest], "{harm}");
                store.remove(&digest).await.unwrap();
                assert_eq!(
                    store.verify_unless_recent(&Artifact { digest, bytes }).await.unwrap(),
                    Integrity::Missing,
                    "{harm}"
                );
            }
        }
        // An artifact that another process removed is forgotten as soon as that is detected.
        store.put(whole.clone()).await.unwrap();
        store.objects().delete(&artifact_path(&digest)).await.unwrap();
        assert_eq!(store.verify(&digest).await.unwrap(), Integrity::Missing);
        assert_eq!(store.verify_unless_recent(&Artifact { digest, bytes }).await.unwrap(), Integrity::Missing);
        // A sound artifact is kept even if the caller expects another size.
        store.put(whole.clone()).await.unwrap();
        assert_eq!(
            store.verify_unless_recent(&Artifact { digest, bytes: bytes + 1 }).await.unwrap(),
            Integrity::Intact(bytes)
        );
        assert_eq!(store.get(&digest).await.unwrap(), whole, "and it stays");
    }
}

/// Opens a separate prefix on the S3 server that `tests/s3` starts.
fn s3(name: &str) -> Option<Store> {
    let bucket = Prerequisite::S3.variable_or_skip("FEMC_TEST_S3")?;
    Some(Store::open_s3(&format!("{bucket}/{name}/{}", std::process::id())).unwrap())
}

#[tokio::test]
async fn an_s3_server_conforms() {
    let Some(store) = s3("conforms") else { return };
    store.probe().await.unwrap();
    conforms(&store).await;
    heals(&store).await;
}

#[tokio::test]
async fn two_prefixes_of_a_bucket_are_two_stores() {
    let (Some(one), Some(two)) = (s3("one"), s3("two")) else { return };
    let artifact = one.put(Bytes::from_static(b"a tile")).await.unwrap();
    assert_eq!((one.list().await.unwrap(), two.list().await.unwrap()), (vec![artifact], vec![]));
}

#[tokio::test]
async fn unreachable_store_is_named_with_cause_not_called_missing() {
    let Some(store) = s3("no-such-bucket") else { return };
    // A bucket that the server does not have.
    let url = store.name().replace("femc-test", "femc-nowhere");
    let away = Store::open_s3(&url).unwrap();
    let bytes = Bytes::from_static(b"a tile");
    for error in [away.probe().await.unwrap_err(), away.put(bytes).await.unwrap_err()] {
        assert!(matches!(error, StoreError::Medium { .. }), "{error}");
        assert!(error.to_string().contains(&url) && error.to_string().contains("NoSuchBucket"), "{error}");
    }
}

#[tokio::test]
async fn memory_conforms() {
    conforms(&Store::in_memory()).await;
}

#[tokio::test]
async fn what_memory_damages_is_found_and_can_be_put_again() {
    heals(&Store::in_memory()).await;
}

#[tokio::test]
async fn what_a_disk_damages_is_found_and_can_be_put_again() {
    let folder = tempfile::tempdir().unwrap();
    heals(&Store::open_folder(folder.path()).unwrap()).await;
}

#[tokio::test]
async fn a_folder_conforms() {
    let folder = tempfile::tempdir().unwrap();
    conforms(&Store::open_folder(&folder.path().join("new/artifacts")).unwrap()).await;
}

#[tokio::test]
async fn a_damaged_artifact_is_missing_and_can_be_put_again() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open_folder(folder.path()).unwrap();
    let bytes = Bytes::from_static(b"a tile");
    let digest = store.put(bytes.clone()).await.unwrap().digest;
    let name = digest.to_string();
    std::fs::write(folder.path().join(&name[..2]).join(&name[2..]), b"a tale").unwrap();
    assert!(matches!(store.get(&digest).await, Err(StoreError::Missing { .. })));
    assert!(!store.has(&digest).await.unwrap());
    store.put(bytes.clone()).await.unwrap();
    assert_eq!(store.get(&digest).await.unwrap(), bytes);
}

#[tokio::test]
async fn only_files_of_unfinished_uploads_are_swept() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open_folder(folder.path()).unwrap();
    store.put(Bytes::from_static(b"a tile")).await.unwrap();
    std::fs::write(folder.path().join("a person's note #1"), "stays").unwrap();
    let mut upload = store.upload(Digest::compute(b"large"));
    upload.write(&[7; 9_000_000]).await.unwrap();
    // As if the process had been killed.
    std::mem::forget(upload);
    let (now, hour) = (Duration::ZERO, Duration::from_secs(3600));
    assert_eq!(store.sweep_uploads(hour, Sweep::Remove).await.unwrap(), (0, 0));
    assert_eq!(store.sweep_uploads(now, Sweep::Count).await.unwrap(), (1, 8 << 20));
    assert_eq!(store.sweep_uploads(now, Sweep::Remove).await.unwrap(), (1, 8 << 20));
    assert_eq!(store.sweep_uploads(now, Sweep::Count).await.unwrap(), (0, 0));
    assert_eq!(store.list().await.unwrap().len(), 1);
    assert!(folder.path().join("a person's note #1").exists());
    assert_eq!(Store::in_memory().sweep_uploads(now, Sweep::Remove).await.unwrap(), (0, 0));
}
