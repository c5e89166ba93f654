//! Crash and damage tests of a log in SQLite: killed at every write, with a flipped bit, truncated, or without one of its files.
//!
//! The rule: a log that opens equals the model at the end of a batch, and not before the last acknowledged batch. If only the
//! process was killed, the log opens without help. If a file is damaged, the log may be refused instead.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::common::{LogModel, OwnedBatch, SplitMix64};
use femc_queue::{LogContents, LossPolicy, MissingRecords, Queue, QueueError, Sqlite};
use tempfile::TempDir;

/// Contents of a log's files; `None`: the file does not exist.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct LogFiles {
    log: Option<Vec<u8>>,
    ahead: Option<Vec<u8>>,
    mark: Option<Vec<u8>>,
}

const SUFFIXES: [&str; 3] = ["", "-wal", "-mark"];
/// Sizes in bytes of the write-ahead log's header, and of a frame with a page of 4096 bytes.
const HEADER: usize = 32;
const FRAME: usize = 24 + 4096;

fn sibling_path(path: &Path, end: &str) -> PathBuf {
    let mut name = path.to_owned().into_os_string();
    name.push(end);
    name.into()
}

impl LogFiles {
    fn read(path: &Path) -> Self {
        let [log, ahead, mark] = SUFFIXES.map(|end| std::fs::read(sibling_path(path, end)).ok());
        Self { log, ahead, mark }
    }

    fn contents_mut(&mut self) -> [&mut Option<Vec<u8>>; 3] {
        [&mut self.log, &mut self.ahead, &mut self.mark]
    }

    fn write(&self, path: &Path) {
        for (end, bytes) in SUFFIXES.iter().zip(self.clone().contents_mut()) {
            if let Some(bytes) = bytes {
                std::fs::write(sibling_path(path, end), bytes).unwrap();
            }
        }
    }

    /// Opens a log from these files and returns its contents.
    async fn open(&self) -> Result<LogContents, QueueError> {
        self.open_with(LossPolicy::Refuse).await
    }

    async fn open_with(&self, loss: LossPolicy) -> Result<LogContents, QueueError> {
        let folder = temp_folder();
        let path = folder.path().join("log");
        self.write(&path);
        let mut queue = Sqlite::open_with(&path, loss).await?;
        let contents = queue.load().await?;
        queue.close().await?;
        Ok(contents)
    }
}

/// Creates a temporary folder, in memory if possible: these tests do not test syncs of a disk.
fn temp_folder() -> TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// An operation on a log.
#[derive(Debug, Clone)]
enum Operation {
    Append(OwnedBatch),
    Snapshot(Vec<u8>),
}

impl Operation {
    fn random(rng: &mut SplitMix64) -> Self {
        if rng.below(7) == 0 { Self::Snapshot(rng.bytes(20_000)) } else { Self::Append(OwnedBatch::random(rng)) }
    }

    async fn apply(&self, queue: &mut Sqlite, model: &mut LogModel) {
        match self {
            Self::Append(batch) => {
                queue.append(batch.batch()).await.unwrap();
                model.append(batch);
            }
            Self::Snapshot(state) => {
                queue.snapshot(state).await.unwrap();
                model.snapshot(state.clone());
            }
        }
    }
}

/// Runs the operations. Returns the log's files and its model after each of them; the files are as a kill would leave them.
async fn record_states(operations: &[Operation]) -> Vec<(LogFiles, LogModel)> {
    let folder = temp_folder();
    let path = folder.path().join("log");
    let (mut queue, mut model) = (Sqlite::open(&path).await.unwrap(), LogModel::default());
    queue.load().await.unwrap();
    let mut states = vec![(LogFiles::read(&path), model.clone())];
    for operation in operations {
        operation.apply(&mut queue, &mut model).await;
        states.push((LogFiles::read(&path), model.clone()));
    }
    queue.close().await.unwrap();
    states.push((LogFiles::read(&path), model));
    states
}

fn operations(seed: u64, count: usize) -> Vec<Operation> {
    let mut rng = SplitMix64(seed);
    (0..count).map(|_| Operation::random(&mut rng)).collect()
}

fn matches_model(contents: &LogContents, model: &LogModel) -> bool {
    contents.records == model.records && contents.snapshot == model.snapshot && contents.missing.is_none()
}

