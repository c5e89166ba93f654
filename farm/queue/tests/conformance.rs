//! What every log must do, and what the file must survive.

use std::path::Path;

use femc_queue::testing::Scratch;
use femc_queue::{Batch, Contents, Memory, Note, Page, Postgres, Queue, QueueError, Sqlite, Standby};
use sqlx::{ConnectOptions as _, Connection as _};

fn records(from: u8, to: u8) -> Vec<Vec<u8>> {
    (from..to).map(|byte| vec![byte; byte as usize]).collect()
}

/// `open` gives a new handle to the same log after the one before is gone.
async fn conforms<Q: Queue>(open: impl AsyncFn() -> Q) {
    let mut queue = open().await;
    assert_eq!(queue.load().await.unwrap(), Contents::default(), "a new log is empty");
    queue.append(Batch::of(&records(0, 3))).await.unwrap();
    queue.append(Batch::of(&[])).await.unwrap();
    queue.append(Batch::of(&records(3, 5))).await.unwrap();
    drop(queue);

    let mut queue = open().await;
    let expected = Contents { records: records(0, 5), ..Contents::default() };
    assert_eq!(queue.load().await.unwrap(), expected, "records come back in order after a restart");
    queue.append(Batch::of(&records(5, 6))).await.unwrap();
    queue.snapshot(b"state").await.unwrap();
    let after = Contents { snapshot: Some(b"state".to_vec()), ..Contents::default() };
    assert_eq!(queue.load().await.unwrap(), after, "a snapshot replaces what is before it");
    queue.append(Batch::of(&records(6, 8))).await.unwrap();
    drop(queue);

    let mut queue = open().await;
    let expected = Contents { records: records(6, 8), ..after };
    assert_eq!(queue.load().await.unwrap(), expected);
    queue.snapshot(b"newer").await.unwrap();
    queue.snapshot(b"newest").await.unwrap();
    drop(queue);
    let expected = Contents { snapshot: Some(b"newest".to_vec()), ..Contents::default() };
    assert_eq!(open().await.load().await.unwrap(), expected, "the last snapshot counts");
}

fn note(subject: u64, byte: u8) -> Note {
    Note { subject, bytes: vec![byte; 3] }
}

/// All pages of a subject, put together.
async fn notes<Q: Queue>(queue: &mut Q, subject: u64) -> Vec<u8> {
    let (mut all, mut from) = (Vec::new(), Some(0));
    while let Some(at) = from {
        let Page { notes, next } = queue.notes(subject, at).await.unwrap();
        assert!(notes.len() == Page::NOTES || next.is_none() && notes.len() < Page::NOTES, "{}", notes.len());
        all.extend(notes.into_iter().map(|note| note[0]));
        from = next;
    }
    all
}

/// `open` as for [`conforms`].
async fn keeps_notes<Q: Queue>(open: impl AsyncFn() -> Q) {
    let mut queue = open().await;
    queue.load().await.unwrap();
    assert_eq!(notes(&mut queue, 1).await, [], "a new log has no notes");
    let both = [note(1, 1), note(2, 2), note(1, 3)];
    queue.append(Batch { notes: &both, ..Batch::of(&records(0, 2)) }).await.unwrap();
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
    assert_eq!(queue.load().await.unwrap().records, Vec::<Vec<u8>>::new(), "notes are no records");
}

#[tokio::test]
async fn memory_keeps_notes() {
    let log = Memory::default();
    keeps_notes(async || log.clone()).await;
}

#[tokio::test]
async fn sqlite_keeps_notes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    keeps_notes(async || reopen(&path).await).await;
}

#[tokio::test]
async fn postgres_keeps_notes() {
    let Some(scratch) = Scratch::new().await else { return };
    keeps_notes(async || {
        let standby = Standby::open(scratch.url().parse().unwrap(), "http://one".into(), Postgres::SILENCE).await;
        standby.unwrap().lead(|_| ()).await.unwrap()
    })
    .await;
}

