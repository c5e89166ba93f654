//! Status of jobs and workers.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{BlockCounts, Failure, JobId, JobNotes, JobState, StageKind, TaskKey, WorkerId};

/// Summary of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JobStatus {
    /// The job.
    pub job: JobId,
    /// Name.
    pub name: String,
    /// Name of the owner who submitted the job.
    pub owner: String,
    /// Path of the scene file within its bundle.
    pub scene: String,
    /// Notes submitted with the job.
    pub notes: JobNotes,
    /// Priority, 0..=100.
    pub priority: u8,
    /// State of the job.
    pub state: JobState,
    /// Failure of the job as a whole, if it failed.
    pub failure: Option<Failure>,
    /// Number of requested frames.
    pub frames_total: u32,
    /// Number of finished frames.
    pub frames_done: u32,
    /// Number of frames that cannot be finished without a retry.
    pub frames_failed: u32,
    /// Frames in progress, ascending.
    pub active: Vec<FrameProgress>,
    /// Number of workers that hold a lease of the job.
    pub workers: u32,
    /// Pixel samples in results and in running tasks.
    pub samples_done: u64,
    /// Pixel samples if every frame uses every round. This is an upper bound.
    pub samples_planned: u64,
    /// Recent pixel samples per second; 0 until it is known.
    pub samples_per_second: f64,
    /// Number of samples refused because they were not finite.
    pub bad_samples: u64,
    /// Relative error of the worst frame so far, finished or in progress. `None` also if no sample found light.
    pub relative_error: Option<f64>,
    /// Blocks of the worst frame.
    pub blocks: Option<BlockCounts>,
    /// The worst frame; `None`: no frame was measured.
    pub worst_frame: Option<WorstFrame>,
    /// Target relative error of each frame; `None`: samples or time end the job. The coordinator fills this in, because the
    /// scheduler does not read settings.
    pub error_target: Option<f64>,
    /// Seconds since the first lease. For an ended job, seconds from the first lease to the end.
    pub seconds: f64,
    /// Tasks that used up their attempts.
    pub quarantined: Vec<QuarantinedTask>,
    /// Number of messages refused because their lease was over.
    pub stale_messages: u64,
    /// Number of slow tasks that were also given to a second worker, since the coordinator started.
    pub copies: u64,
    /// Reasons why tasks of the job wait.
    pub waits: Vec<WaitReason>,
    /// Time of submission: Unix time in milliseconds, by the farm's clock. This clock stands still while no coordinator runs, so
    /// the time of a job submitted before an outage is shifted by the length of the outage. `None`: the date is not known.
    pub submitted: Option<u64>,
    /// Calendar date of submission: Unix time in milliseconds, by the clock of the coordinator's machine. `None`: not known, as for
    /// jobs in logs before version 10.
    pub submitted_date: Option<u64>,
}

/// The frame of a job with the greatest relative error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorstFrame {
    /// Frame number.
    pub frame: u32,
    /// Whether, and why, the frame takes no more samples.
    pub stop: FrameStop,
}

/// Whether a measured frame takes more samples, and why not. This explains an error above the target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FrameStop {
    /// The frame is in progress. Its error is that of the previous round.
    Rendering,
    /// The frame ended with the last planned round: the limit of samples.
    Limit,
    /// The frame stopped before the last planned round. An estimate from one half of a tile's samples ends the other half, so the
    /// error of all samples may be slightly above the target.
    Estimate,
    /// The frame is done, and its number of rounds is not known.
    Unknown,
}

impl FrameStop {
    /// All variants.
    pub const ALL: [Self; 4] = [Self::Rendering, Self::Limit, Self::Estimate, Self::Unknown];

    /// Returns the name, one or two words in snake case.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rendering => "rendering",
            Self::Limit => "sample_limit",
            Self::Estimate => "estimate",
            Self::Unknown => "unknown",
        }
    }
}

/// Progress of an unfinished frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameProgress {
    /// Frame number.
    pub frame: u32,
    /// Current round, from 0.
    pub round: u32,
    /// Maximum number of planned rounds.
    pub rounds: u32,
    /// Kind of the stage in progress.
    pub stage: StageKind,
    /// Number of tiles, or other tasks of the main stage, whose steps in this round are all done.
    pub tiles_done: u32,
    /// Number of these tasks in the round.
    pub tiles_total: u32,
    /// Number of leased tasks of the frame.
    pub running: u32,
    /// Pixel samples in all rounds, in results and in running tasks.
    pub samples_done: u64,
    /// Relative error after the previous round.
    pub relative_error: Option<f64>,
    /// Blocks as measured after the previous round.
    pub blocks: Option<BlockCounts>,
}

/// A task that used up its attempts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuarantinedTask {
    /// The task.
    pub task: TaskKey,
    /// Number of attempts.
    pub attempts: u32,
    /// Failure of the last attempt.
    pub failure: Failure,
}

