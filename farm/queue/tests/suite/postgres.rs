//! Tests of the log in PostgreSQL: damage, foreign tables and connections, and several coordinators at once.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use femc_queue::testing::ScratchDatabase;
use femc_queue::{
    Batch, Database, Leader, LogContents, LossPolicy, MissingRecords, Postgres, Queue, QueueError, Remedy, Standby,
};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

/// Allowed silence of a leader. It is shorter than in production, so that the tests do not wait long.
const SILENCE: Duration = Duration::from_millis(800);

fn records(from: u8, to: u8) -> Vec<Vec<u8>> {
    (from..to).map(|byte| vec![byte; byte as usize]).collect()
}

async fn standby(scratch: &ScratchDatabase, url: &str) -> Standby {
    Standby::open(scratch.url().parse().unwrap(), url.into(), SILENCE).await.unwrap()
}

async fn leader(scratch: &ScratchDatabase, url: &str) -> Postgres {
    let mut queue = standby(scratch, url).await.wait_for_lead(|_| ()).await.unwrap();
    queue.load().await.unwrap();
    queue
}

/// Starts a leader with an allowed silence of 60 s. Its heartbeats are a second apart, so it does not quickly notice by itself that
/// it is deposed.
async fn patient_leader(scratch: &ScratchDatabase) -> Postgres {
    let standby = Standby::open(scratch.url().parse().unwrap(), "http://one".into(), Duration::from_secs(60)).await;
    let mut queue = standby.unwrap().wait_for_lead(|_| ()).await.unwrap();
    queue.load().await.unwrap();
    queue
}

async fn append_five_records(scratch: &ScratchDatabase) {
    leader(scratch, "http://one").await.append(Batch::from_records(&records(1, 6))).await.unwrap();
}

/// Increments the epoch, as if another coordinator led. The connections and the lock do not change.
const NEXT_EPOCH: &str = "UPDATE femc.leader SET epoch = epoch + 1";

#[tokio::test]
async fn damaged_acknowledged_tail_goes_only_if_loss_is_accepted() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    append_five_records(&scratch).await;
    scratch.tamper("UPDATE femc.log SET record = '\\x00' WHERE sequence >= 4").await;
    let mut queue = standby(&scratch, "http://one").await.wait_for_lead(|_| ()).await.unwrap();
    let error = queue.load().await.unwrap_err();
    assert!(matches!(error, QueueError::Damaged { sequence: 4, after: 0 }), "{error}");
    assert_eq!(scratch.query_number("SELECT count(*) FROM femc.log").await, 5, "it is left as it is");
    drop(queue);
    let mut queue =
        standby(&scratch, "http://one").await.with_loss_policy(LossPolicy::Accept).wait_for_lead(|_| ()).await.unwrap();
    let contents = queue.load().await.unwrap();
    assert_eq!(
        (contents.records, contents.missing),
        (records(1, 4), Some(MissingRecords { last_existing: 3, last_known: Some(5) }))
    );
    queue.append(Batch::from_records(&records(7, 8))).await.unwrap();
    drop(queue);
    let contents = load_as_leader(&scratch).await;
    assert_eq!((contents.records.len(), contents.missing), (4, None));
}

async fn load_as_leader(scratch: &ScratchDatabase) -> LogContents {
    standby(scratch, "http://one").await.wait_for_lead(|_| ()).await.unwrap().load().await.unwrap()
}

#[tokio::test]
async fn write_on_an_ended_connection_is_atomic_and_loses_nothing() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let mut queue = patient_leader(&scratch).await;
    queue.append(Batch::from_records(&records(1, 4))).await.unwrap();
    scratch
        .tamper(
            "CREATE FUNCTION femc.dawdle() RETURNS trigger LANGUAGE plpgsql AS
             $$ BEGIN PERFORM pg_sleep(30); RETURN NEW; END $$;
             CREATE TRIGGER dawdle BEFORE INSERT ON femc.log FOR EACH ROW EXECUTE FUNCTION femc.dawdle()",
        )
        .await;
    let write = tokio::spawn(async move { queue.append(Batch::from_records(&records(4, 9))).await });
    let end = "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity
        WHERE wait_event = 'PgSleep' AND datname = current_database()";
    while scratch.query_number(end).await == 0 {}
    let error = write.await.unwrap().unwrap_err();
    assert_eq!(error.remedy(), Remedy::Reopen, "{error}");
    assert_eq!(load_as_leader(&scratch).await.records, records(1, 4));
}

