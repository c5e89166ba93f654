//! Benchmark of the scheduler alone: `cargo run --release -p femc-schedule --example scale -- [WORKERS] [FRAMES] [TILES]`
//!
//! Workers complete every task immediately; there is no log and no network. Memory is that of the process: its growth with the job,
//! with the workers and their leases, and until the job's end, and its maximum.

use std::time::Instant;

use femc_model::*;
use femc_schedule::*;

fn main() {
    let mut args = std::env::args().skip(1).filter_map(|text| text.parse::<u32>().ok());
    let workers = args.next().unwrap_or(100);
    let (frames, tiles) = (args.next().unwrap_or(1000), args.next().unwrap_or(1000));
    let (mut farm, _) = Scheduler::new(Config::default(), Ledger::default());
    let spec = JobSpec {
        name: "scale".into(),
        bundle: Digest::compute(b"bundle"),
        entry: "a.mgf".into(),
        settings: "{}".into(),
        frames: (1..=frames).collect(),
        grid: Grid { film: [tiles * 8, 8], tile: 8 },
        graph: testing::frame_graph(TaskSizes::even(tiles, 64), &[16], 256),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    };
    let empty = memory_kib("VmRSS");
    let started = Instant::now();
    farm.handle(Event::Submitted { request: RequestId(1), key: None, spec: Box::new(spec), date: None }, Tick(0));
    println!("submit of {} tasks: {:?}", u64::from(frames) * u64::from(tiles), started.elapsed());

    let submitted = memory_kib("VmRSS");
    let mut queue = std::collections::VecDeque::new();
    let collect = |commands: Vec<Command>, queue: &mut std::collections::VecDeque<_>| {
        for command in commands {
            if let Command::Assign { worker, assignment } = command {
                queue.push_back((worker, assignment));
            }
        }
    };
    for worker in 1..=u64::from(workers) {
        let registration = Registration {
            name: "w".into(),
            instance: worker,
            engine: "e".into(),
            threads: 1,
            slots: 1,
            tags: vec![],
            held: vec![],
            death: None,
        };
        collect(farm.handle(Event::Joined { worker: WorkerId(worker), registration }, Tick(0)), &mut queue);
    }
    let joined = memory_kib("VmRSS");
    let (started, mut done) = (Instant::now(), 0u64);
    while let Some((worker, Assignment { task, epoch, spec: work, .. })) = queue.pop_front() {
        let name = Artifact { digest: Digest::from_bytes([task.index as u8; 32]), bytes: 1 };
        let output = |role| Output { role, artifact: name };
        let result = match task.stage.kind {
            StageKind::Render => {
                let units = work.steps.len() as u64 * 64;
                TaskResult { outputs: vec![output(Role::Tile)], units, ..TaskResult::default() }
            }
            StageKind::Image => {
                let decision = Some(Decision::Done);
                TaskResult { outputs: vec![output(Role::Image)], decision, ..TaskResult::default() }
            }
            _ => TaskResult { outputs: vec![output(Role::Pixels)], ..TaskResult::default() },
        };
        collect(farm.handle(Event::Completed { worker, task, epoch, result }, Tick(1)), &mut queue);
        done += 1;
    }
    let elapsed = started.elapsed();
    println!(
        "{workers} workers, {done} tasks: {elapsed:?}, {:.2} us a task",
        elapsed.as_secs_f64() * 1e6 / done as f64
    );
    let grown = [submitted - empty, joined - submitted, memory_kib("VmRSS") - joined];
    println!("memory: {empty} KiB, and {grown:?} with job, workers and end; {} KiB at most", memory_kib("VmHWM"));
    let started = Instant::now();
    let bytes = farm.ledger().encode().map_or(0, |bytes| bytes.len());
    println!("snapshot: {bytes} bytes in {:?}", started.elapsed());
}

/// Returns a memory figure of this process in KiB, by its name in Linux.
fn memory_kib(name: &str) -> i64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with(name)).unwrap_or_default();
    line.split_whitespace().nth(1).and_then(|number| number.parse().ok()).unwrap_or(0)
}
