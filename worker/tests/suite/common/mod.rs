//! A small job, and in-memory networks that a test can interrupt. Time is tokio's: while paused, it advances when all tasks wait.
#![allow(dead_code)] // every test file uses its own part of this

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use femc_film::Tiling;
use femc_import::Bundle;
use femc_model::*;
use femc_pipeline::{Settings, StopCondition};
use femc_proto::{ByteStream, Dialer};
use femc_worker::{Config, Executor, TaskSimulation};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, DuplexStream, ReadHalf, WriteHalf};
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::UnboundedReceiverStream;

/// A lamp over a floor in fog; two tiles.
pub const SCENE: &str = "
camera main =
    origin 0 -3 1
    target 0 0 0.5
    fov 40
    film 32 16
medium haze =
    sigma_s 0.05
mbox haze -1 -1 -1 1 1 1
m gray =
    c
    rd 0.6
m bright =
    c
    ed 2000
v a =
    p -2 -2 0
v b =
    p 2 -2 0
v c =
    p 2 2 0
v d =
    p -2 2 0
m gray
f a b c d
v e =
    p 0 0 1.2
m bright
sph e 0.2
";

/// Returns the stages of frames with this grid.
pub fn graph(grid: Grid, settings: &Settings) -> Graph {
    let tiling = Tiling::new(grid.film[0], grid.film[1], grid.tile).unwrap();
    femc_pipeline::job_graph(&tiling, &settings.rounds(), femc_pipeline::tiles_per_group(&tiling), settings.method)
}

/// Returns a job of one frame of two tiles, and its bundle.
pub fn job(spp: u32) -> (JobSpec, Vec<u8>) {
    job_of(spp, 16)
}

/// Returns the job of [`job`] with tiles of edge length `tile`.
pub fn job_of(spp: u32, tile: u32) -> (JobSpec, Vec<u8>) {
    let grid = Grid { film: [32, 16], tile };
    let settings = Settings { stop: StopCondition::Spp(spp), max_depth: 4, ..Settings::default() };
    let bundle = Bundle(BTreeMap::from([("haze.mgf".into(), SCENE.as_bytes().to_vec())])).encode().unwrap();
    let spec = JobSpec {
        name: "haze".into(),
        bundle: Digest::compute(&bundle),
        entry: "haze.mgf".into(),
        settings: serde_json::to_string(&settings).unwrap(),
        frames: vec![1],
        grid,
        graph: graph(grid, &settings),
        contents: vec![],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    };
    (spec, bundle)
}

/// Stream of a server's incoming connections.
pub type Connections = UnboundedReceiverStream<io::Result<ByteStream>>;

/// An in-memory network to a server.
#[derive(Debug, Clone)]
pub struct Net(mpsc::UnboundedSender<io::Result<ByteStream>>);

/// State of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkState {
    Open,
    /// Bytes are held back without an error on either side.
    Frozen,
}

impl Net {
    pub fn new() -> (Self, Connections) {
        let (send, receive) = mpsc::unbounded_channel();
        (Self(send), UnboundedReceiverStream::new(receive))
    }

    /// Returns a dialer whose connections pass bytes while `state` is open.
    pub fn dial(&self, state: watch::Receiver<LinkState>) -> Dialer {
        let net = self.clone();
        Dialer::from_fn(move |_, _| {
            let (net, way) = (net.clone(), state.clone());
            Box::pin(async move {
                let ((client, near), (far, server)) = (tokio::io::duplex(1 << 20), tokio::io::duplex(1 << 20));
                let ((from_near, to_near), (from_far, to_far)) = (tokio::io::split(near), tokio::io::split(far));
                tokio::spawn(relay(from_near, to_far, way.clone()));
                tokio::spawn(relay(from_far, to_near, way));
                net.0
                    .send(Ok(ByteStream::new(server)))
                    .map_err(|_| io::Error::from(io::ErrorKind::ConnectionRefused))?;
                Ok(ByteStream::new(client))
            })
        })
    }

    /// Returns a dialer whose connections are always open.
    pub fn open(&self) -> Dialer {
        self.dial(watch::channel(LinkState::Open).1)
    }
}

async fn relay(
    mut from: ReadHalf<DuplexStream>,
    mut to: WriteHalf<DuplexStream>,
    mut state: watch::Receiver<LinkState>,
) {
    let mut bytes = vec![0; 1 << 16];
    while let Ok(count @ 1..) = from.read(&mut bytes).await {
        // Without a sender, the state stays as it is.
        if state.wait_for(|way| *way == LinkState::Open).await.is_err() && *state.borrow() == LinkState::Frozen {
            std::future::pending::<()>().await;
        }
        if to.write_all(&bytes[..count]).await.is_err() {
            break;
        }
    }
    let _ = to.shutdown().await;
}

/// Returns a worker whose render tasks take `render` of simulated time.
pub fn simulated(name: &str, dial: Dialer, render: Duration) -> Config {
    let simulation = TaskSimulation::from_durations(move |assignment| {
        if assignment.task.stage.kind.is_divided() { render } else { Duration::from_millis(80) }
    });
    let instance = u64::from_le_bytes(Digest::compute(name.as_bytes()).as_bytes()[..8].try_into().unwrap());
    Config {
        name: name.into(),
        threads: 1,
        instance,
        dial,
        executor: Executor::Simulated(simulation),
        ..Config::new("http://farm:7878")
    }
}

/// Returns the clock that follows the paused time.
pub fn time() -> femc_coordinator::TimeSource {
    let started = Arc::new(tokio::time::Instant::now());
    femc_coordinator::TimeSource::from_fn(move || started.elapsed())
}