#[tokio::test]
async fn incarnation_exceeds_earlier_ones_and_those_of_a_lost_tail() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let mut queue = patient_leader(&scratch).await;
    let first = queue.reserve(1).await.unwrap();
    assert_eq!((queue.reserve(1).await.unwrap(), queue.reserve(first + 7).await.unwrap()), (first + 1, first + 7));
    // Restore the state of a dump from two minutes before the first reservation.
    scratch.tamper(&format!("UPDATE femc.leader SET incarnation = {}", first - 2)).await;
    assert!(queue.reserve(1).await.unwrap() >= first);
    scratch.tamper(NEXT_EPOCH).await;
    assert!(matches!(queue.reserve(1).await.unwrap_err(), QueueError::Deposed { .. }));
}

#[tokio::test]
async fn damage_before_the_end_is_not_passed_over() {
    for sql in ["UPDATE femc.log SET record = '\\x00' WHERE sequence = 2", "DELETE FROM femc.log WHERE sequence = 2"] {
        let Some(scratch) = ScratchDatabase::new().await else { return };
        append_five_records(&scratch).await;
        scratch.tamper(sql).await;
        let mut queue = standby(&scratch, "http://one").await.wait_for_lead(|_| ()).await.unwrap();
        let error = queue.load().await.unwrap_err();
        assert!(matches!(error, QueueError::Damaged { sequence: 2, .. }), "{error}");
        assert_eq!(error.remedy(), Remedy::None);
    }
}

#[tokio::test]
async fn a_damaged_snapshot_is_not_passed_over() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    leader(&scratch, "http://one").await.snapshot(b"state").await.unwrap();
    scratch.tamper("UPDATE femc.snapshot SET state = '\\x00'").await;
    let mut queue = standby(&scratch, "http://one").await.wait_for_lead(|_| ()).await.unwrap();
    assert!(matches!(queue.load().await.unwrap_err(), QueueError::DamagedSnapshot));
}

#[tokio::test]
async fn tables_of_another_program_or_version_are_refused_unchanged() {
    for (tamper, version) in [
        ("UPDATE femc.header SET version = 7", Some("7".to_owned())),
        ("DROP TABLE femc.header", None),
        ("DROP TABLE femc.header; CREATE TABLE femc.header (title text); INSERT INTO femc.header VALUES ('x')", None),
    ] {
        let Some(scratch) = ScratchDatabase::new().await else { return };
        append_five_records(&scratch).await;
        scratch.tamper(tamper).await;
        let database = scratch.url().parse().unwrap();
        let error = Standby::open(database, "http://one".into(), SILENCE).await.unwrap_err();
        assert!(matches!(&error, QueueError::ForeignTables { found, .. } if *found == version), "{error}");
        assert_eq!(scratch.query_number("SELECT count(*) FROM femc.log").await, 5);
    }
}

#[tokio::test]
async fn an_empty_schema_that_somebody_made_is_used() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    scratch.tamper("CREATE SCHEMA femc").await;
    append_five_records(&scratch).await;
}

#[tokio::test]
async fn coordinators_starting_at_once_make_tables_once_and_one_leads() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let (sent, mut leaders) = tokio::sync::mpsc::unbounded_channel();
    let begin = |number: u32| {
        let (database, sent) = (scratch.url().parse::<Database>().unwrap(), sent.clone());
        tokio::spawn(async move {
            let standby = Standby::open(database, format!("http://{number}"), SILENCE).await.unwrap();
            let queue = standby.wait_for_lead(|_| ()).await.unwrap();
            sent.send(()).unwrap();
            // Lead until the test ends.
            std::future::pending::<()>().await;
            drop(queue);
        })
    };
    let all: Vec<_> = (0..6).map(begin).collect();
    leaders.recv().await.unwrap();
    tokio::time::sleep(2 * SILENCE).await;
    assert!(leaders.try_recv().is_err(), "a second one leads");
    assert_eq!(scratch.query_number("SELECT epoch FROM femc.leader").await, 1);
    all.iter().for_each(|one| one.abort());
}

