//! A job frame by frame and task by task, as programs and pages read it.

use femc_model::{FrameStatus, Output, Role, TaskStatus, Times};
use serde::Serialize;

/// A frame as JSON; number 0: the job's own stages.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameJson {
    frame: u32,
    state: &'static str,
    /// Kind of the stage in work.
    stage: Option<&'static str>,
    tiles_done: u32,
    tiles: u32,
    running: u32,
    /// Attempts at its tasks that have ended.
    attempts: u32,
    samples: u64,
    /// `None` also where no sample met light.
    relative_error: Option<f64>,
    /// Blocks of the frame, and those in which no sample met light.
    blocks: Option<u32>,
    unlit_blocks: Option<u32>,
    /// From the first lease to the last result, once it is done: also the time in which workers did other tasks.
    seconds: Option<f64>,
    /// Rounds that it took, once it is done.
    rounds: Option<u32>,
    #[serde(flatten)]
    times: TimesJson,
    has_image: bool,
    outputs: Vec<OutputJson>,
}

/// Time of attempts that have ended, as JSON; null: none has ended, or it is not known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
struct TimesJson {
    /// Processor seconds of all attempts, summed.
    processor_seconds: Option<f64>,
    /// Seconds that workers spent in attempts, summed.
    wall_seconds: Option<f64>,
    /// Seconds between the first lease and the end of the last one in which no attempt ran.
    waiting_seconds: Option<f64>,
}

impl From<Option<Times>> for TimesJson {
    fn from(times: Option<Times>) -> Self {
        Self {
            processor_seconds: times.map(|times| times.processor),
            wall_seconds: times.map(|times| times.wall),
            waiting_seconds: times.map(|times| times.waiting),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct OutputJson {
    role: &'static str,
    digest: String,
    bytes: u64,
}

impl From<&Output> for OutputJson {
    fn from(output: &Output) -> Self {
        let artifact = &output.artifact;
        Self { role: output.role.name(), digest: artifact.digest.to_string(), bytes: artifact.bytes }
    }
}

impl FrameJson {
    /// Of a frame.
    /// - `pixels`: of the film.
    pub fn new(frame: &FrameStatus, pixels: u64) -> Self {
        let (progress, record) = (frame.progress.as_ref(), frame.record.as_ref());
        let blocks = match record {
            Some(record) => record.blocks,
            None => progress.and_then(|progress| progress.blocks),
        };
        let of_record = record.map(|record| u64::from(record.spp) * pixels);
        Self {
            frame: frame.frame,
            state: frame.state.name(),
            stage: progress.map(|progress| progress.stage.name()),
            tiles_done: progress.map_or(0, |progress| progress.tiles_done),
            tiles: progress.map_or(0, |progress| progress.tiles_total),
            running: progress.map_or(0, |progress| progress.running),
            samples: progress.map(|progress| progress.samples_done).or(of_record).unwrap_or(0),
            relative_error: match record {
                Some(record) => record.relative_error,
                None => progress.and_then(|progress| progress.relative_error),
            },
            blocks: blocks.map(|blocks| blocks.all),
            unlit_blocks: blocks.map(|blocks| blocks.unlit),
            seconds: record.map(|record| record.seconds),
            rounds: record.and_then(|record| record.rounds),
            attempts: frame.times.map_or(0, |times| times.attempts),
            times: frame.times.into(),
            has_image: record.is_some_and(|record| record.output(Role::Image).is_some()),
            outputs: record.map_or_else(Vec::new, |record| record.outputs.iter().map(OutputJson::from).collect()),
        }
    }
}

/// A task as JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TaskJson {
    task: String,
    frame: u32,
    round: u32,
    stage: &'static str,
    /// Of the stage.
    number: u16,
    index: u32,
    state: &'static str,
    workers: Vec<String>,
    attempts: u32,
    /// Since the first of its leases, while it runs or is queued.
    seconds: Option<f64>,
    #[serde(flatten)]
    times: TimesJson,
    failure: Option<String>,
}

impl From<&TaskStatus> for TaskJson {
    fn from(status: &TaskStatus) -> Self {
        let stage = &status.task.stage;
        Self {
            task: status.task.to_string(),
            frame: stage.frame,
            round: stage.round,
            stage: stage.kind.name(),
            number: stage.number,
            index: status.task.index,
            state: status.state.name(),
            workers: status.workers.clone(),
            attempts: status.attempts,
            seconds: status.seconds,
            times: status.times.into(),
            failure: status.failure.as_ref().map(ToString::to_string),
        }
    }
}