#[tokio::test]
async fn a_tail_that_is_cut_takes_its_notes_along_and_a_damaged_note_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    let mut queue = Sqlite::open(&path).await.unwrap();
    queue.load().await.unwrap();
    for byte in 1..6 {
        let notes = [note(1, byte)];
        queue.append(Batch { notes: &notes, ..Batch::of(&records(byte, byte + 1)) }).await.unwrap();
    }
    drop(queue);
    tamper(&path, "UPDATE log SET record = x'00' WHERE sequence >= 4; UPDATE notes SET note = x'07' WHERE number = 2")
        .await;
    let mut queue = reopen(&path).await;
    queue.load().await.unwrap();
    assert_eq!(notes(&mut queue, 1).await, [1, 3]);
}

#[tokio::test]
async fn memory_conforms() {
    let log = Memory::default();
    conforms(async || log.clone()).await;
}

#[tokio::test]
async fn sqlite_conforms() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    conforms(async || reopen(&path).await).await;
}

#[tokio::test]
async fn postgres_conforms() {
    let Some(scratch) = Scratch::new().await else { return };
    conforms(async || {
        let database = scratch.url().parse().unwrap();
        let standby = Standby::open(database, "http://one".into(), Postgres::SILENCE).await.unwrap();
        standby.lead(|_| ()).await.unwrap()
    })
    .await;
}

#[tokio::test]
async fn postgres_conforms_over_an_encrypted_connection() {
    let Some(scratch) = Scratch::new().await else { return };
    let Some((url, _)) = scratch.encrypted() else { return };
    conforms(async || {
        let database = url.parse().unwrap();
        let standby = Standby::open(database, "http://one".into(), Postgres::SILENCE).await.unwrap();
        standby.lead(|_| ()).await.unwrap()
    })
    .await;
}

/// A dropped connection closes in the background; wait for it as a new process would not need to.
async fn reopen(path: &Path) -> Sqlite {
    loop {
        match Sqlite::open(path).await {
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

async fn with_five(path: &Path) {
    let mut queue = Sqlite::open(path).await.unwrap();
    queue.load().await.unwrap();
    queue.append(Batch::of(&records(1, 6))).await.unwrap();
}

#[tokio::test]
async fn a_torn_tail_is_dropped_and_counted_and_the_log_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    with_five(&path).await;
    tamper(&path, "UPDATE log SET record = x'00' WHERE sequence >= 4").await;
    let mut queue = reopen(&path).await;
    let contents = queue.load().await.unwrap();
    assert_eq!((contents.records, contents.torn), (records(1, 4), 2));
    queue.append(Batch::of(&records(7, 8))).await.unwrap();
    let contents = queue.load().await.unwrap();
    assert_eq!((contents.records.len(), contents.torn), (4, 0));
}

#[tokio::test]
async fn damage_before_the_end_is_not_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    for sql in ["UPDATE log SET record = x'00' WHERE sequence = 2", "DELETE FROM log WHERE sequence = 2"] {
        let path = folder.path().join(format!("{}.sqlite", sql.len()));
        with_five(&path).await;
        tamper(&path, sql).await;
        let error = reopen(&path).await.load().await.unwrap_err();
        assert!(matches!(error, QueueError::Damaged { sequence: 2, .. }), "{error}");
    }
}

#[tokio::test]
async fn a_file_of_another_program_or_version_is_refused_and_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    with_five(&path).await;
    tamper(&path, "PRAGMA user_version = 7").await;
    let error = Sqlite::open(&path).await.unwrap_err();
    assert!(matches!(error, QueueError::Foreign { version: 7, .. }), "{error}");
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

#[tokio::test]
async fn a_copy_of_the_files_taken_at_any_moment_holds_whole_batches_and_all_that_was_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.sqlite");
    let mut queue = Sqlite::open(&path).await.unwrap();
    queue.load().await.unwrap();
    for batch in 0..10u8 {
        queue.append(Batch::of(&[vec![batch; 100], vec![batch; 5000]])).await.unwrap();
        // What a kill would leave: the files as they are now, without closing anything.
        let copy = folder.path().join(format!("copy{batch}.sqlite"));
        std::fs::copy(&path, &copy).unwrap();
        std::fs::copy(folder.path().join("log.sqlite-wal"), folder.path().join(format!("copy{batch}.sqlite-wal")))
            .unwrap();
        let contents = Sqlite::open(&copy).await.unwrap().load().await.unwrap();
        assert_eq!(contents.records.len(), 2 * (batch as usize + 1));
    }
}