/// Returns every `step`-th intermediate state of the files between two operations. Each write of SQLite continues where the
/// previous write ended.
fn intermediate_states(before: &LogFiles, after: &LogFiles, step: usize) -> Vec<LogFiles> {
    let (old, new) = (before.ahead.clone().unwrap_or_default(), after.ahead.clone().unwrap_or_default());
    let same = old.iter().zip(&new).take_while(|(old, new)| old == new).count();
    let frames = (0..).map(|frame| HEADER + frame * FRAME).take_while(|end| *end <= new.len());
    let within = [1, 24, 2000, FRAME - 1];
    let cuts = frames.flat_map(|end| std::iter::once(end).chain(within.map(|more| end + more)));
    let cuts = cuts.chain([0, 1, 20, HEADER - 1]).filter(|cut| (same..=new.len()).contains(cut)).step_by(step);
    let mut all: Vec<LogFiles> = cuts
        .map(|cut| {
            let ahead = [&new[..cut], old.get(cut..).unwrap_or_default()].concat();
            LogFiles { ahead: Some(ahead), ..before.clone() }
        })
        .collect();
    // Then pages are copied into the main file, one after the other.
    let (old, new) = (before.log.clone().unwrap_or_default(), after.log.clone().unwrap_or_default());
    let mut log = old.clone();
    let pages = (0..new.len()).step_by(4096).filter(|&at| old.get(at..at + 4096) != new.get(at..at + 4096));
    for (number, at) in pages.enumerate() {
        log.resize(log.len().max(at + 4096), 0);
        log[at..at + 4096].copy_from_slice(&new[at..at + 4096]);
        if number % step > 0 {
            continue;
        }
        for mark in [&before.mark, &after.mark] {
            all.push(LogFiles { log: Some(log.clone()), ahead: after.ahead.clone(), mark: mark.clone() });
        }
    }
    all.push(LogFiles { mark: before.mark.clone(), ..after.clone() });
    all
}

async fn check_kills(operations: &[Operation], when: &str) {
    let states = record_states(operations).await;
    let mut opened = [0, 0];
    for (step, pair) in states.windows(2).enumerate().take(operations.len()) {
        let [(before, acknowledged), (after, unacknowledged)] = pair else { unreachable!("windows of two") };
        for files in intermediate_states(before, after, 1) {
            let contents = files.open().await.unwrap_or_else(|error| panic!("{when}, step {step}: {error}"));
            let model_index =
                [unacknowledged, acknowledged].into_iter().position(|model| matches_model(&contents, model));
            opened[model_index.unwrap_or_else(|| panic!("{when}, step {step}: {} records", contents.records.len()))] +=
                1;
        }
    }
    for (files, model) in &states {
        model.check(&files.open().await.unwrap(), when);
    }
    assert!(opened[0] > 0 && opened[1] > 0, "{opened:?}");
}

#[tokio::test]
async fn log_killed_at_any_write_reopens_with_all_acknowledged() {
    for seed in 0..4 {
        check_kills(&operations(seed, 14), &format!("seed {seed}")).await;
    }
}

#[tokio::test]
#[ignore = "minutes"]
async fn log_killed_at_any_write_reopens_with_many_seeds() {
    for seed in 100..160 {
        check_kills(&operations(seed, 20), &format!("seed {seed}")).await;
    }
}

/// The records are so large that SQLite checkpoints by itself and restarts its write-ahead log from the beginning.
#[tokio::test]
async fn log_killed_during_a_checkpoint_holds_all_acknowledged() {
    let large =
        |byte: u8| Operation::Append(OwnedBatch { records: vec![vec![byte; 1 << 20]; 3], ..OwnedBatch::default() });
    let operations = [large(1), large(2), large(3), Operation::Snapshot(vec![4; 100]), large(5), large(6)];
    let states = record_states(&operations).await;
    let mut is_brought_in = false;
    for pair in states.windows(2).take(operations.len()) {
        let [(before, acknowledged), (after, unacknowledged)] = pair else { unreachable!("windows of two") };
        is_brought_in |= before.log != after.log;
        for files in intermediate_states(before, after, 300) {
            let contents = files.open().await.unwrap();
            assert!(matches_model(&contents, acknowledged) || matches_model(&contents, unacknowledged));
        }
    }
    assert!(is_brought_in, "SQLite brought no page into the log before its end");
}

