//! What may be asked about jobs and workers.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Blocks, Failure, JobId, JobNotes, JobState, StageKind, TaskKey, WorkerId};

/// A job at a glance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JobStatus {
    /// The job.
    pub job: JobId,
    /// Its name.
    pub name: String,
    /// Name of the owner who submitted the job.
    pub owner: String,
    /// Path of the scene file within its bundle.
    pub scene: String,
    /// Notes that it was submitted with.
    pub notes: JobNotes,
    /// 0..=100.
    pub priority: u8,
    /// State of the job.
    pub state: JobState,
    /// Why the job as a whole has failed, if it did.
    pub failure: Option<Failure>,
    /// Frames asked for.
    pub frames_total: u32,
    /// Frames finished.
    pub frames_done: u32,
    /// Frames that cannot be finished without a retry.
    pub frames_failed: u32,
    /// Frames in work, ascending.
    pub active: Vec<FrameProgress>,
    /// Workers that hold a lease of it.
    pub workers: u32,
    /// Pixel samples in results and in running tasks.
    pub samples_done: u64,
    /// Pixel samples if every frame uses every round: an upper bound.
    pub samples_planned: u64,
    /// Pixel samples a second of late; 0 until it is known.
    pub samples_per_second: f64,
    /// Samples refused because they were not finite.
    pub bad_samples: u64,
    /// Relative error of the worst frame so far, finished or in work; `None` also where no sample has met light.
    pub relative_error: Option<f64>,
    /// Blocks of that frame.
    pub blocks: Option<Blocks>,
    /// Which frame it is; `None`: no frame was measured.
    pub worst_frame: Option<WorstFrame>,
    /// Relative error that each frame is to reach; `None`: the job stops by samples or by time. The scheduler does not read settings:
    /// the coordinator fills this in.
    pub error_target: Option<f64>,
    /// Seconds since the first lease, or from the first lease to the end.
    pub seconds: f64,
    /// Tasks out of attempts.
    pub quarantined: Vec<Quarantined>,
    /// Messages refused because their lease was over.
    pub stale_messages: u64,
    /// Late tasks that were given to a second worker, since the coordinator's start.
    pub copies: u64,
    /// Reasons for which tasks of the job wait.
    pub waits: Vec<Wait>,
    /// When it was submitted: Unix time in milliseconds, by the farm's clock, which stands still while no coordinator is there: what
    /// was submitted before an outage counts as submitted so much later. `None`: nobody knows what the date was.
    pub submitted: Option<u64>,
    /// Calendar date of its submission: Unix time in milliseconds, by the coordinator's machine. `None`: not known, as of jobs in
    /// logs before version 10.
    pub submitted_date: Option<u64>,
}

/// The frame with the greatest relative error of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorstFrame {
    /// Frame number.
    pub frame: u32,
    /// Whether and why it takes no more samples.
    pub stop: FrameStop,
}

/// Whether a measured frame takes more samples, and why not. It explains an error above the target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FrameStop {
    /// It is in work: its error is that of the round before.
    Rendering,
    /// Its last round was the last one that is planned: the limit of samples.
    Limit,
    /// It stopped before. Each half of a tile's samples is ended by an estimate from the other half, so the error of all samples may
    /// be a little above the target.
    Estimate,
    /// It is done, and its number of rounds is not known.
    Unknown,
}

impl FrameStop {
    /// All.
    pub const ALL: [Self; 4] = [Self::Rendering, Self::Limit, Self::Estimate, Self::Unknown];

    /// Name, one or two words in snake case.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rendering => "rendering",
            Self::Limit => "sample_limit",
            Self::Estimate => "estimate",
            Self::Unknown => "unknown",
        }
    }
}

/// How far a frame in work is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameProgress {
    /// Frame number.
    pub frame: u32,
    /// Round, from 0.
    pub round: u32,
    /// Rounds planned at most.
    pub rounds: u32,
    /// Kind of the stage in work.
    pub stage: StageKind,
    /// Tiles, or other tasks of its main stage, of which all steps of this round are done.
    pub tiles_done: u32,
    /// How many there are in the round.
    pub tiles_total: u32,
    /// Tasks of it that are leased.
    pub running: u32,
    /// Pixel samples in all rounds, results and running tasks.
    pub samples_done: u64,
    /// Relative error after the round before.
    pub relative_error: Option<f64>,
    /// Blocks as they were measured then.
    pub blocks: Option<Blocks>,
}

/// A task that used up its attempts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quarantined {
    /// The task.
    pub task: TaskKey,
    /// How often it was tried.
    pub attempts: u32,
    /// Why the last attempt failed.
    pub failure: Failure,
}

