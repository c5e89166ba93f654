//! A job task by task and frame by frame, for those who look closely.

use serde::{Deserialize, Serialize};

use crate::{Failure, FrameProgress, FrameRecord, TaskKey, Times};

/// State of a task or a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum TaskState {
    /// No worker has it.
    Waiting,
    /// A worker has it in its queue and has not begun it; no frame is in this state.
    Queued,
    /// A worker does it, or some of it; of a frame, something of it is done.
    Running,
    /// It is done.
    Done,
    /// It used up its attempts; of a frame, it cannot be finished without a retry.
    Failed,
}

impl TaskState {
    /// All, in the order in which they are come to.
    pub const ALL: [Self; 5] = [Self::Waiting, Self::Queued, Self::Running, Self::Done, Self::Failed];

    /// Name, one word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
        }
    }
}

/// A task, before it is cut: the index of its key is its number in the stage.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskStatus {
    /// The task.
    pub task: TaskKey,
    /// State of it.
    pub state: TaskState,
    /// Whether it stands for the tasks of this number in all rounds: each task of a finished frame is listed once.
    pub is_of_all_rounds: bool,
    /// Names of the workers that have it, or parts of it: those that run it, or where it is queued. Once its attempts are looked up
    /// ([`TaskStatus::times`]), a task that is done or failed has the workers of these attempts, first the one with the result.
    pub workers: Vec<String>,
    /// Attempts that failed since it was last done or retried, and those that run or are queued. Once its attempts are looked up, a
    /// task that is done has all that ended.
    pub attempts: u32,
    /// Seconds since the first of its leases was granted, while it runs or is queued.
    pub seconds: Option<f64>,
    /// Why the last attempt failed.
    pub failure: Option<Failure>,
    /// Time of its attempts that have ended; `None`: not looked up, or none has ended.
    pub times: Option<Times>,
}

/// A frame, or the job's own stages under [`Stage::OF_JOB`](crate::Stage::OF_JOB).
#[derive(Debug, Clone, PartialEq)]
pub struct FrameStatus {
    /// Frame number.
    pub frame: u32,
    /// State of it.
    pub state: TaskState,
    /// How far it is, while it is in work.
    pub progress: Option<FrameProgress>,
    /// What there is of it, once it is done.
    pub record: Option<FrameRecord>,
    /// Time of its attempts that have ended; `None`: not looked up, or none has ended.
    pub times: Option<Times>,
}

/// Which tasks of a job.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TaskFilter {
    /// Of this frame.
    pub frame: Option<u32>,
    /// Of the stage of this number.
    pub stage: Option<u16>,
    /// In this state.
    pub state: Option<TaskState>,
}

/// Some of a job's tasks.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TaskPage {
    /// How many the filter lets through.
    pub total: u64,
    /// A window of these, by frame, stage, round and number.
    pub tasks: Vec<TaskStatus>,
}
