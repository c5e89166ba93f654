//! Statuses of jobs and workers.

use femc_model::{
    Drain, FrameProgress, FrameStop, Intake, JobId, JobStatus, OfflineWorker, QuarantinedTask, WaitReason, WorkerId,
    WorkerList, WorkerSelector, WorkerStatus, WorstFrame,
};

use super::graph::{kind, kind_number};
use super::{ConvertError, convert_all, convert_optional, job, required};
use crate::wire;
use wire::wait::{Reason, Tags, Tasks};

impl From<JobStatus> for wire::JobStatus {
    fn from(status: JobStatus) -> Self {
        let (comment, labels, notify) = job::split_notes(status.notes);
        Self {
            job: status.job.0,
            name: status.name,
            owner: status.owner,
            priority: status.priority.into(),
            state: wire::JobState::from(status.state).into(),
            failure: status.failure.map(Into::into),
            frames_total: status.frames_total,
            frames_done: status.frames_done,
            frames_failed: status.frames_failed,
            active: status.active.into_iter().map(Into::into).collect(),
            workers: status.workers,
            samples_done: status.samples_done,
            samples_planned: status.samples_planned,
            samples_per_second: status.samples_per_second,
            bad_samples: status.bad_samples,
            relative_error: status.relative_error,
            blocks: status.blocks.map(Into::into),
            worst_frame: status.worst_frame.map(Into::into),
            error_target: status.error_target,
            seconds: status.seconds,
            quarantined: status.quarantined.into_iter().map(Into::into).collect(),
            stale_messages: status.stale_messages,
            copies: status.copies,
            waits: status.waits.into_iter().map(Into::into).collect(),
            submitted_unix_ms: status.submitted,
            submitted_date_unix_ms: status.submitted_date,
            comment,
            labels,
            notify,
            scene: status.scene,
        }
    }
}

impl TryFrom<wire::JobStatus> for JobStatus {
    type Error = ConvertError;

    fn try_from(wire: wire::JobStatus) -> Result<Self, ConvertError> {
        Ok(Self {
            job: JobId(wire.job),
            name: wire.name,
            owner: wire.owner,
            scene: wire.scene,
            notes: job::join_notes(wire.comment, wire.labels, wire.notify)?,
            priority: job::priority(wire.priority)?,
            state: job::state(wire.state)?,
            failure: convert_optional(wire.failure)?,
            frames_total: wire.frames_total,
            frames_done: wire.frames_done,
            frames_failed: wire.frames_failed,
            active: convert_all(wire.active)?,
            workers: wire.workers,
            samples_done: wire.samples_done,
            samples_planned: wire.samples_planned,
            samples_per_second: wire.samples_per_second,
            bad_samples: wire.bad_samples,
            relative_error: wire.relative_error,
            blocks: convert_optional(wire.blocks)?,
            worst_frame: convert_optional(wire.worst_frame)?,
            error_target: wire.error_target,
            seconds: wire.seconds,
            quarantined: convert_all(wire.quarantined)?,
            stale_messages: wire.stale_messages,
            copies: wire.copies,
            waits: convert_all(wire.waits)?,
            submitted: wire.submitted_unix_ms,
            submitted_date: wire.submitted_date_unix_ms,
        })
    }
}

impl From<WorstFrame> for wire::WorstFrame {
    fn from(WorstFrame { frame, stop }: WorstFrame) -> Self {
        let stop = match stop {
            FrameStop::Rendering => wire::FrameStop::Rendering,
            FrameStop::Limit => wire::FrameStop::SampleLimit,
            FrameStop::Estimate => wire::FrameStop::Estimate,
            FrameStop::Unknown => wire::FrameStop::Unspecified,
        };
        Self { frame, stop: stop.into() }
    }
}

impl TryFrom<wire::WorstFrame> for WorstFrame {
    type Error = ConvertError;

    fn try_from(wire: wire::WorstFrame) -> Result<Self, ConvertError> {
        // Accept a reason that a later coordinator has added: nothing depends on it.
        let stop = match wire::FrameStop::try_from(wire.stop) {
            Ok(wire::FrameStop::Rendering) => FrameStop::Rendering,
            Ok(wire::FrameStop::SampleLimit) => FrameStop::Limit,
            Ok(wire::FrameStop::Estimate) => FrameStop::Estimate,
            Ok(wire::FrameStop::Unspecified) | Err(_) => FrameStop::Unknown,
        };
        Ok(Self { frame: wire.frame, stop })
    }
}

impl From<FrameProgress> for wire::FrameProgress {
    fn from(progress: FrameProgress) -> Self {
        Self {
            frame: progress.frame,
            round: progress.round,
            rounds: progress.rounds,
            stage: kind_number(progress.stage),
            tiles_done: progress.tiles_done,
            tiles_total: progress.tiles_total,
            running: progress.running,
            samples_done: progress.samples_done,
            relative_error: progress.relative_error,
            blocks: progress.blocks.map(Into::into),
        }
    }
}

impl TryFrom<wire::FrameProgress> for FrameProgress {
    type Error = ConvertError;

