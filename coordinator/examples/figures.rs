//! Benchmarks of the farm without rendering: a real coordinator with its log on disk, and workers in a separate process that report
//! every task as done at once.
//!
//! Run with `cargo run --release -p femc-coordinator --example figures`. To measure only the cost of web pages:
//! `... --example figures feed`. There, pages connect from many addresses of this machine (Linux).

use std::error::Error;
use std::io::{BufRead as _, BufReader, Read as _};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use bytes::Bytes;
use femc_coordinator::{ArtifactStorage, Config, Coordinator, Handle, LogStorage};
use femc_model::*;
use femc_proto::{Client, SessionReceiver, SessionSender};
use femc_schedule::{Fact, Ledger};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::sync::mpsc;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

const SCENE: &[u8] = b"a scene that nobody reads";
const RESULT: &[u8] = b"a tile that nobody looks at";

#[tokio::main]
async fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match args.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["worker", url, sessions, kind] => work(url, sessions.parse()?, kind == "holds").await,
        ["pages", address, count] => pages(address.parse()?, count.parse()?).await,
        ["feed"] => feed(1000, 7).await,
        ["throughput", sessions, frames] => throughput(sessions.parse()?, frames.parse()?).await,
        _ => measure().await,
    }
}

async fn measure() -> Result<()> {
    for sessions in [4, 16, 64] {
        throughput(sessions, 100).await?;
    }
    submission().await?;
    memory().await?;
    restart().await?;
    for signal in ["KILL", "STOP"] {
        let mut all = Vec::new();
        for _ in 0..3 {
            all.push(reassignment_time(signal).await?);
        }
        println!("task of a worker that got SIG{signal} runs again after {all:.1?} ms");
    }
    Ok(())
}

fn config(folder: &Path) -> Config {
    Config {
        log: LogStorage::Sqlite(folder.join("log.sqlite")),
        artifacts: ArtifactStorage::Folder(folder.join("artifacts")),
        ..Config::default()
    }
}

fn job(frames: u32, tiles: u32) -> JobSpec {
    JobSpec {
        name: "figures".into(),
        bundle: Digest::compute(SCENE),
        entry: "a.mgf".into(),
        settings: "{}".into(),
        frames: (1..=frames).collect(),
        grid: Grid { film: [tiles * 8, 8], tile: 8 },
        graph: testing::frame_graph(TaskSizes::even(tiles, 64), &[16], if tiles > 256 { 256 } else { 0 }),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    }
}

async fn start(config: Config) -> Result<(Handle, Client)> {
    let farm = Coordinator::start(config).await?;
    let client = Client::connect(&farm.url()).await?;
    client.put(Bytes::from_static(SCENE)).await?;
    client.put(Bytes::from_static(RESULT)).await?;
    Ok((farm, client))
}

fn workers(url: &str, sessions: u32, kind: &str) -> Result<Child> {
    let mut command = Command::new(std::env::current_exe()?);
    Ok(command.args(["worker", url, &sessions.to_string(), kind]).stdin(Stdio::null()).spawn()?)
}

