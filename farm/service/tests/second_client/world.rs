//! A farm with two jobs and two statistics files, whose pictures and light repeat the question.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use femc_model::{
    AttemptOutcome, AttemptRecord, ChunkSize, Digest, Epoch, FrameParts, FrameRecord, FrameStatus, Graph, Grid, JobId,
    JobNotes, JobSpec, JobState, JobStatus, LeaseEnding, LogRecord, LogText, Output, Refusal, ResourceUsage, Role,
    Scope, Stage, StageKind, StageTemplate, TaskFilter, TaskKey, TaskLog, TaskPage, TaskSizes, TaskState, TaskStatus,
    Tick, WorkerList,
};
use femc_service::{
    AttemptPage, Call, Farm, Gate, Http, JobList, JobShape, LightAnswer, LightCall, LightCallKind, LightData,
    LightError, LightFault, LightFile, LightSource, PictureKind, PictureSource, Site,
};
use femc_store::Store;
use femc_store::object_store::ObjectStoreExt as _;
use tokio::sync::mpsc;

use crate::common::{job_status, open_gate, serve};

/// A job of the farm.
#[derive(Debug, Clone)]
pub struct TestJob {
    pub spec: JobSpec,
    pub records: Vec<FrameRecord>,
    pub parts: Vec<FrameParts>,
    pub tasks: Vec<TaskStatus>,
    pub attempts: Vec<AttemptRecord>,
    pub logs: Vec<LogRecord>,
}

/// State of the farm.
#[derive(Debug, Clone)]
pub struct World {
    pub jobs: Vec<(JobId, TestJob)>,
    pub files: Vec<PathBuf>,
    /// Artifacts that the store lacks.
    pub absent: Vec<Bytes>,
}

/// Makes an output from the text of its artifact.
pub fn output(role: Role, text: &str) -> Output {
    Output { role, artifact: femc_model::Artifact::from_bytes(text.as_bytes()) }
}

pub fn record(frame: u32, outputs: &[(Role, &str)]) -> FrameRecord {
    FrameRecord {
        frame,
        outputs: outputs.iter().map(|&(role, text)| output(role, text)).collect(),
        spp: 4,
        relative_error: None,
        blocks: None,
        bad_samples: 0,
        busy_seconds: 1.0,
        seconds: 1.0,
        rounds: None,
        times: None,
    }
}

fn key(job: u64, frame: u32, number: u16, index: u32) -> TaskKey {
    let kind = [StageKind::Render, StageKind::Image, StageKind::EncodeClip][usize::from(number)];
    TaskKey { job: JobId(job), stage: Stage { frame, round: 0, number, kind }, index }
}

pub fn task(job: u64, (frame, number, index): (u32, u16, u32), state: TaskState, attempts: u32) -> TaskStatus {
    TaskStatus {
        task: key(job, frame, number, index),
        state,
        covers_all_rounds: false,
        workers: Vec::new(),
        attempts,
        seconds: None,
        failure: None,
        times: None,
    }
}

/// Makes an attempt that took these processor seconds.
pub fn attempt(job: u64, (frame, number, index): (u32, u16, u32), epoch: u64, cpu: f64) -> AttemptRecord {
    let usage = ResourceUsage { cpu, wall: 1.0, ..ResourceUsage::default() };
    AttemptRecord {
        task: key(job, frame, number, index),
        epoch: Epoch(epoch),
        worker: format!("w{epoch}"),
        instance: 1,
        granted: Tick(1000 * epoch),
        ended: Tick(1000 * epoch + 1000),
        ending: LeaseEnding::Done,
        samples: 1,
        relative_error: None,
        usage: Some(usage),
    }
}

pub fn log(job: u64, (frame, number, index): (u32, u16, u32), seconds: u64, text: &str) -> LogRecord {
    LogRecord {
        task: key(job, frame, number, index),
        epoch: Epoch(seconds),
        worker: "w1".into(),
        reported_at: Tick(1000 * seconds),
        log: TaskLog { outcome: AttemptOutcome::Done, seconds: 1.0, text: LogText::Inline(text.into()) },
    }
}