    fn try_from(wire: wire::FrameProgress) -> Result<Self, ConvertError> {
        Ok(Self {
            frame: wire.frame,
            round: wire.round,
            rounds: wire.rounds,
            stage: kind(wire.stage)?,
            tiles_done: wire.tiles_done,
            tiles_total: wire.tiles_total,
            running: wire.running,
            samples_done: wire.samples_done,
            relative_error: wire.relative_error,
            blocks: convert_optional(wire.blocks)?,
        })
    }
}

impl From<QuarantinedTask> for wire::Quarantined {
    fn from(quarantined: QuarantinedTask) -> Self {
        let QuarantinedTask { task, attempts, failure } = quarantined;
        Self { task: Some(task.into()), attempts, failure: Some(failure.into()) }
    }
}

impl TryFrom<wire::Quarantined> for QuarantinedTask {
    type Error = ConvertError;

    fn try_from(wire: wire::Quarantined) -> Result<Self, ConvertError> {
        Ok(Self {
            task: required("quarantined.task", wire.task)?.try_into()?,
            attempts: wire.attempts,
            failure: required("quarantined.failure", wire.failure)?.try_into()?,
        })
    }
}

impl From<WaitReason> for wire::Wait {
    fn from(wait: WaitReason) -> Self {
        let empty = wire::Empty {};
        Self {
            reason: Some(match wait {
                WaitReason::Paused => Reason::Paused(empty),
                WaitReason::NoWorkers => Reason::NoWorkers(empty),
                WaitReason::NoWorkerWithTags(tags) => Reason::NoWorkerWithTags(Tags { tags }),
                WaitReason::WorkersBusy { workers } => Reason::WorkersBusy(workers),
                WaitReason::WorkersDraining { workers } => Reason::WorkersDraining(workers),
                WaitReason::AllWorkersBackingOff => Reason::WorkersResting(empty),
                WaitReason::WorkersSilent { workers, seconds } => {
                    Reason::WorkersSilent(wire::Silent { workers, seconds })
                }
                WaitReason::WorkersBackingOff { workers, seconds, failure } => {
                    Reason::WorkersInTrouble(wire::Trouble { workers, seconds, failure: Some(failure.into()) })
                }
                WaitReason::WorkersQuarantined { workers, seconds } => {
                    Reason::WorkersQuarantined(wire::QuarantinedWorkers { workers, seconds })
                }
                WaitReason::WorkersAvoided { tasks } => Reason::WorkersAvoided(tasks),
                WaitReason::OtherBuild { frames } => Reason::OtherBuild(frames),
                WaitReason::Regrouping { milliseconds } => Reason::Regrouping(milliseconds),
                WaitReason::BehindJob(job) => Reason::BehindJob(job.0),
                WaitReason::StageWaits { frame, stage, needs, tasks } => {
                    let [stage, needs] = [stage, needs].map(kind_number);
                    Reason::StageWaits(wire::StageWaits { frame, stage, needs, tasks })
                }
                WaitReason::SharedStage { shared, stage, done, tasks, jobs } => {
                    let (shared, stage) = (shared.0, kind_number(stage));
                    Reason::SharedStage(wire::SharedStage { shared, stage, done, tasks, jobs })
                }
                WaitReason::SharedQuarantined { shared, frames, tasks } => {
                    Reason::SharedQuarantined(wire::SharedQuarantined { shared: shared.0, frames, tasks })
                }
                WaitReason::InfrastructureFailures { tasks, message } => {
                    Reason::Mishaps(wire::Mishaps { tasks, message })
                }
                WaitReason::ImageLost { frame } => Reason::ImageLost(frame),
                WaitReason::Quarantined { frame, tasks } => Reason::Quarantined(Tasks { frame, tasks }),
            }),
        }
    }
}

impl TryFrom<wire::Wait> for WaitReason {
    type Error = ConvertError;

    fn try_from(wire: wire::Wait) -> Result<Self, ConvertError> {
        Ok(match required("wait.reason", wire.reason)? {
            Reason::Paused(_) => Self::Paused,
            Reason::NoWorkers(_) => Self::NoWorkers,
            Reason::NoWorkerWithTags(Tags { tags }) => Self::NoWorkerWithTags(tags),
            Reason::WorkersBusy(workers) => Self::WorkersBusy { workers },
            Reason::WorkersDraining(workers) => Self::WorkersDraining { workers },
            Reason::WorkersResting(_) => Self::AllWorkersBackingOff,
            Reason::WorkersSilent(wire::Silent { workers, seconds }) => Self::WorkersSilent { workers, seconds },
            Reason::WorkersInTrouble(wire::Trouble { workers, seconds, failure }) => {
                let failure = required("wait.workers_in_trouble.failure", failure)?.try_into()?;
                Self::WorkersBackingOff { workers, seconds, failure }
            }
            Reason::WorkersQuarantined(wire::QuarantinedWorkers { workers, seconds }) => {
                Self::WorkersQuarantined { workers, seconds }
            }
            Reason::OtherBuild(frames) => Self::OtherBuild { frames },
            Reason::Regrouping(milliseconds) => Self::Regrouping { milliseconds },
            Reason::BehindJob(job) => Self::BehindJob(JobId(job)),
            Reason::WorkersAvoided(tasks) => Self::WorkersAvoided { tasks },
            Reason::StageWaits(wire::StageWaits { frame, stage, needs, tasks }) => {
                Self::StageWaits { frame, stage: kind(stage)?, needs: kind(needs)?, tasks }
            }
            Reason::SharedStage(wire::SharedStage { shared, stage, done, tasks, jobs }) => {
                Self::SharedStage { shared: JobId(shared), stage: kind(stage)?, done, tasks, jobs }
            }
            Reason::SharedQuarantined(wire::SharedQuarantined { shared, frames, tasks }) => {
                Self::SharedQuarantined { shared: JobId(shared), frames, tasks }
            }
            Reason::Mishaps(wire::Mishaps { tasks, message }) => Self::InfrastructureFailures { tasks, message },
            Reason::ImageLost(frame) => Self::ImageLost { frame },
            Reason::Quarantined(Tasks { frame, tasks }) => Self::Quarantined { frame, tasks },
        })
    }
}