/// Checks the rule for damaged files. Returns whether the log was refused.
async fn check_damaged(files: &LogFiles, model: &LogModel, damage: &str) -> bool {
    match files.open().await {
        Ok(contents) => {
            let counts = (contents.records.len(), model.records.len());
            assert!(
                matches_model(&contents, model),
                "{damage}: opens without a word, with {} of {} records",
                counts.0,
                counts.1
            );
            false
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            true
        }
    }
}

async fn check_flips(files: &LogFiles, model: &LogModel, every: usize, when: &str) {
    for (file, end) in SUFFIXES.iter().enumerate() {
        let mut damaged = files.clone();
        let Some(bits) = damaged.contents_mut()[file].as_ref().map(|bytes| 8 * bytes.len()) else { continue };
        let mut refused = 0;
        // An odd step, so that the position of the bit within its byte varies.
        for bit in (0..bits).step_by(every | 1) {
            let mut damaged = files.clone();
            if let Some(bytes) = damaged.contents_mut()[file] {
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
            refused += usize::from(check_damaged(&damaged, model, &format!("{when}: bit {bit} of log{end}")).await);
        }
        assert!(refused > 0 || *end == "-mark", "{when}: no bit of log{end} counts");
    }
}

#[tokio::test]
async fn flipped_bit_loses_nothing_acknowledged_silently() {
    let states = record_states(&operations(7, 12)).await;
    for (files, model) in &states[states.len() - 2..] {
        check_flips(files, model, 1500, "seed 7").await;
    }
}

#[tokio::test]
#[ignore = "minutes"]
async fn flipped_bit_loses_nothing_silently_with_many_seeds() {
    for seed in 200..212 {
        let states = record_states(&operations(seed, 12)).await;
        for (files, model) in &states[states.len() - 2..] {
            check_flips(files, model, 200, &format!("seed {seed}")).await;
        }
    }
}

#[tokio::test]
async fn short_or_missing_file_loses_nothing_acknowledged_silently() {
    let states = record_states(&operations(8, 12)).await;
    for (files, model) in &states[states.len() - 2..] {
        for (file, end) in SUFFIXES.iter().enumerate() {
            let whole = files.clone().contents_mut()[file].clone().unwrap_or_default();
            let steps = (0..whole.len()).step_by(whole.len() / 60 + 1);
            for length in steps.map(Some).chain([None]) {
                let mut damaged = files.clone();
                *damaged.contents_mut()[file] = length.map(|length| whole[..length].to_vec());
                if end.is_empty() && length == Some(0) && files.mark.is_none() {
                    continue;
                }
                check_damaged(&damaged, model, &format!("{length:?} bytes of log{end}")).await;
            }
        }
    }
}

#[tokio::test]
async fn earlier_file_among_later_loses_nothing_acknowledged_silently() {
    let states = record_states(&operations(9, 12)).await;
    let (last, model) = &states[states.len() - 2];
    for (earlier, _) in &states[..states.len() - 2] {
        for (file, end) in SUFFIXES.iter().enumerate() {
            let mut mixed = last.clone();
            mixed.contents_mut()[file].clone_from(earlier.clone().contents_mut()[file]);
            let is_refused = check_damaged(&mixed, model, &format!("an earlier log{end}")).await;
            assert!(!is_refused || *end != "-mark", "an earlier mark asks for less than there is");
        }
    }
}

#[tokio::test]
async fn flipped_bit_in_the_wal_is_a_reported_and_acceptable_loss() {
    let folder = temp_folder();
    let path = folder.path().join("log");
    let mut queue = Sqlite::open(&path).await.unwrap();
    queue.load().await.unwrap();
    let incarnation = queue.reserve(1).await.unwrap();
    for byte in 0..8 {
        queue.append(femc_queue::Batch::from_records(&[vec![byte; 3000]])).await.unwrap();
    }
    let mut files = LogFiles::read(&path);
    let ahead = files.ahead.as_mut().unwrap();
    let middle = ahead.len() / 2;
    ahead[middle] ^= 4;
    drop(queue);

    let folder = temp_folder();
    let path = folder.path().join("log");
    files.write(&path);
    let damaged = files.ahead.clone();
    for _ in 0..2 {
        let error = open_at(&path, LossPolicy::Refuse).await.map(drop).unwrap_err();
        let QueueError::MissingRecords { kept, known: 8, .. } = error else { panic!("{error}") };
        assert!((1..8).contains(&kept));
        assert_eq!(std::fs::read(sibling_path(&path, "-wal-lost")).ok(), damaged, "nothing is thrown away");
    }
    let (mut queue, contents) = open_at(&path, LossPolicy::Accept).await.unwrap();
    let Some(MissingRecords { last_existing: kept, last_known: Some(8) }) = contents.missing else {
        panic!("{:?}", contents.missing)
    };
    assert_eq!(contents.records.len() as i64, kept);
    assert!(queue.reserve(1).await.unwrap() > incarnation, "somebody has had it");
    queue.append(femc_queue::Batch::from_records(&[vec![9]])).await.unwrap();
    queue.close().await.unwrap();
    let (_, contents) = open_at(&path, LossPolicy::Refuse).await.unwrap();
    assert_eq!((contents.records.len() as i64, contents.missing), (kept + 1, None));
}

/// Opens and loads the log at `path`. Retries while it is in use, because a dropped connection closes in the background.
async fn open_at(path: &Path, loss: LossPolicy) -> Result<(Sqlite, LogContents), QueueError> {
    let mut queue = loop {
        match Sqlite::open_with(path, loss).await {
            Err(QueueError::InUse { .. }) => tokio::task::yield_now().await,
            other => break other?,
        }
    };
    let contents = queue.load().await?;
    Ok((queue, contents))
}

#[tokio::test]
async fn missing_log_with_mark_is_reported_and_closed_log_moves_alone() {
    let states = record_states(&operations(3, 10)).await;
    let (closed, model) = states.last().unwrap();
    let gone = LogFiles { mark: closed.mark.clone(), ..LogFiles::default() };
    assert!(matches!(gone.open().await.unwrap_err(), QueueError::MissingRecords { kept: 0, .. }));
    assert!(gone.open_with(LossPolicy::Accept).await.unwrap().missing.is_some());
    let alone = LogFiles { log: closed.log.clone(), ..LogFiles::default() };
    model.check(&alone.open().await.unwrap(), "moved");
    let (killed, _) = &states[states.len() - 2];
    let alone = LogFiles { log: killed.log.clone(), ..LogFiles::default() };
    assert!(matches!(alone.open().await.unwrap_err(), QueueError::Unverifiable { .. }), "it was not closed");
}

#[tokio::test]
async fn restored_copy_is_another_log_with_its_own_incarnations() {
    let folder = temp_folder();
    let path = folder.path().join("log");
    let (mut queue, _) = open_at(&path, LossPolicy::Refuse).await.unwrap();
    assert_eq!((queue.reserve(1).await.unwrap(), queue.reserve(1).await.unwrap()), (1, 2), "one after the other");
    queue.append(femc_queue::Batch::from_records(&[vec![1]])).await.unwrap();
    let mut copy = Vec::new();
    std::io::Read::read_to_end(&mut queue.copy().await.unwrap(), &mut copy).unwrap();
    queue.append(femc_queue::Batch::from_records(&[vec![2]])).await.unwrap();
    queue.close().await.unwrap();
    for mark in [std::fs::read(sibling_path(&path, "-mark")).ok(), None] {
        let restored = temp_folder();
        let path = restored.path().join("log");
        LogFiles { log: Some(copy.clone()), ahead: None, mark }.write(&path);
        let (mut queue, contents) = open_at(&path, LossPolicy::Refuse).await.unwrap();
        assert_eq!((contents.records, contents.missing), (vec![vec![1]], None));
        let incarnation = queue.reserve(2).await.unwrap();
        assert!(incarnation > 1000, "more than the log may have had since: {incarnation}");
        assert_eq!(queue.reserve(2).await.unwrap(), incarnation + 1);
    }
}

/// Child process of the tests below: appends until it is killed, and prints the numbers of the durable batches.
#[tokio::test]
async fn child() {
    let Some(path) = std::env::var_os("FEMC_QUEUE_CHILD") else { return };
    let mut queue = Sqlite::open(Path::new(&path)).await.unwrap();
    queue.load().await.unwrap();
    for number in 0_u32..40 {
        if number % 16 == 15 {
            queue.snapshot(&number.to_le_bytes()).await.unwrap();
        }
        queue.append(femc_queue::Batch::from_records(&[number.to_le_bytes().to_vec(), vec![7; 200]])).await.unwrap();
        println!("durable {number}");
    }
    queue.close().await.unwrap();
}

/// Runs `command`. Returns the last acknowledged batch, and the log's contents afterward.
async fn run_child(command: &mut Command, path: &Path, kill_after: Option<u32>) -> (Option<u32>, LogContents) {
    let mut child = command.env("FEMC_QUEUE_CHILD", path).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut durable = None;
    for line in BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok) {
        durable = line.rsplit_once("durable ").and_then(|(_, number)| number.parse().ok()).or(durable);
        if kill_after.is_some() && durable >= kill_after {
            child.kill().unwrap();
        }
    }
    child.wait().unwrap();
    (durable, open_at(path, LossPolicy::Refuse).await.unwrap().1)
}