fn spec(name: &str, owner: &str) -> JobSpec {
    let options = r#"{"sheet":"sheet.png","video":{"name":"clip.webm","rate":24.0}}"#;
    let tiles = StageTemplate::new(StageKind::Render, Scope::Frame, TaskSizes::even(4, 64), &[Role::Tile]);
    let image = StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image]);
    let clip = StageTemplate::new(StageKind::EncodeClip, Scope::Job, TaskSizes::even(1, 1), &[Role::Clip]);
    JobSpec {
        name: name.into(),
        bundle: Digest::compute(name.as_bytes()),
        entry: format!("{name}.mgf"),
        settings: "{}".into(),
        frames: vec![3, 4, 5],
        grid: Grid { film: [16, 16], tile: 8 },
        graph: Graph { stages: vec![tiles, image, clip.with_options(options)] },
        contents: Vec::new(),
        priority: 50,
        owner: owner.into(),
        tags: Vec::new(),
        notes: JobNotes::default(),
    }
}

impl World {
    /// Makes the farm. Frame 3 of both jobs is finished; so are frames 5 of job 8, and frame 4 of both jobs is in progress.
    pub fn new(files: Vec<PathBuf>) -> Self {
        let grid = Grid { film: [16, 16], tile: 8 };
        let parts = |outputs: &[(Role, &str)]| {
            let outputs = outputs.iter().map(|&(role, text)| output(role, text)).collect();
            vec![FrameParts { frame: 4, grid, outputs }]
        };
        let mut day_spec = spec("day", "ann");
        let geometry = StageTemplate::new(StageKind::Geometry, Scope::Frame, TaskSizes::even(1, 1), &[Role::Geometry]);
        let solution = StageTemplate::new(StageKind::Solution, Scope::Frame, TaskSizes::even(1, 1), &[Role::Solution]);
        let learn = StageTemplate::new(StageKind::Learn, Scope::Frame, TaskSizes::even(1, 1), &[Role::Targets]);
        day_spec.graph.stages.extend([geometry, solution, learn]);
        let day = TestJob {
            spec: day_spec,
            records: vec![
                record(0, &[(Role::Still, "still"), (Role::Clip, "\x1aclip 7"), (Role::Sheet, "sheet 7")]),
                record(
                    3,
                    &[
                        (Role::Image, "image 7.3"),
                        (Role::Preview, "preview 7.3"),
                        (Role::LayerImage, "layers 7.3"),
                        (Role::Statistics, "light 7.3"),
                        (Role::Geometry, "geometry 7.3"),
                        (Role::Solution, "solution 7.3"),
                        (Role::Readings, "readings 7.3"),
                        (Role::Targets, "targets 7.3"),
                    ],
                ),
            ],
            parts: parts(&[
                (Role::Tile, "tile a"),
                (Role::Tile, "tile b"),
                (Role::Paths, "paths a"),
                (Role::Geometry, "geometry 7.4"),
            ]),
            tasks: vec![
                task(7, (3, 0, 0), TaskState::Done, 1),
                task(7, (3, 0, 1), TaskState::Done, 1),
                task(7, (3, 1, 0), TaskState::Done, 1),
                task(7, (4, 0, 0), TaskState::Running, 2),
                task(7, (4, 0, 1), TaskState::Failed, 3),
                task(7, (4, 1, 0), TaskState::Waiting, 0),
            ],
            attempts: vec![
                attempt(7, (3, 0, 0), 1, 4.0),
                attempt(7, (3, 0, 1), 2, 8.0),
                attempt(7, (3, 1, 0), 3, 2.0),
                attempt(7, (4, 0, 0), 4, 1.0),
                attempt(7, (4, 0, 1), 5, 16.0),
            ],
            logs: vec![
                log(7, (3, 0, 0), 2, "log one"),
                log(7, (3, 0, 1), 3, "log two"),
                log(7, (3, 0, 0), 4, "log three"),
            ],
        };
        let night = TestJob {
            spec: spec("night", "bob"),
            records: vec![
                // The jobs share the light of frame 3, and frame 5 is equal to it.
                record(3, &[(Role::Image, "image 8.3"), (Role::Statistics, "light 7.3")]),
                record(5, &[(Role::Image, "image 8.5"), (Role::Statistics, "light 7.3")]),
            ],
            parts: parts(&[(Role::Tile, "tile c"), (Role::Paths, "paths c")]),
            tasks: vec![task(8, (3, 0, 0), TaskState::Done, 1), task(8, (4, 0, 2), TaskState::Queued, 1)],
            attempts: vec![attempt(8, (3, 0, 0), 1, 3.0)],
            logs: vec![log(8, (3, 0, 0), 2, "log of the night")],
        };
        Self { jobs: vec![(JobId(7), day), (JobId(8), night)], files, absent: Vec::new() }
    }

