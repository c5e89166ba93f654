//! Conformance tests for every log, and damage tests for the SQLite file.

use std::path::Path;

use crate::common::{LogModel, OwnedBatch, SplitMix64, all_notes};
use femc_queue::testing::ScratchDatabase;
use femc_queue::{
    Batch, LogContents, LossPolicy, Memory, MissingRecords, Note, Postgres, Queue, QueueError, Sqlite, Standby,
};
use sqlx::{ConnectOptions as _, Connection as _};

fn records(from: u8, to: u8) -> Vec<Vec<u8>> {
    (from..to).map(|byte| vec![byte; byte as usize]).collect()
}

/// Checks a log. `open` returns a new handle to the log after the previous handle is dropped. Calls have the order of a
/// coordinator: a log is loaded once, directly after it was opened, and all further calls follow.
async fn check_conformance<Q: Queue>(open: impl AsyncFn() -> Q) {
    let mut queue = open().await;
    assert_eq!(queue.load().await.unwrap(), LogContents::default(), "a new log is empty");
    let first = queue.reserve(1).await.unwrap();
    queue.append(Batch::from_records(&records(0, 3))).await.unwrap();
    queue.append(Batch::from_records(&[])).await.unwrap();
    queue.append(Batch::from_records(&records(3, 5))).await.unwrap();
    drop(queue);

    let mut queue = open().await;
    let expected = LogContents { records: records(0, 5), ..LogContents::default() };
    assert_eq!(queue.load().await.unwrap(), expected, "records come back in order after a restart");
    assert!(queue.reserve(first + 1).await.unwrap() > first);
    queue.append(Batch::from_records(&records(5, 6))).await.unwrap();
    queue.snapshot(b"state").await.unwrap();
    queue.append(Batch::from_records(&records(6, 8))).await.unwrap();
    queue.append(Batch::from_records(&records(8, 9))).await.unwrap();
    drop(queue);

    let mut queue = open().await;
    let expected = LogContents { snapshot: Some(b"state".to_vec()), records: records(6, 9), ..LogContents::default() };
    assert_eq!(queue.load().await.unwrap(), expected, "a snapshot replaces what is before it and nothing that follows");
    queue.snapshot(b"newer").await.unwrap();
    queue.snapshot(b"newest").await.unwrap();
    drop(queue);

    let mut queue = open().await;
    let expected = LogContents { snapshot: Some(b"newest".to_vec()), ..LogContents::default() };
    assert_eq!(queue.load().await.unwrap(), expected, "the last snapshot counts");
    queue.append(Batch::from_records(&records(9, 10))).await.unwrap();
    drop(queue);
    let expected = LogContents { records: records(9, 10), ..expected };
    assert_eq!(open().await.load().await.unwrap(), expected, "a snapshot without records before it is gone on from");
}

/// Checks a log with random operations: after each reopening, it holds exactly the expected contents. `open` as for
/// [`check_conformance`].
async fn check_random_walk<Q: Queue>(open: impl AsyncFn() -> Q, seed: u64) {
    let (mut rng, mut model) = (SplitMix64(seed), LogModel::default());
    let mut queue = open().await;
    queue.load().await.unwrap();
    for turn in 0..60 {
        match rng.below(10) {
            0..6 => {
                let batch = OwnedBatch::random(&mut rng);
                queue.append(batch.batch()).await.unwrap();
                model.append(&batch);
            }
            6..8 => {
                let state = rng.bytes(3000);
                queue.snapshot(&state).await.unwrap();
                model.snapshot(state);
            }
            8 => {
                let subject = rng.below(4);
                assert_eq!(all_notes(&mut queue, subject).await, model.notes(subject), "seed {seed}, turn {turn}");
            }
            _ => {
                drop(queue);
                queue = open().await;
                model.check(&queue.load().await.unwrap(), &format!("seed {seed}, turn {turn}"));
            }
        }
    }
    for subject in 0..4 {
        assert_eq!(all_notes(&mut queue, subject).await, model.notes(subject), "seed {seed}");
    }
    queue.close().await.unwrap();
    let mut queue = open().await;
    model.check(&queue.load().await.unwrap(), &format!("seed {seed}, closed"));
}

#[tokio::test]
async fn memory_holds_what_was_done_to_it() {
    for seed in 0..20 {
        let log = Memory::default();
        check_random_walk(async || log.clone(), seed).await;
    }
}

