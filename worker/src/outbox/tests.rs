use std::fs::{self, File};
use std::sync::Arc;

use femc_model::{
    Artifact, Assignment, Digest, Graph, Grid, JobId, JobNotes, JobSpec, NextRound, Output, Role, Stage, StageKind,
    StepsTaken, TaskResult, TaskSpec,
};
use femc_proto::Client;

use super::folder::{Files, remove_leftover};
use super::*;
use crate::config::OutboxConflict;
use crate::execute::Product;
use crate::meter::Meter;

fn spec() -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: Digest::compute(b"bundle"),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![1],
        grid: Grid { film: [16, 16], tile: 16 },
        graph: Graph::default(),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

/// Returns a finished task whose client is never used.
pub(crate) async fn task(index: u32, bytes: &'static [u8]) -> Arc<Task> {
    let stage = Stage { frame: 1, round: 0, number: 0, kind: StageKind::Render };
    let task = TaskKey { job: JobId(3), stage, index };
    let (inputs, taken, more) = (Vec::new(), StepsTaken::default(), NextRound::Impossible);
    let work = TaskSpec {
        item: index,
        steps: 0..4,
        inputs,
        hints: Vec::new(),
        steps_taken: taken,
        next_round: more,
        elapsed: 0,
        busy_seconds: 0.0,
    };
    let assignment = Assignment { task, epoch: Epoch(9), lease: 5000, copy_of: None, spec: work };
    let dial = femc_proto::Dialer::from_fn(|_, _| {
        let (near, far) = tokio::io::duplex(1 << 16);
        // The other end never answers and never closes the connection.
        std::mem::forget(far);
        Box::pin(async { Ok(femc_proto::ByteStream::new(near)) })
    });
    let client = Client::connect_with(&dial, "http://nobody:1").await.unwrap();
    let task = Task::new(assignment, Arc::new(spec()), client, &Meter::without_clock());
    let output = Output { role: Role::Tile, artifact: Artifact::from_bytes(bytes) };
    let result = TaskResult { outputs: vec![output], units: 4, seconds: 0.5, ..TaskResult::default() };
    task.begin();
    task.set_final_log(0.5, "done".into());
    task.set_outcome(Ok(Product { result, artifacts: vec![Bytes::from_static(bytes)] }));
    Arc::new(task)
}

fn open(config: &OutboxConfig) -> Result<(Outbox, Vec<RestoredResult>), WorkerError> {
    Outbox::open_folder(config, crate::engine().into())
}

fn config(folder: &Path) -> OutboxConfig {
    OutboxConfig { folder: folder.join("box"), limit: 10_000, on_conflict: OutboxConflict::Fail }
}

fn indices(restored: &[RestoredResult]) -> Vec<(u32, &[u8])> {
    restored.iter().map(|r| (r.assignment.task.index, &r.product.artifacts[0][..])).collect()
}

#[tokio::test]
async fn only_unacknowledged_results_survive_restart() {
    let place = tempfile::tempdir().unwrap();
    let (outbox, restored) = open(&config(place.path())).unwrap();
    assert!(restored.is_empty());
    let (first, second) = (task(1, b"first").await, task(2, b"second").await);
    outbox.store(&first);
    outbox.store(&second);
    outbox.remove_answered(&TaskTable::default(), &first.key());
    outbox.close();
    let (outbox, restored) = open(&config(place.path())).unwrap();
    assert_eq!(indices(&restored), [(2, &b"second"[..])]);
    assert_eq!((&restored[0].spec, &restored[0].assignment), (&*second.spec, &second.assignment));
    assert_eq!((restored[0].usage.map(|usage| usage.wall), &restored[0].log), (Some(0.5), &Some((0.5, "done".into()))));
    outbox.remove_answered(&TaskTable::default(), &second.key());
    outbox.close();
    assert!(open(&config(place.path())).unwrap().1.is_empty());
}