fn check_durable(durable: Option<u32>, contents: &LogContents, when: &str) {
    let snapshot = contents.snapshot.as_ref().map(|state| u32::from_le_bytes(state[..].try_into().unwrap()));
    let numbers: Vec<u32> =
        contents.records.iter().step_by(2).map(|record| u32::from_le_bytes(record[..].try_into().unwrap())).collect();
    let first = snapshot.unwrap_or(0);
    let expected: Vec<u32> = (first..).take(numbers.len()).collect();
    assert_eq!((contents.records.len() % 2, &numbers), (0, &expected), "{when}: whole batches, in order");
    let there = numbers.last().copied().or_else(|| first.checked_sub(1));
    assert!(
        there >= durable && there <= durable.map_or(Some(0), |number| Some(number + 1)),
        "{when}: {there:?} of {durable:?}"
    );
}

#[tokio::test]
async fn process_killed_at_any_time_loses_nothing_durable() {
    let folder = temp_folder();
    for batch in [0, 1, 7, 14, 15, 16, 30, 39] {
        let path = folder.path().join(format!("log{batch}"));
        let mut command = Command::new(std::env::current_exe().unwrap());
        let command = command.args(["--exact", "crash::child", "--nocapture"]);
        let (durable, contents) = run_child(command, &path, Some(batch)).await;
        assert!(durable >= Some(batch));
        check_durable(durable, &contents, &format!("batch {batch}"));
    }
}