#[tokio::test]
async fn sqlite_holds_what_was_done_to_it() {
    for seed in 0..20 {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.sqlite");
        check_random_walk(async || reopen(&path).await, seed).await;
    }
}

#[tokio::test]
async fn postgres_holds_what_was_done_to_it() {
    for seed in 0..2 {
        let Some(scratch) = ScratchDatabase::new().await else { return };
        check_random_walk(async || open_as_leader(&scratch.url()).await, seed).await;
    }
}

async fn open_as_leader(url: &str) -> Postgres {
    let standby = Standby::open(url.parse().unwrap(), "http://one".into(), Postgres::SILENCE).await;
    standby.unwrap().wait_for_lead(|_| ()).await.unwrap()
}

fn note(subject: u64, byte: u8) -> Note {
    Note { subject, bytes: vec![byte; 3] }
}

/// Returns the first byte of each note of a subject.
async fn notes<Q: Queue>(queue: &mut Q, subject: u64) -> Vec<u8> {
    all_notes(queue, subject).await.into_iter().map(|note| note[0]).collect()
}

/// Checks the notes of a log. `open` as for [`check_conformance`].
async fn check_notes<Q: Queue>(open: impl AsyncFn() -> Q) {
    let mut queue = open().await;
    queue.load().await.unwrap();
    assert_eq!(notes(&mut queue, 1).await, [], "a new log has no notes");
    let both = [note(1, 1), note(2, 2), note(1, 3)];
    queue.append(Batch { notes: &both, ..Batch::from_records(&records(0, 2)) }).await.unwrap();
    queue.append(Batch { notes: &[note(1, 4)], ..Batch::default() }).await.unwrap();
    queue.snapshot(b"state").await.unwrap();
    drop(queue);

    let mut queue = open().await;
    queue.load().await.unwrap();
    assert_eq!((notes(&mut queue, 1).await, notes(&mut queue, 2).await), (vec![1, 3, 4], vec![2]));
    let many: Vec<Note> = (0..150).map(|byte| note(3, byte)).collect();
    queue.append(Batch { notes: &many, forgotten: &[1, 7], ..Batch::default() }).await.unwrap();
    assert_eq!(notes(&mut queue, 3).await, (0..150).collect::<Vec<u8>>(), "in order, page by page");
    assert_eq!(
        (notes(&mut queue, 1).await, notes(&mut queue, 2).await),
        (vec![], vec![2]),
        "what is forgotten is gone"
    );
    let again = Batch { notes: &[note(2, 9)], forgotten: &[2], ..Batch::default() };
    queue.append(again).await.unwrap();
    drop(queue);
    let mut queue = open().await;
    assert_eq!(queue.load().await.unwrap().records, Vec::<Vec<u8>>::new(), "notes are no records");
    assert_eq!(notes(&mut queue, 2).await, [9]);

    let long: Vec<Note> = (0..40).map(|byte| Note { bytes: vec![byte; 30_000], ..note(4, 0) }).collect();
    queue.append(Batch { notes: &long, ..Batch::default() }).await.unwrap();
    assert_eq!(notes(&mut queue, 4).await, (0..40).collect::<Vec<u8>>(), "in pages of some hundred kilobytes");
}

#[tokio::test]
async fn memory_keeps_notes() {
    let log = Memory::default();
    check_notes(async || log.clone()).await;
}

#[tokio::test]
async fn sqlite_keeps_notes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    check_notes(async || reopen(&path).await).await;
}

#[tokio::test]
async fn postgres_keeps_notes() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    check_notes(async || open_as_leader(&scratch.url()).await).await;
}

#[tokio::test]
async fn discarded_tail_takes_its_notes_and_damaged_note_is_skipped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    let mut queue = Sqlite::open(&path).await.unwrap();
    queue.load().await.unwrap();
    for byte in 1..6 {
        let notes = [note(1, byte)];
        queue.append(Batch { notes: &notes, ..Batch::from_records(&records(byte, byte + 1)) }).await.unwrap();
    }
    drop(queue);
    tamper(&path, "UPDATE log SET record = x'00' WHERE sequence >= 4; UPDATE notes SET note = x'07' WHERE number = 2")
        .await;
    assert!(reopen(&path).await.load().await.is_err());
    let mut queue = reopen_with(&path, LossPolicy::Accept).await;
    queue.load().await.unwrap();
    assert_eq!(notes(&mut queue, 1).await, [1, 3]);
}