/// Why tasks of a job wait; computed by the scheduler's own predicates.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wait {
    /// The job is held.
    Paused,
    /// No worker is there.
    NoWorkers,
    /// No worker has all these tags.
    NoWorkerWithTags(Vec<String>),
    /// Every worker that may take it has all that it can hold.
    WorkersBusy {
        /// Number of such workers.
        workers: u32,
    },
    /// Every worker that may take it takes no more tasks: it is drained, leaving or off duty.
    WorkersDraining {
        /// Number of such workers.
        workers: u32,
    },
    /// Every worker that may take it rests after a failure of its surroundings.
    WorkersResting,
    /// Workers that may take it have not been heard of for as long as a lease lasts: stopped, cut off or overloaded.
    WorkersSilent {
        /// Number of such workers.
        workers: u32,
        /// How long the one has been silent that has been so the longest.
        seconds: u64,
    },
    /// Workers that may take it rest, each after a failure of its surroundings.
    WorkersInTrouble {
        /// Number of such workers.
        workers: u32,
        /// Until the first of them gets a task again.
        seconds: u64,
        /// What happened to that one.
        failure: Failure,
    },
    /// Tasks of the job kept failing on some workers: they get none of it for a while.
    WorkersQuarantined {
        /// Number of such workers.
        workers: u32,
        /// Until the first of them gets a task as a probe; 0: it has it.
        seconds: u64,
    },
    /// Tasks that failed last on the workers with room wait for others.
    WorkersAvoided {
        /// Number of such tasks.
        tasks: u32,
    },
    /// Frames that were begun by workers of another build of the engine than all with room: they wait for one of theirs, or begin
    /// anew when none has been there for a while.
    OtherBuild {
        /// Number of such frames.
        frames: u32,
    },
    /// The coordinator has just begun, or slept: first it hears which workers still have tasks.
    Regrouping {
        /// Milliseconds until tasks are given out.
        milliseconds: u64,
    },
    /// Jobs with more priority, or older, have tasks ready.
    BehindJob(JobId),
    /// Nothing of a frame can be given out: its next stage waits for tasks that workers are doing.
    StageWaits {
        /// Frame number; [`Stage::OF_JOB`](crate::Stage::OF_JOB): of the job's own stages.
        frame: u32,
        /// Kind of the stage that waits.
        stage: StageKind,
        /// Kind of the stage that it waits for.
        needs: StageKind,
        /// How many of these tasks are not done.
        tasks: u32,
    },
    /// Frames wait for what is done once for all frames, and all jobs, that have one content.
    SharedStage {
        /// What is being done for it, in its own number.
        shared: JobId,
        /// Kind of the shared stage that is in work.
        stage: StageKind,
        /// Tasks of this stage that are done.
        done: u32,
        /// Tasks of this stage.
        tasks: u32,
        /// How many jobs wait for it.
        jobs: u32,
    },
    /// Tasks that are not done were tried, and what is around them failed: the store, the network, a worker's memory.
    Mishaps {
        /// Number of such tasks.
        tasks: u32,
        /// What went wrong with one of them last.
        message: String,
    },
    /// A finished output was damaged in the store or is gone. Of a frame, its image or its preview: the frame is rendered again. Of
    /// the job, a still, the sheet or the clip: the job's own stages run again.
    ImageLost {
        /// Frame number, or [`Stage::OF_JOB`](crate::Stage::OF_JOB).
        frame: u32,
    },
    /// Frames need what is done once for all that have one content, and tasks of that used up their attempts.
    SharedQuarantined {
        /// What cannot be done, in its own number.
        shared: JobId,
        /// How many frames of the job.
        frames: u32,
        /// How many of its tasks.
        tasks: u32,
    },
    /// Tasks used up their attempts, and their frame cannot go on; or the job's own stages wait for frames that failed.
    Quarantined {
        /// Frame number, or [`Stage::OF_JOB`](crate::Stage::OF_JOB).
        frame: u32,
        /// How many of its tasks; 0: the job's own stages wait for frames that failed.
        tasks: u32,
    },
}

/// Whether a worker gets more tasks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Intake {
    /// Yes.
    #[default]
    Open,
    /// It wants none: it is leaving, or off duty.
    Off,
    /// An operator has drained it.
    Drained,
}

/// What an operator does to a worker's intake.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Drain {
    /// It gets no more tasks; what it has it finishes.
    Begin,
    /// It gets tasks again.
    Undo,
}

/// A worker as people name it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum WorkerName {
    /// One session.
    Number(WorkerId),
    /// Every worker of this name.
    Name(String),
}

impl fmt::Display for WorkerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(worker) => worker.fmt(f),
            Self::Name(name) => name.fmt(f),
        }
    }
}

/// The workers of a farm.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Crew {
    /// Those that are there, in order of joining.
    pub there: Vec<WorkerStatus>,
    /// Those that were there, the latest first.
    pub offline: Vec<OfflineWorker>,
}

/// A worker that was there. Of several of one name it is the one that was heard of last.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OfflineWorker {
    /// Its name.
    pub name: String,
    /// Threads that rendered.
    pub threads: u32,
    /// Tags that the worker offered.
    pub tags: Vec<String>,
    /// Its build of the engine.
    pub engine: String,
    /// Its last contact, Unix milliseconds.
    pub heard: u64,
}

/// A worker at a glance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkerStatus {
    /// Its number. It stays the same over sessions, as long as its name is known.
    pub worker: WorkerId,
    /// Its name.
    pub name: String,
    /// Threads that render.
    pub threads: u32,
    /// Tags that the worker offers.
    pub tags: Vec<String>,
    /// Tasks it holds, in order of key.
    pub tasks: Vec<TaskKey>,
    /// Milliseconds since its last message.
    pub silent: u64,
    /// Results accepted from it since its name is known, also before the coordinator's last start.
    pub completed: u64,
    /// Tasks that failed there in the same time.
    pub failed: u64,
    /// Whether it gets more tasks.
    pub intake: Intake,
    /// Its build of the engine; empty: an earlier coordinator does not tell.
    pub engine: String,
}
