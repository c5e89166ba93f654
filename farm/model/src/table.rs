//! Detailed tables of a job: its tasks and its frames.

use serde::{Deserialize, Serialize};

use crate::{AttemptTimes, Failure, FrameProgress, FrameRecord, TaskKey};

/// State of a task or a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum TaskState {
    /// No worker has a lease of it.
    Waiting,
    /// A worker has it in its queue and has not started it. Frames are never in this state.
    Queued,
    /// A worker runs it or a part of it. For a frame: some of its tasks are done.
    Running,
    /// It is done.
    Done,
    /// It used up its attempts. For a frame: it cannot be finished without a retry.
    Failed,
}

impl TaskState {
    /// All states, in the order in which they are reached.
    pub const ALL: [Self; 5] = [Self::Waiting, Self::Queued, Self::Running, Self::Done, Self::Failed];

    /// Name in one word.
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

/// Status of a task as a whole, not of its chunks: the index of its key is the number of the task in the stage.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskStatus {
    /// The task.
    pub task: TaskKey,
    /// State of the task.
    pub state: TaskState,
    /// Whether the entry stands for the tasks with this number in all rounds. Each task of a finished frame is listed once.
    pub covers_all_rounds: bool,
    /// Names of the workers that run the task or parts of it, or have it in their queue. After the attempts are looked up
    /// ([`TaskStatus::times`]), a task that is done or failed has the workers of these attempts, first the one with the result.
    pub workers: Vec<String>,
    /// Number of attempts: those that failed since the task was last done or retried, and those that run or are queued. After the
    /// attempts are looked up, a task that is done has the number of all ended attempts.
    pub attempts: u32,
    /// Seconds since the first lease of the task was granted, while it runs or is queued.
    pub seconds: Option<f64>,
    /// Failure of the last attempt.
    pub failure: Option<Failure>,
    /// Time of its ended attempts. `None`: not looked up, or no attempt has ended.
    pub times: Option<AttemptTimes>,
}

/// Status of a frame, or of the job's own stages under [`Stage::JOB_FRAME`](crate::Stage::JOB_FRAME).
#[derive(Debug, Clone, PartialEq)]
pub struct FrameStatus {
    /// Frame number.
    pub frame: u32,
    /// State of the frame.
    pub state: TaskState,
    /// Progress, while the frame is in progress.
    pub progress: Option<FrameProgress>,
    /// Results, once the frame is done.
    pub record: Option<FrameRecord>,
    /// Time of its ended attempts. `None`: not looked up, or no attempt has ended.
    pub times: Option<AttemptTimes>,
}

/// Filter for the tasks of a job.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TaskFilter {
    /// Only tasks of this frame.
    pub frame: Option<u32>,
    /// Only tasks of the stage with this number.
    pub stage: Option<u16>,
    /// Only tasks in this state.
    pub state: Option<TaskState>,
}

/// A page of a job's tasks.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TaskPage {
    /// Number of tasks that pass the filter.
    pub total: u64,
    /// A window of these tasks, ordered by frame, stage, round and number.
    pub tasks: Vec<TaskStatus>,
}