async fn throughput(sessions: u32, frames: u32) -> Result<()> {
    let folder = tempfile::tempdir()?;
    let (farm, client) = start(config(folder.path())).await?;
    let mut others = workers(&farm.url(), sessions, "works")?;
    while client.workers().await?.len() < sessions as usize {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let (begun, before) = (Instant::now(), processor());
    let id = client.submit(None, job(frames, 1000)).await?;
    let mut watch = client.watch(id).await?;
    while watch.next().await?.is_some() {}
    let (elapsed, used) = (begun.elapsed().as_secs_f64(), processor() - before);
    let state = client.status(id).await?.state;
    let tasks = f64::from(frames) * 1005.0;
    println!(
        "{sessions} workers, {tasks} no-op tasks, {state:?}: {:.0} tasks/s, {:.1} us of the coordinator's processor a task",
        tasks / elapsed,
        used * 1e6 / tasks
    );
    others.kill()?;
    others.wait()?;
    farm.stop().await?;
    Ok(())
}

/// Measures what pages cost a busy coordinator: alternating turns without and with pages.
/// - `count`: number of listening pages, in a separate process.
async fn feed(count: usize, turns: usize) -> Result<()> {
    const SESSIONS: u32 = 16;
    let folder = tempfile::tempdir()?;
    let (farm, client) = start(config(folder.path())).await?;
    let mut others = workers(&farm.url(), SESSIONS, "works")?;
    while client.workers().await?.len() < SESSIONS as usize {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    // Warm-up: the first turn starts with an empty log.
    turn(&client).await?;
    let mut ratios = Vec::new();
    for _ in 0..turns {
        let (_, alone) = turn(&client).await?;
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["pages", &farm.address().to_string(), &count.to_string()]);
        let mut pages = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?;
        let mut lines = BufReader::new(pages.stdout.take().ok_or("no stdout")?);
        let mut line = String::new();
        // All pages have received their snapshot.
        lines.read_line(&mut line)?;
        let (elapsed, watched) = turn(&client).await?;
        pages.kill()?;
        line.clear();
        lines.read_to_string(&mut line)?;
        pages.wait()?;
        // The last line has the latest count.
        let events: u64 = line.lines().last().unwrap_or("0").parse()?;
        let ratio = watched / alone;
        println!(
            "processor time of a task: {alone:.2} us without pages, {watched:.2} us with {count} pages ({:+.1} %); each page received {:.2} events/s",
            100.0 * (ratio - 1.0),
            events as f64 / count as f64 / elapsed
        );
        ratios.push(ratio);
    }
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    println!("{count} pages, median of {turns} turns: {:+.1} % of processor a task", 100.0 * (median - 1.0));
    others.kill()?;
    others.wait()?;
    farm.stop().await?;
    Ok(())
}

/// Runs a job of 100,500 no-op tasks. Returns its seconds, and the microseconds of processor time of this process per task.
async fn turn(client: &Client) -> Result<(f64, f64)> {
    let (begun, before) = (Instant::now(), processor());
    let id = client.submit(None, job(100, 1000)).await?;
    while !client.status(id).await?.state.has_ended() {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    Ok((begun.elapsed().as_secs_f64(), (processor() - before) * 1e6 / 100_500.0))
}

/// Runs `count` listening pages. Prints a line when all have received an event, and from then on the number of received events once
/// a second.
async fn pages(address: SocketAddr, count: usize) -> Result<()> {
    let (ready, mut heard) = mpsc::channel(count);
    for number in 0..count {
        // A coordinator accepts at most 512 connections from one address.
        let source = SocketAddr::from(([127, 0, 1, (number / 250) as u8], 0));
        let ready = ready.clone();
        tokio::spawn(async move {
            let outcome = page(address, source, &ready).await;
            eprintln!("a page has ended: {outcome:?}");
        });
    }
    for _ in 0..count {
        heard.recv().await.ok_or("no page is left")?;
    }
    println!("ready");
    let (mut events, mut second) = (0u64, tokio::time::interval(Duration::from_secs(1)));
    loop {
        tokio::select! {
            event = heard.recv() => events += u64::from(event.is_some()),
            _ = second.tick() => println!("{events}"),
        }
    }
}

/// Runs one page: requests the feed and reports every event.
async fn page(address: SocketAddr, source: SocketAddr, events: &mpsc::Sender<()>) -> Result<()> {
    let socket = tokio::net::TcpSocket::new_v4()?;
    socket.bind(source)?;
    let mut stream = socket.connect(address).await?;
    stream.write_all(format!("GET /api/v1/feed HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).await?;
    let (mut bytes, mut last) = (vec![0; 64 << 10], 0);
    loop {
        let count = stream.read(&mut bytes).await?;
        if count == 0 {
            return Err("the feed has ended".into());
        }
        for &byte in &bytes[..count] {
            // Only the last line of an event is followed by an empty line. HTTP header lines end in CR LF.
            if byte == b'\n' && last == b'\n' {
                events.send(()).await?;
            }
            last = byte;
        }
    }
}

async fn submission() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let (farm, client) = start(config(folder.path())).await?;
    let mut all = Vec::new();
    for first in 0..5 {
        let spec = JobSpec { frames: (first + 1..=first + 1000).collect(), ..job(1000, 1000) };
        let begun = Instant::now();
        client.submit(None, spec).await?;
        all.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    println!("job of 1,000,000 tasks submitted, durable and answered after {all:.1?} ms");
    farm.stop().await?;
    Ok(())
}

async fn memory() -> Result<()> {
    const JOBS: u32 = 50;
    let folder = tempfile::tempdir()?;
    let (farm, client) = start(config(folder.path())).await?;
    client.submit(None, job(1000, 1000)).await?;
    let before = resident();
    for _ in 0..JOBS {
        client.submit(None, job(1000, 1000)).await?;
    }
    let bytes = resident().saturating_sub(before);
    println!("{JOBS} jobs of 1,000,000 queued tasks: {:.4} bytes a task", bytes as f64 / (f64::from(JOBS) * 1e6));
    farm.stop().await?;
    Ok(())
}

/// Measures a restart with half of a million tasks done: once with half of the frames finished, once with every frame half done.
async fn restart() -> Result<()> {
    for (name, frames, tiles) in
        [("500 of 1000 frames of 1000 tiles finished", 500, 1000), ("500 tiles of each of 1000 frames done", 1000, 500)]
    {
        let folder = tempfile::tempdir()?;
        let log = folder.path().join("log.sqlite");
        half_done(femc_queue::Sqlite::open(&log).await?, frames, tiles).await?;
        let begun = Instant::now();
        let farm = loop {
            match Coordinator::start(config(folder.path())).await {
                Ok(farm) => break farm,
                // The log is still being closed.
                Err(error) if error.to_string().contains("in use") => tokio::task::yield_now().await,
                Err(error) => return Err(error.into()),
            }
        };
        let status = Client::connect(&farm.url()).await?.status(JobId(1)).await?;
        let elapsed = begun.elapsed();
        let active: u64 = status.active.iter().map(|frame| u64::from(frame.tiles_done)).sum();
        let done = u64::from(status.frames_done) * 1000 + active;
        println!("restart, {name} ({done}): {:.0} ms until it answers", elapsed.as_secs_f64() * 1e3);
        farm.stop().await?;
    }
    Ok(())
}

/// Writes the log of a job with this progress, with snapshots as the coordinator makes them.
async fn half_done(mut queue: impl femc_queue::Queue, frames: u32, tiles: u32) -> Result<()> {
    queue.load().await?;
    let (mut ledger, mut since) = (Ledger::default(), 0);
    let mut facts = vec![
        Fact::CoordinatorStarted { incarnation: 1 },
        Fact::Submitted {
            job: JobId(1),
            key: None,
            spec: Box::new(job(1000, 1000)),
            chunk_size: ChunkSize::Whole,
            date: None,
            announces: true,
        },
    ];
    for frame in 1..=frames {
        let mut put = |kind, number, index, artifact| {
            let task = TaskKey { job: JobId(1), stage: Stage { frame, round: 0, number, kind }, index };
            let (epoch, result) = (Epoch::new(1, 1), Box::new(result(kind, artifact)));
            facts.push(Fact::Done { task, end: index + 1, epoch, leased: Tick(1), result });
        };
        for index in 0..tiles {
            let digest = Digest::compute(&[frame.to_le_bytes(), index.to_le_bytes()].concat());
            put(StageKind::Render, 0, index, Artifact { digest, bytes: 2000 });
        }
        if tiles == 1000 {
            (0..4).for_each(|group| put(StageKind::Reduce, 1, group, Artifact::from_bytes(RESULT)));
            put(StageKind::Image, 2, 0, Artifact::from_bytes(RESULT));
        }
        let mut records = Vec::new();
        for fact in facts.drain(..) {
            ledger.apply(&fact, Tick(2));
            records.push(fact.encode(Tick(2))?);
        }
        queue.append(femc_queue::Batch::from_records(&records)).await?;
        since += records.len();
        // The last records are not part of a snapshot.
        if since >= 20_000 && frame + 30 < frames {
            queue.snapshot(&ledger.encode()?).await?;
            since = 0;
        }
    }
    Ok(())
}

/// Makes the result of a task of this kind.
fn result(kind: StageKind, artifact: Artifact) -> TaskResult {
    let of = |role| TaskResult { outputs: vec![Output { role, artifact }], ..TaskResult::default() };
    match kind {
        StageKind::Render => TaskResult { units: 1024, ..of(Role::Tile) },
        StageKind::Reduce => of(Role::Pixels),
        StageKind::Image => TaskResult { decision: Some(Decision::Done), ..of(Role::Image) },
        _ => of(Role::Numbers),
    }
}

/// Measures the milliseconds from the signal to a worker until one of its tasks is given to another worker.
async fn reassignment_time(signal: &str) -> Result<f64> {
    let folder = tempfile::tempdir()?;
    // Disables copies of late tasks, so that the expiry of the lease is measured and not a copy.
    let scheduler = femc_schedule::Config { late: u64::MAX, ..femc_schedule::Config::default() };
    let (farm, client) = start(Config { scheduler, ..config(folder.path()) }).await?;
    let mut victim = workers(&farm.url(), 1, "holds")?;
    client.submit(None, job(1, 16)).await?;
    while client.workers().await?.iter().all(|worker| worker.tasks.is_empty()) {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let (out, mut incoming) = join(&client, 1 << 40).await?;
    let (mut number, mut struck) = (0, None);
    let mut beat = tokio::time::interval(Duration::from_millis(250));
    let taken = loop {
        tokio::select! {
            _ = beat.tick() => {
                number += 1;
                out.send(FromWorker::Heartbeat { number, tasks: vec![], usage: vec![] }).await;
                // By then all other tasks are done, and the coordinator has received heartbeats of the victim.
                if number == 8 {
                    let before = Instant::now();
                    let sent = Command::new("kill").args(["-s", signal, &victim.id().to_string()]).status()?;
                    struck = sent.success().then_some(before);
                }
            }
            message = incoming.next() => if let ToWorker::Assign(lease) = message?.ok_or("the session ended")? {
                if let Some(struck) = struck {
                    break struck.elapsed();
                }
                out.send(done(&lease)).await;
            }
        }
    };
    victim.kill()?;
    victim.wait()?;
    farm.stop().await?;
    Ok(taken.as_secs_f64() * 1e3)
}

async fn join(client: &Client, instance: u64) -> Result<(SessionSender, SessionReceiver)> {
    let registration = Registration {
        name: "no-op".into(),
        instance,
        engine: "figures".into(),
        threads: 1,
        slots: 1,
        tags: vec![],
        held: vec![],
        death: None,
    };
    Ok(client.session(registration).await?)
}

fn done(lease: &Assignment) -> FromWorker {
    let result = result(lease.task.stage.kind, Artifact::from_bytes(RESULT));
    let usage = ResourceUsage {
        wait: 0.012_345,
        wall: 0.123_456,
        preparation: 0.001_234,
        cpu: 0.111_111,
        peak: Some(123_456_789),
        samples: 1024,
        rays: 12_345,
        fetched: 12_345,
        sent: RESULT.len() as u64,
    };
    FromWorker::Completed { task: lease.task, epoch: lease.epoch, result, log: None, usage: Some(usage) }
}

/// Runs sessions that report their tasks as done at once, or hold them.
async fn work(url: &str, sessions: u64, holds: bool) -> Result<()> {
    let mut all = tokio::task::JoinSet::new();
    for instance in 1..=sessions {
        let url = url.to_owned();
        all.spawn(async move {
            let client = Client::connect(&url).await.map_err(|error| error.to_string())?;
            session(&client, instance, holds).await.map_err(|error| error.to_string())
        });
    }
    while let Some(ended) = all.join_next().await {
        ended??;
    }
    Ok(())
}

async fn session(client: &Client, instance: u64, holds: bool) -> Result<()> {
    let (out, mut incoming) = join(client, instance).await?;
    let (mut held, mut number): (Vec<TaskProgress>, u64) = (Vec::new(), 0);
    let mut beat = tokio::time::interval(Duration::from_millis(500));
    loop {
        tokio::select! {
            _ = beat.tick() => {
                number += 1;
                held.iter_mut().for_each(|task| task.units += 1);
                out.send(FromWorker::Heartbeat { number, tasks: held.clone(), usage: vec![] }).await;
            }
            message = incoming.next() => match message? {
                Some(ToWorker::Assign(Assignment { task, epoch, .. })) if holds => {
                    held.push(TaskProgress { task, epoch, phase: Phase::Working, units: 0 });
                }
                Some(ToWorker::Assign(lease)) => out.send(done(&lease)).await,
                Some(_) => {}
                None => return Ok(()),
            }
        }
    }
}

/// Returns the processor seconds of this process so far.
fn processor() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields).split_whitespace();
    fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Returns the resident memory of this process in bytes.
fn resident() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    pages.split_whitespace().nth(1).and_then(|pages| pages.parse::<u64>().ok()).unwrap_or(0) * 4096
}