#[tokio::test]
async fn standby_learns_the_leader_and_leads_when_the_leader_is_gone() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let mut first = leader(&scratch, "http://one").await;
    first.append(Batch::from_records(&records(1, 3))).await.unwrap();
    let received: Arc<Mutex<Vec<Leader>>> = Arc::default();
    let second = standby(&scratch, "http://two").await;
    let sink = received.clone();
    let second = tokio::spawn(async move { second.wait_for_lead(|leader| sink.lock().unwrap().push(leader)).await });
    tokio::time::sleep(2 * SILENCE).await;
    assert!(!second.is_finished(), "an idle leader stays");
    assert_eq!(*received.lock().unwrap(), [Leader { url: "http://one".into(), epoch: 1 }], "told once");
    first.append(Batch::from_records(&records(3, 4))).await.unwrap();
    drop(first);
    let mut second = second.await.unwrap().unwrap();
    assert_eq!(second.epoch(), 2);
    let expected = LogContents { records: records(1, 4), ..LogContents::default() };
    assert_eq!(second.load().await.unwrap(), expected);
}

#[tokio::test]
async fn a_deposed_leader_appends_nothing() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let mut queue = patient_leader(&scratch).await;
    queue.append(Batch::from_records(&records(1, 3))).await.unwrap();
    scratch.tamper(NEXT_EPOCH).await;
    let error = queue.append(Batch::from_records(&records(3, 5))).await.unwrap_err();
    assert!(matches!(error, QueueError::Deposed { epoch: 1 }), "{error}");
    assert_eq!(error.remedy(), Remedy::Reopen);
    assert_eq!(scratch.query_number("SELECT count(*) FROM femc.log").await, 2);
}

#[tokio::test]
async fn a_deposed_leader_s_snapshot_replaces_nothing() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let mut queue = patient_leader(&scratch).await;
    queue.append(Batch::from_records(&records(1, 3))).await.unwrap();
    scratch.tamper(NEXT_EPOCH).await;
    let error = queue.snapshot(b"state").await.unwrap_err();
    assert!(matches!(error, QueueError::Deposed { epoch: 1 }), "{error}");
    assert_eq!(scratch.query_number("SELECT count(*) FROM femc.log").await, 2);
    assert_eq!(scratch.query_number("SELECT count(*) FROM femc.snapshot").await, 0);
}

#[tokio::test]
async fn a_deposed_leader_does_not_cut_a_damaged_tail() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    append_five_records(&scratch).await;
    scratch.tamper("UPDATE femc.log SET record = '\\x00' WHERE sequence >= 4").await;
    let mut queue =
        standby(&scratch, "http://one").await.with_loss_policy(LossPolicy::Accept).wait_for_lead(|_| ()).await.unwrap();
    scratch.tamper(NEXT_EPOCH).await;
    let error = queue.load().await.unwrap_err();
    assert!(matches!(error, QueueError::Deposed { .. }), "{error}");
    assert_eq!(scratch.query_number("SELECT count(*) FROM femc.log").await, 5);
}

#[tokio::test]
async fn nobody_leads_while_a_write_of_the_leader_before_is_under_way() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let mut queue = patient_leader(&scratch).await;
    scratch
        .tamper(
            "CREATE FUNCTION femc.dawdle() RETURNS trigger LANGUAGE plpgsql AS
             $$ BEGIN PERFORM pg_sleep(0.5); RETURN NEW; END $$;
             CREATE TRIGGER dawdle BEFORE INSERT ON femc.log FOR EACH ROW EXECUTE FUNCTION femc.dawdle()",
        )
        .await;
    let write = tokio::spawn(async move { queue.append(Batch::from_records(&records(1, 2))).await });
    let asleep = "SELECT count(*) FROM pg_stat_activity WHERE wait_event = 'PgSleep' AND datname = current_database()";
    while scratch.query_number(asleep).await == 0 {}
    scratch.tamper(NEXT_EPOCH).await;
    assert_eq!(scratch.query_number("SELECT count(*) FROM femc.log").await, 1, "the write ended before");
    write.await.unwrap().unwrap();
}

#[tokio::test]
async fn a_deposed_leader_hears_of_it_without_writing() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let mut queue = leader(&scratch, "http://one").await;
    queue.check().unwrap();
    scratch.tamper(NEXT_EPOCH).await;
    let error = loop {
        match queue.check() {
            Ok(()) => tokio::time::sleep(Duration::from_millis(10)).await,
            Err(error) => break error,
        }
    };
    assert!(matches!(error, QueueError::Deposed { epoch: 1 }), "{error}");
}