/// Kills the child process as it enters its n-th system call that changes a file, for each n of `calls`.
async fn check_kills_at_calls(calls: impl Iterator<Item = usize>) {
    let folder = temp_folder();
    let changes = "pwrite64,write,fsync,fdatasync,ftruncate,unlink,rename";
    let strace = |path: &Path, at: usize| {
        let mut strace = Command::new("strace");
        strace.args(["-f", "-qq", "-o", "/dev/null", "-P"]).arg(path);
        for end in ["-wal", "-mark", "-mark.new"] {
            strace.arg("-P").arg(sibling_path(path, end));
        }
        strace.arg("-e").arg(format!("inject={changes}:signal=KILL:when={at}"));
        strace.arg(std::env::current_exe().unwrap()).args(["--exact", "crash::child", "--nocapture"]);
        strace
    };
    let works = Command::new("strace").args(["-f", "-qq", "true"]).stderr(Stdio::null()).status();
    if !works.is_ok_and(|status| status.success()) {
        println!("skipped: strace is not here, or may not trace");
        return;
    }
    let mut cut_short = 0;
    for call in calls {
        let path = folder.path().join(format!("log{call}"));
        let (durable, contents) = run_child(&mut strace(&path, call), &path, None).await;
        check_durable(durable, &contents, &format!("call {call}"));
        cut_short += usize::from(durable < Some(39));
    }
    assert!(cut_short > 0, "nobody was killed");
}

#[tokio::test]
async fn process_killed_at_a_file_change_loses_nothing_durable() {
    check_kills_at_calls([1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 200].into_iter()).await;
}

#[tokio::test]
#[ignore = "minutes"]
async fn process_killed_at_every_file_change_loses_nothing_durable() {
    check_kills_at_calls(1..500).await;
}
