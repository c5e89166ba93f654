//! Tests of the shared job with processes that are killed: 64 blocks of exact arithmetic iterate five times, once for two jobs.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::common::{TestFolder, TestProcess, start_coordinator};
use bytes::Bytes;
use femc_model::{
    Artifact, Control, Graph, Grid, JobId, JobNotes, JobSpec, JobState, Need, Reach, Role, Round, Scope, StageKind,
    StageTemplate, TaskKey, TaskSizes,
};
use femc_proto::Client;
use femc_queue::Queue as _;
use femc_schedule::Fact;

const BLOCKS: u32 = 64;
const ROUNDS: u32 = 5;
const NUMBERS: usize = 128;
const SEED: u64 = 0x5eed;

/// Returns a graph: blocks that read all blocks of the previous round, a field that reads the blocks of the last round, and an
/// answer per frame that reads the field.
fn graph() -> Graph {
    let drill =
        |scope, tasks, makes: &[Role]| StageTemplate::new(StageKind::Drill, scope, TaskSizes::even(tasks, 1), makes);
    let carried = Need { stage: 0, role: Role::Numbers, reach: Reach::All, round: Round::Previous, gaps: false };
    Graph {
        stages: vec![
            drill(Scope::Content, BLOCKS, &[Role::Numbers]).with_need(carried),
            drill(Scope::Content, 1, &[]).with_input(0, Role::Numbers, Reach::All).with_loop(0, ROUNDS),
            drill(Scope::Content, 1, &[Role::Numbers]).with_input(0, Role::Numbers, Reach::All),
            drill(Scope::Frame, 1, &[Role::Answer]).with_input(2, Role::Numbers, Reach::All),
        ],
    }
}

