//! Durations of tasks: drawn by the seed, with bounds that the audit knows.

use std::num::NonZeroU64;
use std::time::Duration;

use femc_model::{Assignment, JobSpec};

use crate::tasks::{chunk_steps, is_rendering};
use crate::test_jobs;

/// Durations of the tasks of one world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TaskDurations {
    seed: u64,
    /// Tiles are cut into sample chunks of one sample per pixel.
    is_chunked: bool,
}

/// Jobs whose tasks all have one size and one pace. The name of the owner says which.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum JobPace {
    /// Milliseconds for each task.
    Quick,
    /// Seconds for each task, more than may wait at a worker beside another one.
    Slow,
}

impl JobPace {
    /// Owner of the jobs of this tempo.
    pub(crate) const fn owner(self) -> &'static str {
        match self {
            Self::Quick => "quick",
            Self::Slow => "slow",
        }
    }

    fn from_job(spec: &JobSpec) -> Option<Self> {
        [Self::Quick, Self::Slow].into_iter().find(|tempo| tempo.owner() == spec.owner)
    }

    /// Shortest and longest task, in milliseconds.
    const fn duration_range(self) -> [u64; 2] {
        match self {
            Self::Quick => [4, 12],
            Self::Slow => [2_200, 3_400],
        }
    }
}

impl TaskDurations {
    /// Shortest and longest task that joins, in milliseconds.
    const JOIN: [u64; 2] = [200, 1_000];
    /// Shortest and longest sample of a tile that is cut.
    const SAMPLE: [u64; 2] = [50, 500];
    /// Shortest and longest task of a tile that is not cut, whatever its size.
    const TILE: [u64; 2] = [200, 3_000];

    /// - `chunk`: pixel samples of a sample chunk, from the farm's settings.
    pub(crate) fn new(seed: u64, chunk: NonZeroU64) -> Self {
        Self { seed, is_chunked: chunk == test_jobs::chunked_config().chunk_size }
    }

    /// Duration of a lease.
    pub(crate) fn duration(&self, lease: &Assignment, spec: Option<&JobSpec>) -> Duration {
        let draw = draw_16_bits(&format!("{} {} {}", self.seed, lease.task, lease.epoch.0));
        let between = |[least, most]: [u64; 2]| Duration::from_millis(least + draw * (most - least) / 65_536);
        match spec.and_then(JobPace::from_job) {
            _ if !is_rendering(lease) => between(Self::JOIN),
            Some(tempo) => between(tempo.duration_range()),
            None if self.is_chunked => between(Self::SAMPLE) * chunk_steps(lease),
            None => between(Self::TILE),
        }
    }

    /// Least time that a lease takes by the pace of the fastest tasks of its own stage, in milliseconds. Tiles of different sizes
    /// that all take equally long have no pace: 0.
    pub(crate) fn min_duration(&self, lease: &Assignment, spec: &JobSpec) -> u64 {
        match JobPace::from_job(spec) {
            _ if !is_rendering(lease) => Self::JOIN[0],
            Some(tempo) => tempo.duration_range()[0],
            None if self.is_chunked => {
                let stage = spec.graph.stage(lease.task.stage.number);
                let pixels = stage.map_or(0, |stage| stage.sizes.units(lease.spec.item));
                let largest = u64::from(spec.grid.tile).pow(2).max(1);
                Self::SAMPLE[0] * u64::from(chunk_steps(lease)) * pixels / largest
            }
            None => 0,
        }
    }
}

/// A number below 65536.
pub(crate) fn draw_16_bits(name: &str) -> u64 {
    let hash = blake3::hash(name.as_bytes());
    u64::from(u16::from_le_bytes([hash.as_bytes()[0], hash.as_bytes()[1]]))
}