#[tokio::test]
async fn leader_cut_off_during_a_write_stops_before_another_leads() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let mut first = leader(&scratch, "http://one").await;
    let second = standby(&scratch, "http://two").await;
    // This lock blocks appends and heartbeats, like an unreachable database.
    let (held, release) = (scratch.url(), Arc::new(tokio::sync::Notify::new()));
    let until = release.clone();
    let holder = tokio::spawn(async move { femc_queue::testing::lock_table(&held, "femc.leader", until).await });
    let error = loop {
        match first.append(Batch::from_records(&records(1, 2))).await {
            Ok(()) => tokio::task::yield_now().await,
            Err(error) => break error,
        }
    };
    assert!(matches!(error, QueueError::Unreachable { .. }), "{error}");
    let locks = "SELECT count(*) FROM pg_locks, pg_database
                 WHERE locktype = 'advisory' AND database = pg_database.oid AND datname = current_database()";
    assert_eq!(scratch.query_number(locks).await, 1, "it still leads");
    release.notify_one();
    holder.await.unwrap();
    drop(first);
    assert_eq!(second.wait_for_lead(|_| ()).await.unwrap().epoch(), 2);
}

/// The leader runs in its own runtime, which makes progress only while the test runs it: like a stopped process.
#[tokio::test]
async fn a_frozen_leader_is_replaced_and_writes_nothing_when_it_wakes() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let (url, frozen) = (scratch.url(), tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap());
    let (thread, queue) = std::thread::spawn(move || {
        let queue = frozen.block_on(async {
            let first = Standby::open(url.parse().unwrap(), "http://one".into(), SILENCE).await.unwrap();
            let mut queue = first.wait_for_lead(|_| ()).await.unwrap();
            queue.load().await.unwrap();
            queue.append(Batch::from_records(&records(1, 3))).await.unwrap();
            queue
        });
        (frozen, queue)
    })
    .join()
    .unwrap();
    let mut second = standby(&scratch, "http://two").await.wait_for_lead(|_| ()).await.unwrap();
    assert_eq!((second.epoch(), second.load().await.unwrap().records), (2, records(1, 3)));
    let woken = std::thread::spawn(move || {
        let mut queue = queue;
        let refused = [
            queue.check().unwrap_err(),
            thread.block_on(queue.append(Batch::from_records(&records(7, 9)))).unwrap_err(),
            thread.block_on(queue.snapshot(b"stale")).unwrap_err(),
        ];
        thread.block_on(async { drop(queue) });
        refused
    });
    for error in woken.join().unwrap() {
        assert_eq!(error.remedy(), Remedy::Reopen, "{error}");
    }
    second.append(Batch::from_records(&records(3, 4))).await.unwrap();
    assert_eq!(second.load().await.unwrap().records, records(1, 4));
}

async fn open_error(url: &str) -> QueueError {
    Standby::open(url.parse().unwrap(), "http://one".into(), SILENCE).await.map(drop).unwrap_err()
}

#[tokio::test]
async fn wrong_password_or_database_differs_from_an_absent_server() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let url = scratch.url();
    let (head, tail) = url.split_once('@').unwrap();
    let (user, password) = head.rsplit_once(':').unwrap();
    let error = open_error(&format!("{user}:wrong@{tail}")).await;
    assert!(matches!(error, QueueError::Rejected { .. }), "{error}");
    assert!(!error.to_string().contains("wrong"), "{error}");
    let (host, _) = tail.split_once('/').unwrap();
    let error = open_error(&format!("{head}@{host}/no_such_database")).await;
    assert!(matches!(&error, QueueError::Rejected { message, .. } if message.contains("no_such_database")), "{error}");
    assert!(!error.to_string().contains(password), "{error}");
    // A port without a listener: bound, so that no other process takes it.
    let taken = tokio::net::TcpSocket::new_v4().unwrap();
    taken.bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let error = open_error(&format!("postgres://ann:x@{}/farm", taken.local_addr().unwrap())).await;
    assert!(matches!(error, QueueError::Unreachable { .. }), "{error}");
}