fn job(name: &str, bundle: Artifact, frames: &[u32]) -> JobSpec {
    let mut spec = JobSpec {
        name: name.into(),
        bundle: bundle.digest,
        entry: "drill".into(),
        settings: format!(r#"{{"drill":{{"seed":{SEED},"numbers":{NUMBERS},"milliseconds":20}}}}"#),
        frames: frames.to_vec(),
        grid: Grid { film: [1, 1], tile: 1 },
        graph: graph(),
        contents: vec![],
        priority: 50,
        owner: name.into(),
        tags: vec![],
        notes: JobNotes::default(),
    };
    let key = femc_worker::drill_key(&spec).expect("a drill");
    spec.contents = vec![(frames.len() as u32, key)];
    spec
}

/// SplitMix64.
fn splitmix64(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

/// Computes the expected answer of a frame directly.
fn answer(frame: u32) -> Vec<u8> {
    let own = |item: u64, frame: u32| splitmix64(item << 32 | u64::from(frame));
    let mut blocks: Vec<Vec<u64>> = (0..u64::from(BLOCKS))
        .map(|block| {
            (0..NUMBERS as u64)
                .map(|place| splitmix64(splitmix64(SEED ^ splitmix64(place)).wrapping_add(own(block, 0))))
                .collect()
        })
        .collect();
    let joined = |blocks: &[Vec<u64>], own: u64| -> Vec<u64> {
        let sum = |place: usize| {
            let times = (0u64..).map(|block| 2 * block + 1);
            blocks
                .iter()
                .zip(times)
                .fold(0u64, |sum, (block, times)| sum.wrapping_add(block[place].wrapping_mul(times)))
        };
        (0..NUMBERS).map(|place| splitmix64(sum(place).wrapping_add(own))).collect()
    };
    for _ in 1..ROUNDS {
        blocks = (0..u64::from(BLOCKS)).map(|block| joined(&blocks, own(block, 0))).collect();
    }
    let field = joined(&blocks, own(0, 0));
    joined(&[field], own(0, frame)).iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn worker(dir: &TestFolder, url: &str) -> TestProcess {
    dir.start(&format!("worker --join {url} --threads 1"))
}

/// Checks in the log that the shared work began once, and that each of its tasks counts once.
async fn assert_done_once(dir: &TestFolder) {
    let mut log = femc_queue::Sqlite::open(&dir.path("farm.db")).await.expect("a log");
    let records = log.load().await.expect("its records").records;
    let (mut begun, mut done) = (0, BTreeMap::<TaskKey, u32>::new());
    for record in records {
        match Fact::decode(&record).expect("a fact").1 {
            Fact::SharedJobBegun { .. } => begun += 1,
            Fact::Done { task, .. } if task.job.is_shared() => *done.entry(task).or_default() += 1,
            _ => {}
        }
    }
    assert_eq!((begun, done.len() as u32), (1, BLOCKS * ROUNDS + ROUNDS + 1));
    assert!(done.values().all(|&times| times == 1), "{done:?}");
}

#[test]
fn shared_result_is_solved_once_despite_kills_and_a_cancel() {
    let dir = TestFolder::new();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let (mut first, url) = start_coordinator(&dir, 0);
    let mut victim = worker(&dir, &url);
    let _others = [worker(&dir, &url), worker(&dir, &url)];
    let client = runtime.block_on(Client::connect(&url)).expect("a coordinator");
    let bundle = runtime.block_on(client.put(Bytes::from_static(b"no scene"))).expect("a store");
    let submit = |spec: JobSpec| runtime.block_on(client.submit(None, spec)).expect("a job");
    let jobs: Vec<JobId> = [("ann", &[1, 2, 3][..]), ("bob", &[3, 7]), ("eve", &[1])]
        .map(|(who, frames)| submit(job(who, bundle, frames)))
        .to_vec();
    let done = |url: &str| -> u64 {
        let ran = dir.run(&format!("status {} --json --server {url}", jobs[0])).exits(0);
        ran.json()["waits"].as_array().map_or(0, |waits| waits.len() as u64)
    };
    std::thread::sleep(Duration::from_millis(1_500));
    assert!(done(&url) > 0, "it waits for what is shared");
    assert!(victim.kill(), "the victim was alive");
    runtime.block_on(client.control(jobs[0], Control::Cancel)).expect("a job");
    std::thread::sleep(Duration::from_millis(500));
    assert!(first.kill(), "the coordinator was alive");
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let (mut second, url) = start_coordinator(&dir, port);
    let client = runtime.block_on(Client::connect(&url)).expect("a coordinator");
    for &id in &jobs[1..] {
        dir.run(&format!("watch {id} --server {url}")).exits(0);
        for record in runtime.block_on(client.frames(id)).expect("frames") {
            let artifact = record.output(Role::Answer).expect("an answer");
            let bytes = runtime.block_on(client.get(&artifact.digest, artifact.bytes)).expect("its bytes");
            assert_eq!(bytes, answer(record.frame), "frame {} of job {id}", record.frame);
        }
    }
    let cancelled = runtime.block_on(client.status(jobs[0])).expect("a job");
    assert_eq!(cancelled.state, JobState::Cancelled);
    second.kill();
    runtime.block_on(assert_done_once(&dir));
}

/// Returns a job with three blocks and an answer per frame. Each block takes time, unless it may read that of the previous frame.
fn independent_job(name: &str, bundle: Artifact, is_linked: bool) -> JobSpec {
    let drill =
        |tasks, makes: &[Role]| StageTemplate::new(StageKind::Drill, Scope::Frame, TaskSizes::even(tasks, 1), makes);
    let blocks = drill(3, &[Role::Numbers]);
    let blocks = if is_linked { blocks.with_hint(0, Role::Numbers, Reach::Same) } else { blocks };
    let graph = Graph { stages: vec![blocks, drill(1, &[Role::Answer]).with_input(0, Role::Numbers, Reach::All)] };
    let settings = format!(r#"{{"drill":{{"seed":{SEED},"numbers":{NUMBERS},"milliseconds":200}}}}"#);
    JobSpec { settings, graph, contents: vec![], ..job(name, bundle, &[2, 3, 5, 8, 13]) }
}

/// Reads the seconds of the tasks without inputs from the log, by job.
async fn seconds(dir: &TestFolder) -> BTreeMap<JobId, Vec<f64>> {
    let mut log = femc_queue::Sqlite::open(&dir.path("farm.db")).await.expect("a log");
    let mut all = BTreeMap::<JobId, Vec<f64>>::new();
    for record in log.load().await.expect("its records").records {
        if let Fact::Done { task, result, .. } = Fact::decode(&record).expect("a fact").1
            && task.stage.number == 0
        {
            all.entry(task.job).or_default().push(result.seconds);
        }
    }
    all
}

#[test]
fn previous_frame_input_saves_time_and_changes_no_byte() {
    let dir = TestFolder::new();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let (mut coordinator, url) = start_coordinator(&dir, 0);
    let _worker = worker(&dir, &url);
    let client = runtime.block_on(Client::connect(&url)).expect("a coordinator");
    let bundle = runtime.block_on(client.put(Bytes::from_static(b"no scene"))).expect("a store");
    let jobs = [false, true].map(|is_linked| {
        let spec = independent_job("ann", bundle, is_linked);
        runtime.block_on(client.submit(None, spec)).expect("a job")
    });
    let answers = jobs.map(|id| {
        dir.run(&format!("watch {id} --server {url}")).exits(0);
        let frames = runtime.block_on(client.frames(id)).expect("frames");
        frames.iter().map(|record| (record.frame, record.output(Role::Answer).expect("an answer").digest)).collect()
    });
    let [cold, warm]: [BTreeMap<u32, _>; 2] = answers;
    assert_eq!((cold.len(), &cold), (5, &warm));
    coordinator.kill();
    let seconds = runtime.block_on(seconds(&dir));
    let saved = |job: JobId| seconds[&job].iter().filter(|&&seconds| seconds < 0.2).count();
    assert_eq!(saved(jobs[0]), 0, "{seconds:?}");
    // Workers fetch tasks ahead. A task fetched before the previous frame was done saves nothing.
    assert!((6..=12).contains(&saved(jobs[1])), "{seconds:?}");
}