#[tokio::test]
async fn torn_or_changed_file_is_removed_and_others_are_read() {
    let place = tempfile::tempdir().unwrap();
    let (outbox, _) = open(&config(place.path())).unwrap();
    for index in 1..=3 {
        outbox.store(&task(index, b"tile").await);
    }
    outbox.close();
    let folder = place.path().join("box");
    let file = |index: u32| folder.join(format!("3-1.0-render.0-{index}.9.done"));
    let whole = fs::read(file(1)).unwrap();
    for end in 0..whole.len() {
        assert!(decode(&whole[..end].to_vec().into(), crate::engine()).is_none(), "cut at {end}");
    }
    let mut changed = whole.clone();
    changed[whole.len() - 1] ^= 1;
    fs::write(file(1), changed).unwrap();
    fs::write(file(3), &whole[..whole.len() / 2]).unwrap();
    fs::write(folder.join("half.new"), b"half").unwrap();
    let (_, restored) = open(&config(place.path())).unwrap();
    assert_eq!(indices(&restored), [(2, &b"tile"[..])]);
    assert!(!file(1).exists() && !file(3).exists() && file(2).exists() && !folder.join("half.new").exists());
}

#[tokio::test]
async fn a_folder_serves_one_worker_and_holds_no_more_than_its_limit() {
    let place = tempfile::tempdir().unwrap();
    let small = OutboxConfig { limit: 1000, ..config(place.path()) };
    let (outbox, _) = open(&small).unwrap();
    let taken = open(&small).unwrap_err();
    assert!(taken.to_string().contains("another worker"), "{taken}");
    let next = OutboxConfig { on_conflict: OutboxConflict::NextFree, ..small.clone() };
    let (second, _) = open(&next).unwrap();
    assert!(place.path().join("box-2").is_dir());
    static LARGE: [u8; 600] = [7; 600];
    outbox.store(&task(1, &LARGE).await);
    outbox.store(&task(2, &LARGE).await);
    outbox.close();
    second.close();
    let (_, restored) = open(&small).unwrap();
    assert_eq!(indices(&restored), [(1, &LARGE[..])]);
}

#[tokio::test]
async fn old_named_result_is_read_and_removed_when_acknowledged() {
    let place = tempfile::tempdir().unwrap();
    let (outbox, _) = open(&config(place.path())).unwrap();
    let kept = task(1, b"tile").await;
    outbox.store(&kept);
    outbox.close();
    let folder = place.path().join("box");
    fs::rename(folder.join("3-1.0-render.0-1.9.done"), folder.join("3-1.0-render-1.9.done")).unwrap();
    let (outbox, restored) = open(&config(place.path())).unwrap();
    assert_eq!(indices(&restored), [(1, &b"tile"[..])]);
    outbox.remove_answered(&TaskTable::default(), &kept.key());
    outbox.close();
    assert_eq!(files(place.path()), ["lock"]);
}

fn files(folder: &Path) -> Vec<String> {
    let names = fs::read_dir(folder.join("box")).unwrap().map(|entry| entry.unwrap().file_name());
    let mut names: Vec<String> = names.map(|name| name.into_string().unwrap()).collect();
    names.sort();
    names
}

#[tokio::test]
async fn what_cannot_be_written_to_its_end_leaves_nothing_behind() {
    let place = tempfile::tempdir().unwrap();
    let (outbox, _) = open(&config(place.path())).unwrap();
    // A folder blocks the first result's path, so that its rename fails as on a full disk.
    let taken = "3-1.0-render.0-1.9.done";
    fs::create_dir(place.path().join("box").join(taken)).unwrap();
    outbox.store(&task(1, b"first").await);
    outbox.store(&task(2, b"second").await);
    outbox.close();
    assert_eq!(files(place.path()), [taken, "3-1.0-render.0-2.9.done", "lock"]);
    let (_, restored) = open(&config(place.path())).unwrap();
    assert_eq!(indices(&restored), [(2, &b"second"[..])], "what cannot be read stops nobody");
}

#[tokio::test]
async fn the_limit_counts_whole_files() {
    let place = tempfile::tempdir().unwrap();
    let first = task(1, b"first").await;
    let Some(Ok(product)) = first.outcome() else { panic!("it is done") };
    let size = encode(&first, product, crate::engine()).unwrap().len() as u64;
    let config = OutboxConfig { limit: 2 * size, ..config(place.path()) };
    let (outbox, _) = open(&config).unwrap();
    for index in 1..=3 {
        outbox.store(&task(index, b"first").await);
    }
    outbox.close();
    assert_eq!(files(place.path()).len(), 2 + 1, "two results and the lock");
}