    pub fn job(&mut self, job: u64) -> &mut TestJob {
        &mut self.jobs.iter_mut().find(|(id, _)| *id == JobId(job)).expect("a job").1
    }

    fn find(&self, job: JobId) -> Result<&TestJob, Refusal> {
        self.jobs.iter().find(|(id, _)| *id == job).map(|(_, job)| job).ok_or(Refusal::NoSuchJob { job })
    }

    fn answer(&self, call: Call<()>) {
        /// Number of attempts on a page.
        const PAGE: usize = 2;
        match call {
            Call::List { reply } => {
                let jobs = self.jobs.iter().map(|(job, _)| job_status(*job, 50, JobState::Running)).collect();
                drop(reply.send(Ok(JobList { jobs, warnings: Vec::new() })));
            }
            Call::Status { job, reply } => {
                let status = |known: &TestJob| JobStatus {
                    owner: known.spec.owner.clone(),
                    ..job_status(job, 50, JobState::Running)
                };
                drop(reply.send(self.find(job).map(status)));
            }
            Call::Shape { job, reply } => {
                let shape = |job: &TestJob| JobShape { spec: Box::new(job.spec.clone()), chunk_size: ChunkSize::Whole };
                drop(reply.send(self.find(job).map(shape)));
            }
            Call::Frames { job, reply } => drop(reply.send(self.find(job).map(|job| job.records.clone()))),
            Call::Parts { job, reply } => drop(reply.send(self.find(job).map(|job| job.parts.clone()))),
            Call::FrameTable { job, reply } => drop(reply.send(self.find(job).map(TestJob::frame_table))),
            Call::Tasks { job, filter, from, count, reply } => {
                drop(reply.send(self.find(job).map(|job| job.task_page(filter, from, count))));
            }
            Call::Attempts { job, from, reply } => {
                let page = |job: &TestJob| {
                    let first = usize::try_from(from).expect("a record").min(job.attempts.len());
                    let end = (first + PAGE).min(job.attempts.len());
                    let next = (end < job.attempts.len()).then_some(end as u64);
                    AttemptPage { attempts: job.attempts[first..end].to_vec(), next }
                };
                drop(reply.send(self.find(job).map(page)));
            }
            Call::Logs { job, since, reply } => {
                let logs = |job: &TestJob| job.logs.iter().filter(|log| log.reported_at >= since).cloned().collect();
                drop(reply.send(self.find(job).map(logs)));
            }
            Call::Workers { reply } => {
                drop(reply.send(Ok(WorkerList { connected: Vec::new(), offline: Vec::new() })));
            }
            Call::Control { job, reply, .. } => drop(reply.send(self.find(job).map(|_| ()))),
            Call::Usage { reply } => drop(reply.send(Ok(Vec::new()))),
            Call::ArtifactLost { reply, .. } => drop(reply.send(Ok(()))),
            Call::Producer { reply, .. } => drop(reply.send(Ok(None))),
            other => panic!("unexpected call {other:?}"),
        }
    }

