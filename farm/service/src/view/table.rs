//! JSON of a job's frames and tasks.

use femc_model::{AttemptTimes, FrameStatus, Output, Role, TaskStatus};
use serde::Serialize;

/// A frame as JSON. Number 0 stands for the job's own stages.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameJson {
    frame: u32,
    state: &'static str,
    /// Kind of the stage in progress.
    stage: Option<&'static str>,
    tiles_done: u32,
    tiles: u32,
    running: u32,
    /// Number of ended attempts at its tasks.
    attempts: u32,
    samples: u64,
    /// Relative error; `None` also if no sample found light.
    relative_error: Option<f64>,
    /// Blocks of the frame, and those in which no sample found light.
    blocks: Option<u32>,
    unlit_blocks: Option<u32>,
    /// Seconds from the first lease to the last result, once the frame is done. This includes time in which workers ran other
    /// tasks.
    seconds: Option<f64>,
    /// Number of rounds, once the frame is done.
    rounds: Option<u32>,
    #[serde(flatten)]
    times: TimesJson,
    has_image: bool,
    outputs: Vec<OutputJson>,
}

/// Times of ended attempts, as JSON; null: no attempt has ended, or the times are not known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
struct TimesJson {
    /// Processor seconds of all attempts, summed.
    processor_seconds: Option<f64>,
    /// Seconds that workers spent in attempts, summed.
    wall_seconds: Option<f64>,
    /// Seconds without a running attempt, between the first lease and the end of the last one.
    waiting_seconds: Option<f64>,
}

impl From<Option<AttemptTimes>> for TimesJson {
    fn from(times: Option<AttemptTimes>) -> Self {
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
    /// Makes the JSON of a frame.
    /// - `pixels`: number of pixels of the film.
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
    /// Number of the stage.
    number: u16,
    index: u32,
    state: &'static str,
    workers: Vec<String>,
    attempts: u32,
    /// Seconds since the first lease of the task, while it runs or is queued.
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