#[tokio::test]
async fn memory_conforms() {
    let log = Memory::default();
    check_conformance(async || log.clone()).await;
}

#[tokio::test]
async fn sqlite_conforms() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    check_conformance(async || reopen(&path).await).await;
}

#[tokio::test]
async fn postgres_conforms() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    check_conformance(async || open_as_leader(&scratch.url()).await).await;
}

#[tokio::test]
async fn postgres_conforms_over_an_encrypted_connection() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let Some((url, _)) = scratch.encrypted_url() else { return };
    check_conformance(async || open_as_leader(&url).await).await;
}

/// Opens the log at `path`. A dropped connection closes in the background, so this waits for it; a new process need not.
async fn reopen(path: &Path) -> Sqlite {
    reopen_with(path, LossPolicy::Refuse).await
}

async fn reopen_with(path: &Path, loss: LossPolicy) -> Sqlite {
    loop {
        match Sqlite::open_with(path, loss).await {
            Err(QueueError::InUse { .. }) => tokio::task::yield_now().await,
            other => return other.unwrap(),
        }
    }
}

async fn tamper(path: &Path, sql: &'static str) {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(path);
    let mut connection = loop {
        let mut connection = options.connect().await.unwrap();
        if sqlx::raw_sql("BEGIN IMMEDIATE; COMMIT;").execute(&mut connection).await.is_ok() {
            break connection;
        }
    };
    sqlx::raw_sql(sql).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

async fn append_five_records(path: &Path) {
    let mut queue = Sqlite::open(path).await.unwrap();
    queue.load().await.unwrap();
    queue.append(Batch::from_records(&records(1, 6))).await.unwrap();
}

#[tokio::test]
async fn damaged_acknowledged_tail_goes_only_if_loss_is_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    append_five_records(&path).await;
    tamper(&path, "UPDATE log SET record = x'00' WHERE sequence >= 4").await;
    for _ in 0..2 {
        let error = reopen(&path).await.load().await.unwrap_err();
        assert!(matches!(error, QueueError::Damaged { sequence: 4, after: 0 }), "{error}");
    }
    let mut queue = reopen_with(&path, LossPolicy::Accept).await;
    let contents = queue.load().await.unwrap();
    assert_eq!(
        (contents.records, contents.missing),
        (records(1, 4), Some(MissingRecords { last_existing: 3, last_known: Some(5) }))
    );
    queue.append(Batch::from_records(&records(7, 8))).await.unwrap();
    drop(queue);
    let contents = reopen(&path).await.load().await.unwrap();
    assert_eq!((contents.records.len(), contents.missing), (4, None), "what was accepted is over");
}

#[tokio::test]
async fn damage_before_the_end_is_not_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    for (number, (sql, sound)) in [
        ("UPDATE log SET record = x'00' WHERE sequence = 2", 3),
        ("DELETE FROM log WHERE sequence = 2", 3),
        ("UPDATE log SET record = x'00' WHERE sequence IN (2, 4)", 2),
        ("DELETE FROM log WHERE sequence < 3", 3),
    ]
    .into_iter()
    .enumerate()
    {
        let path = folder.path().join(format!("{number}.sqlite"));
        append_five_records(&path).await;
        tamper(&path, sql).await;
        let error = reopen(&path).await.load().await.unwrap_err();
        assert!(matches!(error, QueueError::Damaged { after, .. } if after == sound), "{sql}: {error}");
    }
}

#[tokio::test]
async fn file_of_another_program_or_version_is_refused_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    append_five_records(&path).await;
    tamper(&path, "PRAGMA user_version = 7").await;
    let error = Sqlite::open(&path).await.unwrap_err();
    assert!(matches!(error, QueueError::ForeignFile { version: 7, .. }), "{error}");
    let other = folder.path().join("other.sqlite");
    std::fs::write(&other, b"this is not a database, but long enough to look at").unwrap();
    assert!(Sqlite::open(&other).await.is_err());
}

#[tokio::test]
async fn a_second_coordinator_cannot_open_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    let _first = Sqlite::open(&path).await.unwrap();
    let error = Sqlite::open(&path).await.unwrap_err();
    assert!(matches!(error, QueueError::InUse { .. }), "{error}");
}