    /// Puts the artifacts of the jobs into a store.
    pub async fn fill(&self, store: &Store) {
        let texts = [
            "still",
            "\x1aclip 7",
            "\x1aclip 7 again",
            "sheet 7",
            "sheet 7 again",
            "image 7.3",
            "preview 7.3",
            "layers 7.3",
            "geometry 7.3",
            "solution 7.3",
            "geometry 7.4",
            "readings 7.3",
            "targets 7.3",
            "light 7.3",
            "tile a",
            "tile b",
            "tile d",
            "paths a",
            "paths b",
            "image 8.3",
            "image 8.5",
            "tile c",
            "paths c",
            "image 7.4",
            "light 7.4",
            "image 7.3 again",
            "preview 7.3 again",
            "light 7.3 again",
        ];
        for text in texts.map(|text| Bytes::from_static(text.as_bytes())) {
            if self.absent.contains(&text) {
                let path = femc_store::artifact_path(&Digest::compute(&text));
                // It may have been absent before.
                let _ = store.objects().delete(&path).await;
            } else {
                store.put(text).await.expect("an artifact");
            }
        }
    }
}

impl TestJob {
    fn frame_table(&self) -> Vec<FrameStatus> {
        let status = |&frame: &u32| {
            let record = self.records.iter().find(|record| record.frame == frame).cloned();
            let state = if record.is_some() { TaskState::Done } else { TaskState::Waiting };
            FrameStatus { frame, state, progress: None, record, times: None }
        };
        self.spec.frames.iter().map(status).collect()
    }

    fn task_page(&self, filter: TaskFilter, from: u64, count: usize) -> TaskPage {
        let mut wanted = Vec::new();
        for task in &self.tasks {
            let stage = task.task.stage;
            let is_other = filter.frame.is_some_and(|frame| frame != stage.frame)
                || filter.stage.is_some_and(|number| number != stage.number)
                || filter.state.is_some_and(|state| state != task.state);
            if !is_other {
                wanted.push(task.clone());
            }
        }
        let total = wanted.len() as u64;
        TaskPage {
            total,
            tasks: wanted.into_iter().skip(usize::try_from(from).unwrap_or(usize::MAX)).take(count).collect(),
        }
    }
}

/// A coordinator of a farm.
pub struct Server {
    pub http: Http<()>,
    pub world: Arc<Mutex<World>>,
    pub store: Store,
}

impl Server {
    pub async fn new(world: &World) -> Self {
        let store = Store::in_memory();
        world.fill(&store).await;
        Self::with_store(world, store, open_gate())
    }

    /// Starts a server with the artifacts of another one.
    pub fn with_store(world: &World, store: Store, gate: Gate) -> Self {
        let (calls, mut inbox) = mpsc::channel::<Call<()>>(8);
        let files = world.files.iter().enumerate();
        let light_files = files.map(|(number, path)| LightFile { name: format!("file {number}"), path: path.clone() });
        let site = Site {
            draw: Some(draw),
            compare: Some(compare),
            open_light: Some(open),
            light_files: light_files.collect(),
            engine: "test".into(),
            ..Site::default()
        };
        let world = Arc::new(Mutex::new(world.clone()));
        let state = world.clone();
        tokio::spawn(async move {
            while let Some(call) = inbox.recv().await {
                state.lock().unwrap().answer(call);
            }
        });
        Self { http: serve(Farm::new(calls), store.clone(), gate, site), world, store }
    }

    /// Starts another server of the farm as it is now.
    pub fn fresh(&self) -> Self {
        Self::with_store(&self.world.lock().unwrap(), self.store.clone(), open_gate())
    }

    /// Changes the farm.
    pub async fn change(&self, change: fn(&mut World)) {
        let world = {
            let mut world = self.world.lock().unwrap();
            change(&mut world);
            world.clone()
        };
        world.fill(&self.store).await;
    }
}