impl From<Intake> for wire::Intake {
    fn from(intake: Intake) -> Self {
        match intake {
            Intake::Open => Self::Open,
            Intake::Off => Self::Off,
            Intake::Drained => Self::Drained,
        }
    }
}

/// Converts an [`Intake`].
/// - `field`: name of the field, for the error.
pub(super) fn parse_intake(field: &'static str, value: i32) -> Result<Intake, ConvertError> {
    let unknown = ConvertError::Unknown { field, value };
    match wire::Intake::try_from(value).map_err(|_| unknown.clone())? {
        wire::Intake::Unspecified => Err(unknown),
        wire::Intake::Open => Ok(Intake::Open),
        wire::Intake::Off => Ok(Intake::Off),
        wire::Intake::Drained => Ok(Intake::Drained),
    }
}

impl From<WorkerStatus> for wire::WorkerStatus {
    fn from(status: WorkerStatus) -> Self {
        let WorkerStatus { worker, name, threads, tags, tasks, silent, completed, failed, intake, engine } = status;
        let tasks = tasks.into_iter().map(Into::into).collect();
        let intake = wire::Intake::from(intake).into();
        Self { worker: worker.0, name, threads, tags, tasks, silent, completed, failed, intake, engine }
    }
}

impl TryFrom<wire::WorkerStatus> for WorkerStatus {
    type Error = ConvertError;

    fn try_from(wire: wire::WorkerStatus) -> Result<Self, ConvertError> {
        let wire::WorkerStatus { worker, name, threads, tags, tasks, silent, completed, failed, intake, engine } = wire;
        let intake = parse_intake("worker.intake", intake)?;
        let (worker, tasks) = (WorkerId(worker), convert_all(tasks)?);
        Ok(Self { worker, name, threads, tags, tasks, silent, completed, failed, intake, engine })
    }
}

impl From<OfflineWorker> for wire::OfflineWorker {
    fn from(OfflineWorker { name, threads, tags, engine, last_contact: heard }: OfflineWorker) -> Self {
        Self { name, threads, tags, engine, heard }
    }
}

impl TryFrom<wire::OfflineWorker> for OfflineWorker {
    type Error = ConvertError;

    fn try_from(wire: wire::OfflineWorker) -> Result<Self, ConvertError> {
        let wire::OfflineWorker { name, threads, tags, engine, heard } = wire;
        Ok(Self { name, threads, tags, engine, last_contact: heard })
    }
}

impl From<WorkerList> for wire::ListWorkersReply {
    fn from(WorkerList { connected: there, offline }: WorkerList) -> Self {
        let workers = there.into_iter().map(Into::into).collect();
        Self { workers, offline: offline.into_iter().map(Into::into).collect() }
    }
}

impl TryFrom<wire::ListWorkersReply> for WorkerList {
    type Error = ConvertError;

    fn try_from(wire::ListWorkersReply { workers, offline }: wire::ListWorkersReply) -> Result<Self, ConvertError> {
        Ok(Self { connected: convert_all(workers)?, offline: convert_all(offline)? })
    }
}

impl From<(WorkerSelector, Drain)> for wire::DrainWorkersRequest {
    fn from((worker, drain): (WorkerSelector, Drain)) -> Self {
        use wire::drain_workers_request::Worker;
        let worker = match worker {
            WorkerSelector::Number(WorkerId(number)) => Worker::Number(number),
            WorkerSelector::Name(name) => Worker::Name(name),
        };
        Self { worker: Some(worker), undo: drain == Drain::Undo }
    }
}

impl TryFrom<wire::DrainWorkersRequest> for (WorkerSelector, Drain) {
    type Error = ConvertError;

    fn try_from(wire: wire::DrainWorkersRequest) -> Result<Self, ConvertError> {
        use wire::drain_workers_request::Worker;
        let worker = match required("drain.worker", wire.worker)? {
            Worker::Number(number) => WorkerSelector::Number(WorkerId(number)),
            Worker::Name(name) => WorkerSelector::Name(name),
        };
        Ok((worker, if wire.undo { Drain::Undo } else { Drain::Begin }))
    }
}