#[tokio::test]
async fn commits_wait_for_the_disk_even_where_the_server_would_not() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    scratch
        .tamper(
            "DO $$ BEGIN EXECUTE format('ALTER DATABASE %I SET synchronous_commit = off', current_database()); END $$",
        )
        .await;
    scratch
        .tamper(
            "CREATE SCHEMA seen; CREATE TABLE seen.settings (setting text);
             CREATE FUNCTION seen.note() RETURNS trigger LANGUAGE plpgsql AS
             $$ BEGIN INSERT INTO seen.settings VALUES (current_setting('synchronous_commit')); RETURN NEW; END $$",
        )
        .await;
    let mut queue = leader(&scratch, "http://one").await;
    scratch
        .tamper("CREATE TRIGGER note AFTER INSERT ON femc.log FOR EACH STATEMENT EXECUTE FUNCTION seen.note()")
        .await;
    queue.append(Batch::from_records(&records(1, 3))).await.unwrap();
    assert_eq!(
        scratch.query_number("SELECT count(*) FROM seen.settings WHERE setting = 'on'").await,
        1,
        "one statement a batch"
    );
    assert_eq!(scratch.query_number("SELECT count(*) FROM seen.settings").await, 1);
}

/// Starts a server that refuses TLS.
async fn plain_server() -> String {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(async move {
        while let Ok((mut peer, _)) = listener.accept().await {
            let mut request = [0; 8];
            if peer.read_exact(&mut request).await.is_ok() {
                let _ = peer.write_all(b"N").await;
            }
        }
    });
    address.to_string()
}

#[tokio::test]
async fn encrypted_connection_verifies_server_and_errors_are_final() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let Some((url, authority)) = scratch.encrypted_url() else { return };
    let _leader = Standby::open(url.parse().unwrap(), "http://one".into(), SILENCE).await.unwrap();
    let encrypted = "SELECT count(*) FROM pg_stat_ssl JOIN pg_stat_activity USING (pid)
        WHERE ssl AND application_name = 'femc' AND datname = current_database()";
    assert_eq!(scratch.query_number(encrypted).await, 1);

    let rejected = async |url: &str, reason: &str| {
        let error = open_error(url).await;
        assert!(matches!(&error, QueueError::Rejected { message, .. } if message.contains(reason)), "{url}: {error}");
    };
    // Three errors: the issuer is not trusted; the certificate has another host name; the file does not exist.
    let (open, _) = url.split_once('?').unwrap();
    rejected(&format!("{open}?sslmode=verify-full"), "UnknownIssuer").await;
    let numeric = open.replace("localhost", "127.0.0.1");
    rejected(&format!("{numeric}?sslmode=verify-full&sslrootcert={authority}"), "certificate").await;
    rejected(&format!("{open}?sslmode=verify-full&sslrootcert={authority}.not"), "sslrootcert").await;
    assert_opens(&format!("{numeric}?sslmode=verify-ca&sslrootcert={authority}")).await;
    assert_opens(&format!("{numeric}?sslmode=require")).await;
    rejected(&format!("postgres://ann@{}/farm?sslmode=require", plain_server().await), "does not support TLS").await;
}

async fn assert_opens(url: &str) {
    Standby::open(url.parse().unwrap(), "http://one".into(), SILENCE).await.map(drop).unwrap();
}

/// Records of up to 1 MiB, several at a time, and thousands of small ones: no append hangs.
#[tokio::test]
async fn an_encrypted_log_takes_what_a_farm_writes() {
    let Some(scratch) = ScratchDatabase::new().await else { return };
    let Some((url, _)) = scratch.encrypted_url() else { return };
    let open = async || {
        let standby = Standby::open(url.parse().unwrap(), "http://one".into(), Postgres::SILENCE).await.unwrap();
        let mut queue = standby.wait_for_lead(|_| ()).await.unwrap();
        let contents = queue.load().await.unwrap();
        (queue, contents)
    };
    let (mut queue, _) = open().await;
    let sizes = (0..600_usize).map(|turn| if turn % 50 == 0 { 1 << (10 + turn / 50 % 11) } else { turn });
    let all: Vec<Vec<u8>> = sizes.map(|size| vec![size as u8; size]).collect();
    for records in all.chunks(3) {
        queue.append(Batch::from_records(records)).await.unwrap();
    }
    drop(queue);
    let (mut queue, contents) = open().await;
    assert_eq!(contents.records, all);
    queue.snapshot(&vec![7; 3 << 20]).await.unwrap();
    queue.append(Batch::from_records(&all[..1])).await.unwrap();
    drop(queue);
    let (_, contents) = open().await;
    assert_eq!((contents.snapshot.map(|state| state.len()), contents.records), (Some(3 << 20), all[..1].to_vec()));
}
