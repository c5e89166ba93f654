//! Usage of attempts, and the shape of their job.

use std::num::NonZeroU64;

use femc_model::{AttemptRecord, Cut, Ending, OwnerUsage, TaskUsage, Tick, Times, Usage, UsageSums};

use super::task::{finite, from_lease, to_lease};
use super::{ConvertError, maybe, need};
use crate::{JobShape, wire};

impl From<JobShape> for wire::JobShape {
    fn from(JobShape { spec, cut }: JobShape) -> Self {
        let grain = match cut {
            Cut::Whole => None,
            Cut::Grains(units) => Some(units.get()),
        };
        Self { job: Some((*spec).into()), grain }
    }
}

impl TryFrom<wire::JobShape> for JobShape {
    type Error = ConvertError;

    fn try_from(wire: wire::JobShape) -> Result<Self, ConvertError> {
        let cut = match wire.grain.map(NonZeroU64::new) {
            None => Cut::Whole,
            Some(units) => Cut::Grains(need("shape.grain", units)?),
        };
        Ok(Self { spec: Box::new(need("shape.job", wire.job)?.try_into()?), cut })
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
        let (worker, processor) = (finite(wire.worker_seconds)?, finite(wire.processor_seconds)?);
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

impl From<Times> for wire::Times {
    fn from(Times { attempts, processor, wall, waiting }: Times) -> Self {
        Self { attempts, processor_seconds: processor, wall_seconds: wall, waiting_seconds: waiting }
    }
}

impl TryFrom<wire::Times> for Times {
    type Error = ConvertError;

    fn try_from(wire: wire::Times) -> Result<Self, ConvertError> {
        let wire::Times { attempts, processor_seconds, wall_seconds, waiting_seconds } = wire;
        Ok(Self { attempts, processor: processor_seconds, wall: wall_seconds, waiting: waiting_seconds })
    }
}

impl From<Usage> for wire::Usage {
    fn from(usage: Usage) -> Self {
        let Usage { wait, wall, preparation, cpu, peak, samples, rays, fetched, sent } = usage;
        Self { wait, wall, preparation, cpu, peak, samples, rays, fetched, sent }
    }
}

impl TryFrom<wire::Usage> for Usage {
    type Error = ConvertError;

    fn try_from(wire: wire::Usage) -> Result<Self, ConvertError> {
        let wire::Usage { wait, wall, preparation, cpu, peak, samples, rays, fetched, sent } = wire;
        let [wait, wall, preparation, cpu] = [finite(wait)?, finite(wall)?, finite(preparation)?, finite(cpu)?];
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
        Ok(Self { task, epoch, usage: need("spent.usage", wire.usage)?.try_into()? })
    }
}

impl From<Ending> for wire::Ending {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Lost => Self::Lost,
            Ending::Revoked => Self::Revoked,
            Ending::Cancelled => Self::Cancelled,
            Ending::Failed => Self::Failed,
            Ending::Done => Self::Done,
        }
    }
}

fn ending(value: i32) -> Result<Ending, ConvertError> {
    let unknown = ConvertError::Unknown { field: "attempt.ending", value };
    Ok(match wire::Ending::try_from(value).map_err(|_| unknown.clone())? {
        wire::Ending::Unspecified => return Err(unknown),
        wire::Ending::Lost => Ending::Lost,
        wire::Ending::Revoked => Ending::Revoked,
        wire::Ending::Cancelled => Ending::Cancelled,
        wire::Ending::Failed => Ending::Failed,
        wire::Ending::Done => Ending::Done,
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
            usage: maybe(wire.usage)?,
        })
    }
}
