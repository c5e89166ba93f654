//! Tests of jobs that clients of earlier versions submit.

use std::collections::BTreeMap;
use std::future::pending;
use std::sync::Arc;

use femc_coordinator::{Config, Coordinator};
use femc_film::{Tiling, exr, pixel_digest};
use femc_graph::tag;
use femc_import::Bundle;
use femc_model::*;
use femc_pipeline::{
    Layer, Method, SceneSource, Settings, StopCondition, job_graph, split_first_pass, tiles_per_group, with_layers,
    with_statistics,
};
use femc_proto::{Client, testing};
use femc_worker::{ExtraOutputs, Video, Worker};

use crate::common::SCENE;

/// Submission of the job of [`job`], by a client with kinds and roles of an earlier version: its first pass has two blocks, and it
/// has layers, light statistics, stills, a sheet and a clip.
const SUBMISSION: &[u8] = include_bytes!("../files/submission-1.bin");

/// Number of blocks of its first pass.
const BLOCKS: u32 = 2;

/// Returns the job and its bundle.
fn job() -> (JobSpec, Vec<u8>) {
    let grid = Grid { film: [32, 16], tile: 16 };
    let layer = Layer { name: "direct".into(), expression: "C<RD>[<L.>O]".into() };
    let settings = Settings {
        stop: StopCondition::Spp(4),
        max_depth: 4,
        method: Method::Femc,
        statistics: true,
        layers: vec![layer],
        ..Settings::default()
    };
    let scene = SCENE.replace("mbox haze -1 -1 -1 1 1 1\n", "");
    let bundle = Bundle(BTreeMap::from([("room.mgf".into(), scene.as_bytes().to_vec())]));
    let source = SceneSource::new(Arc::new(femc_import::load_scene(&bundle, "room.mgf").unwrap().scene));
    let frame_key = femc_pipeline::frame_key(&source, &settings, 1).unwrap();
    let content = Digest::from_bytes(femc_pipeline::first_pass_key(&frame_key, settings.method, BLOCKS));
    let tiling = Tiling::new(grid.film[0], grid.film[1], grid.tile).unwrap();
    let graph = job_graph(&tiling, &settings.rounds(), tiles_per_group(&tiling), settings.method);
    let graph = split_first_pass(graph, settings.method, BLOCKS);
    let mut graph = with_layers(with_statistics(graph), &tiling, 1);
    let video = Some(Video { name: "clip.png".into(), rate: 2.0 });
    ExtraOutputs { stills: true, sheet: Some("sheet.png".into()), video, painting: None }.add_to(&mut graph, 1);
    let bundle = bundle.encode().unwrap();
    let spec = JobSpec {
        name: "room".into(),
        bundle: Digest::compute(&bundle),
        entry: "room.mgf".into(),
        settings: serde_json::to_string(&settings).unwrap(),
        frames: vec![1],
        grid,
        graph,
        contents: vec![(1, content)],
        priority: 50,
        owner: "me".into(),
        tags: vec![],
        notes: JobNotes::default(),
    };
    (spec, bundle)
}

/// Runs the job on a farm of its own. Returns the pixels of its image, and the digests of its other results without provenance.
async fn run(spec: JobSpec, bundle: Vec<u8>) -> (String, BTreeMap<Role, Digest>) {
    let farm = Coordinator::start(Config::default()).await.unwrap();
    let client = Client::connect(&farm.url()).await.unwrap();
    client.put(bundle.into()).await.unwrap();
    let id = client.submit(None, spec).await.unwrap();
    let config = femc_worker::Config { threads: 2, ..femc_worker::Config::new(farm.url()) };
    let worker = tokio::spawn(async { Worker::run(config, pending()).await.unwrap() });
    let mut watch = client.watch(id).await.unwrap();
    let mut last = None;
    while let Some(status) = watch.next().await.unwrap() {
        last = Some(status);
    }
    assert_eq!(last.as_ref().map(|status| status.state), Some(JobState::Done), "{last:?}");
    let outputs: Vec<Output> = client.frames(id).await.unwrap().into_iter().flat_map(|record| record.outputs).collect();
    let find = |role| outputs.iter().find(|output| output.role == role).expect("a result").artifact;
    let Artifact { digest, bytes } = find(Role::Image);
    let image = exr::decode(std::io::Cursor::new(client.get(&digest, bytes).await.unwrap())).unwrap().image;
    let others = [Role::Preview, Role::Statistics, Role::Still, Role::Sheet, Role::Clip];
    let others = others.into_iter().map(|role| (role, find(role).digest)).collect();
    assert!(outputs.iter().any(|output| output.role == Role::LayerImage));
    worker.abort();
    farm.stop().await.unwrap();
    (pixel_digest(&image).to_string(), others)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_of_an_earlier_client_runs_and_has_the_same_bytes() {
    let (present, bundle) = job();
    let earlier = testing::decode_submission(SUBMISSION).expect("a job");
    // The client had another engine, which gives contents other keys.
    let earlier = JobSpec { contents: present.contents.clone(), ..earlier };
    let kinds = |spec: &JobSpec| -> Vec<(StageKind, Vec<Role>)> {
        spec.graph.stages.iter().map(|stage| (stage.kind, stage.outputs.clone())).collect()
    };
    // The client also computed guides after each of three rounds of rays, for which it applied the last rays earlier.
    let mut without_guides = kinds(&earlier);
    without_guides.retain(|(kind, _)| *kind != StageKind::FirstPassGuides);
    let last =
        without_guides.iter().rposition(|(kind, _)| *kind == StageKind::FirstPassSolve).expect("a last solution");
    without_guides.remove(last);
    // Its tiles did not read targets. The worker learns them when it prepares the frame.
    let mut without_learning = kinds(&present);
    without_learning.retain(|(kind, _)| *kind != StageKind::Learn);
    assert_eq!(without_guides, without_learning);
    let has_tag = |stage: &StageTemplate| stage.tags.iter().any(|own| own == tag::TASK_KINDS);
    assert!(earlier.graph.stages.iter().all(has_tag));
    assert_eq!(earlier.bundle, present.bundle);
    assert_eq!(run(earlier, bundle.clone()).await, run(present, bundle).await);
}
