//! Measures the overhead of the farm: renders a frame by direct calls on one pool, then through an embedded coordinator and worker.
//!
//! `cargo run --release -p femc-worker --example overhead -- SCENE [SPP] [SIDE]`

use std::future::pending;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use femc_coordinator::{ArtifactStorage, Config, Coordinator, LogStorage};
use femc_film::{Frame, Tiling};
use femc_import::{Bundle, DiskFolder, FileSource as _};
use femc_model::{Grid, JobNotes, JobSpec};
use femc_pipeline::{Settings, StopCondition};
use femc_proto::Client;
use femc_worker::{Parcel, Worker};

/// Returns the processor seconds of this process so far, where the system reports them. A busy machine does not change them.
fn processor() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields).split_whitespace();
    fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let path = args.next().ok_or("a scene file")?;
    let spp = args.next().map_or(Ok(64), |text| text.parse())?;
    let side: u32 = args.next().map_or(Ok(256), |text| text.parse())?;
    let settings = Settings { stop: StopCondition::Spp(spp), size: Some([side, side]), ..Settings::default() };
    let scene = Arc::new(femc_import::load_scene_file(Path::new(&path))?.scene);
    let plan = femc_pipeline::plan_job(&scene, &settings, Some(&[1]))?;

    let (begun, before) = (Instant::now(), processor());
    let prepared = femc_pipeline::prepare_frame(&femc_pipeline::SceneSource::new(scene.clone()), &settings, 1, None)?;
    let mut frame = Frame::new(Tiling::new(side, side, plan.tiling.edge)?);
    for rect in plan.tiling.rects() {
        frame.insert(
            femc_pipeline::RenderTask::new(&prepared, &settings, rect, 0..spp)
                .render(femc_pipeline::Outputs::default())?
                .tile,
        )?;
    }
    let samples = frame.resolve().samples.len();
    let (direct, direct_processor) = (begun.elapsed(), processor() - before);

    let folder = tempfile::tempdir()?;
    let config = Config {
        log: LogStorage::Sqlite(folder.path().join("log.sqlite")),
        artifacts: ArtifactStorage::Folder(folder.path().join("artifacts")),
        ..Config::default()
    };
    let file = Path::new(&path);
    let disk = DiskFolder::new(file.parent().unwrap_or(Path::new(".")));
    let entry = file.file_name().ok_or("a scene file")?.to_string_lossy().into_owned();
    let names = femc_import::load_scene(&disk, &entry)?.files;
    let files = names.into_iter().map(|name| Ok((name.clone(), disk.read(&name)?))).collect::<std::io::Result<_>>()?;
    let scene = Parcel::pack(&Bundle(files))?;
    let (begun, before) = (Instant::now(), processor());
    let farm = Coordinator::start(config).await?;
    let worker = tokio::spawn(Worker::run(femc_worker::Config::new(farm.url()), pending()));
    let client = Client::connect(&farm.url()).await?;
    let spec = JobSpec {
        name: "overhead".into(),
        bundle: scene.digest(),
        entry,
        settings: serde_json::to_string(&settings)?,
        frames: vec![1],
        grid: Grid { film: [side, side], tile: plan.tiling.edge },
        graph: plan.graph,
        contents: vec![],
        priority: 50,
        owner: "bench".into(),
        tags: vec![],
        notes: JobNotes::default(),
    };
    client.put_all(&scene.artifacts()).await?;
    let job = client.submit(None, spec).await?;
    let mut watch = client.watch(job).await?;
    let mut last = None;
    while let Some(status) = watch.next().await? {
        last = Some(status);
    }
    let (through, through_processor) = (begun.elapsed(), processor() - before);
    let status = last.ok_or("a status")?;
    println!("{samples} pixels, {} tiles of {} pixels, {spp} spp", plan.tiling.count(), plan.tiling.edge);
    println!("direct  {:8.1} ms, processor {direct_processor:.2} s", direct.as_secs_f64() * 1e3);
    println!("farm    {:8.1} ms, processor {through_processor:.2} s, {:?}", through.as_secs_f64() * 1e3, status.state);
    let extra = (through_processor - direct_processor) * 1e3;
    println!("extra   {extra:8.1} ms of processor, {:.2} ms a tile", extra / plan.tiling.count() as f64);
    worker.abort();
    farm.stop().await?;
    Ok(())
}