/// Interval in which growing light and sorted tasks may be old.
pub const GROWTH: Duration = Duration::from_millis(1050);

fn text(bytes: &Bytes) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Writes the names of the sources.
fn compare([a, b]: [PictureSource; 2]) -> Result<Vec<u8>, String> {
    let name = |picture: PictureSource| match picture {
        PictureSource::Image(bytes) | PictureSource::Statistics(bytes) => text(&bytes),
        PictureSource::Preview(_) | PictureSource::Parts(..) => "a picture that cannot be compared".to_owned(),
    };
    Ok(format!("{} against {}", name(a), name(b)).into_bytes())
}

/// Draws the name of the picture and of its source.
fn draw(source: PictureSource, kind: PictureKind) -> Result<Vec<u8>, String> {
    let source = match source {
        PictureSource::Image(bytes) | PictureSource::Preview(bytes) | PictureSource::Statistics(bytes) => text(&bytes),
        PictureSource::Parts(_, outputs) => {
            outputs.iter().map(|(_, bytes)| text(bytes)).collect::<Vec<_>>().join(" + ")
        }
    };
    let kind = match kind {
        PictureKind::Thumbnail { height } => format!("{height} rows"),
        PictureKind::Pixels => "pixels".to_owned(),
        PictureKind::Maps => "maps".to_owned(),
        PictureKind::FileMaps => "maps of a file".to_owned(),
    };
    Ok(format!("{kind}: {source}").into_bytes())
}

/// Light that answers with the names of its sources and the question.
struct Echo(String);

#[expect(clippy::needless_pass_by_value, reason = "the signature is that of `OpenLight`")]
fn open(_tag: &str, sources: Vec<LightSource>) -> Result<Option<Arc<dyn LightData>>, LightFault> {
    let source = |source: &LightSource| {
        let parts: Vec<String> = source.parts.iter().map(text).collect();
        format!("{}{} [{}]", source.name, if source.is_growing { " so far" } else { "" }, parts.join(" + "))
    };
    Ok(Some(Arc::new(Echo(sources.iter().map(source).collect::<Vec<_>>().join(", ")))))
}

impl LightData for Echo {
    fn memory_bytes(&self) -> usize {
        1
    }

    fn answer(
        &self,
        call: &LightCall,
        earlier: Option<&femc_service::EarlierRows>,
        _is_cancelled: &AtomicBool,
    ) -> Result<LightAnswer, LightError> {
        let LightCall { kind, condition, bounds } = call;
        let question = match kind {
            LightCallKind::Schema => "schema".to_owned(),
            LightCallKind::Paths { count, brightest: true } => format!("{} brightest", count.get()),
            LightCallKind::Paths { count, brightest: false } => format!("{} of all", count.get()),
            LightCallKind::Histograms { pairs, by_image } => {
                let by = if *by_image { "image" } else { "samples" };
                format!("histograms {:?} by {by}", pairs.as_slice())
            }
            LightCallKind::Voxels { level, bounce } => format!("voxels {} {bounce:?}", level.get()),
            LightCallKind::Summary => "summary".to_owned(),
            LightCallKind::Selection { with_density: true } => "selection and density".to_owned(),
            LightCallKind::Selection { with_density: false } => "selection".to_owned(),
        };
        let condition = condition.as_deref().map(|text| format!(" if {text}")).unwrap_or_default();
        let bounds = bounds.map(|corners| format!(" in {:?}", corners.get())).unwrap_or_default();
        let since = earlier.map(|rows| format!(" since {}", rows.tag)).unwrap_or_default();
        let bytes = format!("{question}{condition}{bounds} of {}{since}", self.0).into_bytes();
        Ok(match kind {
            LightCallKind::Schema | LightCallKind::Summary => LightAnswer::Json(bytes),
            LightCallKind::Paths { .. } => LightAnswer::Rows { columns: bytes, identities: vec![[0; 16]].into() },
            _ => LightAnswer::Columns(bytes),
        })
    }
}