/// Reason why tasks of a job wait. It is computed with the scheduler's own predicates.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum WaitReason {
    /// The job is paused.
    Paused,
    /// No worker is connected.
    NoWorkers,
    /// No worker has all these tags.
    NoWorkerWithTags(Vec<String>),
    /// Every suitable worker holds the maximum number of tasks.
    WorkersBusy {
        /// Number of such workers.
        workers: u32,
    },
    /// Every suitable worker takes no more tasks: it is drained, leaving or off duty.
    WorkersDraining {
        /// Number of such workers.
        workers: u32,
    },
    /// Every suitable worker is in a back-off after a failure of its surroundings (store, network, disk, memory).
    AllWorkersBackingOff,
    /// Suitable workers have been silent for the duration of a lease: stopped, disconnected or overloaded.
    WorkersSilent {
        /// Number of such workers.
        workers: u32,
        /// Seconds of silence of the worker that has been silent the longest.
        seconds: u64,
    },
    /// Suitable workers are in a back-off, each after a failure of its surroundings.
    WorkersBackingOff {
        /// Number of such workers.
        workers: u32,
        /// Seconds until the first of them gets a task again.
        seconds: u64,
        /// Failure of that worker.
        failure: Failure,
    },
    /// Tasks of the job kept failing on some workers. These workers get no tasks of the job for a while.
    WorkersQuarantined {
        /// Number of such workers.
        workers: u32,
        /// Seconds until the first of them gets a task as a probe; 0: it has the task.
        seconds: u64,
    },
    /// Tasks wait for another worker, because their last attempts failed on the workers with free capacity.
    WorkersAvoided {
        /// Number of such tasks.
        tasks: u32,
    },
    /// Frames wait because all workers with free capacity have another build of the engine than the workers that started the
    /// frames. A frame restarts if no worker of its build has been connected for a while.
    OtherBuild {
        /// Number of such frames.
        frames: u32,
    },
    /// The coordinator has just started or was suspended. It first waits for workers to report the tasks they still have.
    Regrouping {
        /// Milliseconds until tasks are dispatched.
        milliseconds: u64,
    },
    /// A job with a higher priority, or an older one, has ready tasks.
    BehindJob(JobId),
    /// No task of a frame is ready: the next stage waits for tasks that are running.
    StageWaits {
        /// Frame number, or [`Stage::JOB_FRAME`](crate::Stage::JOB_FRAME) for the job's own stages.
        frame: u32,
        /// Kind of the stage that waits.
        stage: StageKind,
        /// Kind of the stage that it waits for.
        needs: StageKind,
        /// Number of these tasks that are not done.
        tasks: u32,
    },
    /// Frames wait for a shared stage, which runs once for all frames and jobs with the same content.
    SharedStage {
        /// Id of the shared result.
        shared: JobId,
        /// Kind of the shared stage in progress.
        stage: StageKind,
        /// Number of tasks of this stage that are done.
        done: u32,
        /// Number of tasks of this stage.
        tasks: u32,
        /// Number of jobs that wait for it.
        jobs: u32,
    },
    /// Attempts at unfinished tasks failed because of their surroundings: the store, the network, or a worker's memory.
    InfrastructureFailures {
        /// Number of such tasks.
        tasks: u32,
        /// Last error of one of these tasks.
        message: String,
    },
    /// A finished output was damaged in the store or is missing. If it belongs to a frame (its image or its preview), the frame is
    /// rendered again. If it belongs to the job (a still, the contact sheet or the clip), the job's own stages run again.
    ImageLost {
        /// Frame number, or [`Stage::JOB_FRAME`](crate::Stage::JOB_FRAME).
        frame: u32,
    },
    /// Frames need a shared result whose tasks used up their attempts.
    SharedQuarantined {
        /// Id of the shared result that cannot be computed.
        shared: JobId,
        /// Number of frames of the job that need it.
        frames: u32,
        /// Number of its tasks that used up their attempts.
        tasks: u32,
    },
    /// Tasks used up their attempts, so their frame cannot be finished. Or the job's own stages wait for frames that failed.
    Quarantined {
        /// Frame number, or [`Stage::JOB_FRAME`](crate::Stage::JOB_FRAME).
        frame: u32,
        /// Number of the frame's tasks; 0: the job's own stages wait for frames that failed.
        tasks: u32,
    },
}

/// Whether a worker gets more tasks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Intake {
    /// The worker gets tasks.
    #[default]
    Open,
    /// The worker wants no tasks: it is leaving or off duty.
    Off,
    /// An operator has drained the worker.
    Drained,
}

/// Action of an operator on a worker's intake.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Drain {
    /// Drain: the worker gets no more tasks, and finishes those it has.
    Begin,
    /// End the drain: the worker gets tasks again.
    Undo,
}

/// Selection of workers by a user.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum WorkerSelector {
    /// The worker with this number.
    Number(WorkerId),
    /// Every worker with this name.
    Name(String),
}

impl fmt::Display for WorkerSelector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(worker) => worker.fmt(f),
            Self::Name(name) => name.fmt(f),
        }
    }
}

/// Workers of a farm.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct WorkerList {
    /// Connected workers, in the order in which they joined.
    pub connected: Vec<WorkerStatus>,
    /// Disconnected workers, latest first.
    pub offline: Vec<OfflineWorker>,
}

/// A disconnected worker. Of several with one name, the one with the latest contact.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OfflineWorker {
    /// Name.
    pub name: String,
    /// Number of render threads.
    pub threads: u32,
    /// Tags that the worker offered.
    pub tags: Vec<String>,
    /// Build of the engine.
    pub engine: String,
    /// Last contact, Unix time in milliseconds.
    pub last_contact: u64,
}

/// Summary of a worker.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkerStatus {
    /// Number of the worker. It is kept across sessions while its name is known.
    pub worker: WorkerId,
    /// Name.
    pub name: String,
    /// Number of render threads.
    pub threads: u32,
    /// Tags that the worker offers.
    pub tags: Vec<String>,
    /// Tasks that the worker holds, in order of key.
    pub tasks: Vec<TaskKey>,
    /// Milliseconds since the worker's last message.
    pub silent: u64,
    /// Number of results accepted from the worker since its name became known, including before the coordinator's last start.
    pub completed: u64,
    /// Number of tasks that failed on the worker in the same period.
    pub failed: u64,
    /// Whether the worker gets more tasks.
    pub intake: Intake,
    /// Build of the engine; empty: an earlier coordinator does not report it.
    pub engine: String,
}
