//! Usage of attempts, and the shape of their job.

use std::num::NonZeroU64;

use femc_model::{
    AttemptRecord, AttemptTimes, ChunkSize, LeaseEnding, OwnerUsage, ResourceUsage, TaskUsage, Tick, UsageSums,
};

use super::task::{finite_seconds, from_lease, to_lease};
use super::{ConvertError, convert_optional, required};
use crate::{JobShape, wire};

impl From<JobShape> for wire::JobShape {
    fn from(JobShape { spec, chunk_size: cut }: JobShape) -> Self {
        let chunk = match cut {
            ChunkSize::Whole => None,
            ChunkSize::Units(units) => Some(units.get()),
        };
        Self { job: Some((*spec).into()), grain: chunk }
    }
}

impl TryFrom<wire::JobShape> for JobShape {
    type Error = ConvertError;

    fn try_from(wire: wire::JobShape) -> Result<Self, ConvertError> {
        let cut = match wire.grain.map(NonZeroU64::new) {
            None => ChunkSize::Whole,
            Some(units) => ChunkSize::Units(required("shape.grain", units)?),
        };
        Ok(Self { spec: Box::new(required("shape.job", wire.job)?.try_into()?), chunk_size: cut })
    }
}

impl From<OwnerUsage> for wire::OwnerUsage {
    fn from(OwnerUsage { month, owner, sums }: OwnerUsage) -> Self {
        let UsageSums { jobs, frames, tasks, samples, worker_ms, processor_us } = sums;
        Self {
            month: month.to_string(),
            owner,
            jobs,
            frames,
            tasks,
            samples,
            worker_seconds: worker_ms as f64 / 1e3,
            processor_seconds: processor_us as f64 / 1e6,
        }
    }
}

impl TryFrom<wire::OwnerUsage> for OwnerUsage {
    type Error = ConvertError;

    fn try_from(wire: wire::OwnerUsage) -> Result<Self, ConvertError> {
        let (worker, processor) = (finite_seconds(wire.worker_seconds)?, finite_seconds(wire.processor_seconds)?);
        Ok(Self {
            month: wire.month.parse().map_err(|_| ConvertError::Range { field: "usage.month" })?,
            owner: wire.owner,
            sums: UsageSums {
                jobs: wire.jobs,
                frames: wire.frames,
                tasks: wire.tasks,
                samples: wire.samples,
                worker_ms: (worker * 1e3).round() as u64,
                processor_us: (processor * 1e6).round() as u64,
            },
        })
    }
}

impl From<AttemptTimes> for wire::Times {
    fn from(AttemptTimes { attempts, processor, wall, waiting }: AttemptTimes) -> Self {
        Self { attempts, processor_seconds: processor, wall_seconds: wall, waiting_seconds: waiting }
    }
}

impl TryFrom<wire::Times> for AttemptTimes {
    type Error = ConvertError;

    fn try_from(wire: wire::Times) -> Result<Self, ConvertError> {
        let wire::Times { attempts, processor_seconds, wall_seconds, waiting_seconds } = wire;
        Ok(Self { attempts, processor: processor_seconds, wall: wall_seconds, waiting: waiting_seconds })
    }
}

impl From<ResourceUsage> for wire::Usage {
    fn from(usage: ResourceUsage) -> Self {
        let ResourceUsage { wait, wall, preparation, cpu, peak, samples, rays, fetched, sent } = usage;
        Self { wait, wall, preparation, cpu, peak, samples, rays, fetched, sent }
    }
}

impl TryFrom<wire::Usage> for ResourceUsage {
    type Error = ConvertError;

    fn try_from(wire: wire::Usage) -> Result<Self, ConvertError> {
        let wire::Usage { wait, wall, preparation, cpu, peak, samples, rays, fetched, sent } = wire;
        let [wait, wall, preparation, cpu] =
            [finite_seconds(wait)?, finite_seconds(wall)?, finite_seconds(preparation)?, finite_seconds(cpu)?];
        Ok(Self { wait, wall, preparation, cpu, peak, samples, rays, fetched, sent })
    }
}

impl From<TaskUsage> for wire::Spent {
    fn from(TaskUsage { task, epoch, usage }: TaskUsage) -> Self {
        Self { lease: to_lease(task, epoch), usage: Some(usage.into()) }
    }
}

impl TryFrom<wire::Spent> for TaskUsage {
    type Error = ConvertError;

    fn try_from(wire: wire::Spent) -> Result<Self, ConvertError> {
        let (task, epoch) = from_lease(wire.lease)?;
        Ok(Self { task, epoch, usage: required("spent.usage", wire.usage)?.try_into()? })
    }
}

impl From<LeaseEnding> for wire::Ending {
    fn from(ending: LeaseEnding) -> Self {
        match ending {
            LeaseEnding::Lost => Self::Lost,
            LeaseEnding::Revoked => Self::Revoked,
            LeaseEnding::Cancelled => Self::Cancelled,
            LeaseEnding::Failed => Self::Failed,
            LeaseEnding::Done => Self::Done,
        }
    }
}

fn ending(value: i32) -> Result<LeaseEnding, ConvertError> {
    let unknown = ConvertError::Unknown { field: "attempt.ending", value };
    Ok(match wire::Ending::try_from(value).map_err(|_| unknown.clone())? {
        wire::Ending::Unspecified => return Err(unknown),
        wire::Ending::Lost => LeaseEnding::Lost,
        wire::Ending::Revoked => LeaseEnding::Revoked,
        wire::Ending::Cancelled => LeaseEnding::Cancelled,
        wire::Ending::Failed => LeaseEnding::Failed,
        wire::Ending::Done => LeaseEnding::Done,
    })
}

impl From<AttemptRecord> for wire::AttemptRecord {
    fn from(record: AttemptRecord) -> Self {
        let AttemptRecord { task, epoch, worker, instance, granted, ended, ending, samples, relative_error, usage } =
            record;
        Self {
            lease: to_lease(task, epoch),
            worker,
            instance,
            granted: granted.0,
            ended: ended.0,
            ending: wire::Ending::from(ending).into(),
            samples,
            relative_error,
            usage: usage.map(Into::into),
        }
    }
}

impl TryFrom<wire::AttemptRecord> for AttemptRecord {
    type Error = ConvertError;

    fn try_from(wire: wire::AttemptRecord) -> Result<Self, ConvertError> {
        let (task, epoch) = from_lease(wire.lease)?;
        Ok(Self {
            task,
            epoch,
            worker: wire.worker,
            instance: wire.instance,
            granted: Tick(wire.granted),
            ended: Tick(wire.ended),
            ending: ending(wire.ending)?,
            samples: wire.samples,
            relative_error: wire.relative_error,
            usage: convert_optional(wire.usage)?,
        })
    }
}