#[tokio::test]
async fn unremovable_result_still_takes_room_and_removed_one_does_not() {
    let place = tempfile::tempdir().unwrap();
    let lock = File::create(place.path().join("lock")).unwrap();
    let folder = place.path().to_owned();
    let mut writer = ResultWriter {
        folder,
        engine: crate::engine().into(),
        limit: 1 << 20,
        used: 0,
        files: Files::new(),
        _lock: lock,
    };
    let tasks = [task(1, b"first").await, task(2, b"second").await];
    assert!(tasks.iter().all(|task| writer.store(task)));
    let sizes = tasks.each_ref().map(|task| fs::metadata(writer.path(&task.key())).unwrap().len());
    assert_eq!(writer.used, sizes.iter().sum::<u64>());
    // A folder cannot be removed as a file.
    let stuck = writer.path(&tasks[0].key());
    fs::remove_file(&stuck).unwrap();
    fs::create_dir(&stuck).unwrap();
    writer.remove(&tasks[0].key());
    assert_eq!(writer.used, sizes.iter().sum::<u64>());
    writer.remove(&tasks[1].key());
    assert_eq!(writer.used, sizes[0]);
    // The remains of a failed write count only if they cannot be removed.
    let left = place.path().join("left.new");
    fs::write(&left, [0; 100]).unwrap();
    assert_eq!((remove_leftover(&left), left.exists(), remove_leftover(&left)), (0, false, 0));
}

#[tokio::test]
async fn who_is_answered_leaves_the_line_and_the_line_ends() {
    let place = tempfile::tempdir().unwrap();
    let (outbox, _) = open(&config(place.path())).unwrap();
    let Outbox::Folder(queue) = outbox.clone() else { panic!("a folder") };
    let tasks = [task(1, b"first").await, task(2, b"second").await];
    // Simulate a slow disk: the writer has the first result and is still writing.
    let mut line = PendingWrites::default();
    tasks.iter().for_each(|task| line.to_write.push_back(task.clone()));
    assert!(matches!(line.next(), Some(WriterAction::Write(task)) if task.key() == tasks[0].key()));
    *queue.pending() = line;
    for task in &tasks {
        outbox.remove_answered(&TaskTable::default(), &task.key());
    }
    {
        let line = queue.pending();
        assert!(line.to_write.is_empty(), "what was answered is not written any more");
        // The first result is on disk. The second is too if the writer took it before its answer arrived.
        assert!(
            line.on_disk.is_empty() && line.to_remove.len() <= tasks.len(),
            "what may be on the disk goes: {line:?}"
        );
    }
    let many = task(3, b"third").await;
    queue.pending().to_write = std::iter::repeat_n(many.clone(), MAX_QUEUED).collect();
    outbox.store(&many);
    assert!(queue.pending().to_write.len() <= MAX_QUEUED);
    outbox.remove_answered(&TaskTable::default(), &many.key());
    outbox.close();
}

#[tokio::test]
async fn answer_during_handover_of_result_leaves_no_file() {
    let place = tempfile::tempdir().unwrap();
    let (outbox, _) = open(&config(place.path())).unwrap();
    let (table, first) = (Arc::new(TaskTable::default()), task(1, b"first").await);
    table.insert_finished(first.clone());
    let Outbox::Folder(queue) = outbox.clone() else { panic!("a folder") };
    let answering = {
        // While the line is locked, the answer is blocked just before it.
        let _line = queue.pending();
        let answering = std::thread::spawn({
            let (outbox, table, key) = (outbox.clone(), table.clone(), first.key());
            move || outbox.remove_answered(&table, &key).is_some()
        });
        for _ in 0..1000 {
            if first.is_cancelled() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        assert!(first.is_cancelled(), "who looks now, and keeps it, keeps it for ever");
        answering
    };
    assert!(answering.join().unwrap());
    outbox.store(&first);
    outbox.close();
    assert_eq!(files(place.path()), ["lock"]);
}
