//! Messages of a measurement in several tasks: the readings of one task, and all readings of a frame.

use super::places::{Place, PlaceInfo};
use super::reading::{MeasureSettings, Reading, measure};
use super::request::{MAX_PLACES, MeasureRequest};
use super::rows::{ReadingRow, SummaryRow, reading_rows, summary_rows};
use super::summary::summarize;
use femc_prepared::Prepared;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// A place and its reading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The place.
    pub place: PlaceInfo,
    /// Its reading.
    pub reading: Reading,
}

/// Identity of the measurement of a frame: readings with equal identities are equal to the bit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeasurementId {
    /// Build of the engine.
    pub engine: String,
    /// Digest of the scene with its overrides, hexadecimal.
    pub scene: String,
    /// Digest of the request, the maximum path length and the seed, hexadecimal.
    pub request: String,
    /// Frame of the clip, from 1.
    pub frame: u32,
}

impl MeasurementId {
    /// Returns the identity.
    /// - `settings`: settings of the request's readings;
    /// - `engine`: build of the engine; `scene`: digest of the scene.
    pub fn new(
        request: &MeasureRequest,
        settings: &MeasureSettings,
        (engine, scene): (&str, String),
        frame: u32,
    ) -> Self {
        let bytes = postcard::to_stdvec(&(request, settings.max_depth, settings.seed));
        // Plain data is always encoded.
        let request = blake3::hash(&bytes.unwrap_or_default()).to_hex().to_string();
        Self { engine: engine.to_owned(), scene, request, frame }
    }
}

/// Reason why a message is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// The bytes are not such a message.
    #[error("damaged readings: {0}")]
    Corrupt(String),
    /// The message has another version.
    #[error("readings of format {found}; this version reads format {expected}")]
    Version {
        /// Version of the message.
        found: u32,
        /// Version that this program reads.
        expected: u32,
    },
    /// The message belongs to another measurement.
    #[error("readings of another {0}")]
    Other(&'static str),
}

fn corrupt(what: impl Into<String>) -> MessageError {
    MessageError::Corrupt(what.into())
}

/// Share of the readings that a task takes: reading `number` belongs to task `number % tasks`, so that places that need many samples
/// are spread over the tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReadingShare {
    /// Number of the task, from 0.
    pub task: u32,
    /// Number of tasks, at least 1.
    pub tasks: u32,
}

impl ReadingShare {
    /// Returns the numbers of the readings, ascending.
    /// - `total`: number of readings of the request.
    fn numbers(self, total: u32) -> impl Iterator<Item = u32> {
        (self.task..total).step_by(self.tasks.max(1) as usize)
    }
}

/// Magic number of blocks.
const BLOCK_MAGIC: &[u8; 4] = b"fmRB";
/// Version of blocks.
const BLOCK_VERSION: u32 = 1;

/// Readings of one task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReadingBlock {
    /// Identity of the measurement.
    pub id: MeasurementId,
    /// Share of the task.
    pub share: ReadingShare,
    /// Number of readings of all tasks.
    pub total: u32,
    /// Readings of the share, in order.
    pub measured: Vec<Measured>,
}

impl ReadingBlock {
    /// Measures the share of a task, on the calling thread's rayon pool. `None`: the measurement was cancelled.
    /// - `places`: all places of the request;
    /// - `progress`: counts the samples.
    pub fn measure(
        scene: &Prepared,
        places: &[Place],
        settings: &MeasureSettings,
        (id, share): (MeasurementId, ReadingShare),
        cancel: &AtomicBool,
        progress: &AtomicU64,
    ) -> Option<Self> {
        let total = places.len() as u32;
        let numbers: Vec<u32> = share.numbers(total).collect();
        let read = |&number: &u32| {
            let place = &places[number as usize];
            let reading = measure(scene, number, place, settings, cancel, progress)?;
            Some(Measured { place: place.info.clone(), reading })
        };
        let measured = numbers.par_iter().map(read).collect::<Option<Vec<Measured>>>()?;
        Some(Self { id, share, total, measured })
    }

    /// Encodes the block.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = BLOCK_MAGIC.to_vec();
        bytes.extend(BLOCK_VERSION.to_le_bytes());
        // Plain data is always encoded.
        bytes.extend(postcard::to_stdvec(self).unwrap_or_default());
        bytes
    }

    /// Decodes and checks a block.
    /// - errors: damage, or another version.
    pub fn decode(bytes: &[u8]) -> Result<Self, MessageError> {
        let rest = bytes.strip_prefix(BLOCK_MAGIC).ok_or_else(|| corrupt("not a block of readings"))?;
        let (version, rest) = rest.split_first_chunk::<4>().ok_or_else(|| corrupt("it has no version"))?;
        let found = u32::from_le_bytes(*version);
        if found != BLOCK_VERSION {
            return Err(MessageError::Version { found, expected: BLOCK_VERSION });
        }
        let (block, rest) = postcard::take_from_bytes::<Self>(rest).map_err(|error| corrupt(error.to_string()))?;
        if !rest.is_empty() {
            return Err(corrupt("more bytes than a block"));
        }
        let ReadingBlock { share, total, measured, .. } = &block;
        if share.task >= share.tasks || u64::from(*total) > MAX_PLACES {
            return Err(corrupt("the numbers of tasks or readings are out of range"));
        }
        if share.numbers(*total).count() != measured.len() {
            return Err(corrupt(format!("{} readings of a task that has others", measured.len())));
        }
        measured.iter().try_for_each(check)?;
        Ok(block)
    }
}

/// Maximum number of samples of a reading. Sums over all readings of a frame do not overflow.
pub(super) const MAX_COUNT: u64 = u32::MAX as u64;
/// Maximum number of rays of a reading: 4096 for each sample.
const MAX_RAYS: u64 = MAX_COUNT << 12;

/// Checks that the numbers of a reading are in their domains.
fn check(measured: &Measured) -> Result<(), MessageError> {
    let Measured { place, reading } = measured;
    let is_length = |value: &f64| value.is_finite() && *value >= 0.0;
    let values = [reading.value, reading.half_width].into_iter().chain(reading.color);
    let lamps = reading.lamps.iter().flat_map(|lamp| [lamp.value, lamp.half_width]);
    let is_sound = values.chain(lamps).all(|value| is_length(&value))
        && place.position.iter().all(|x| x.is_finite())
        && place.area.is_none_or(|area| area.is_finite() && area > 0.0)
        && [reading.samples, reading.bad_samples].iter().all(|count| *count <= MAX_COUNT)
        && reading.rays <= MAX_RAYS;
    if is_sound { Ok(()) } else { Err(corrupt(format!("reading {} of `{}`", place.number, place.part))) }
}

/// Joins the blocks of all tasks. Returns the readings in the order of the request.
/// - `blocks`: blocks in the order of the tasks;
/// - errors: a block of another measurement, frame or task, with its position.
pub fn join_blocks(id: &MeasurementId, blocks: Vec<ReadingBlock>) -> Result<Vec<Measured>, (usize, MessageError)> {
    let tasks = blocks.len();
    let Some(total) = blocks.first().map(|block| block.total) else {
        return Err((0, corrupt("no blocks")));
    };
    let mut parts = Vec::with_capacity(tasks);
    for (at, block) in blocks.into_iter().enumerate() {
        if block.id != *id {
            return Err((at, MessageError::Other("measurement or frame")));
        }
        if block.total != total || (block.share.task as usize, block.share.tasks as usize) != (at, tasks) {
            return Err((at, MessageError::Other("task")));
        }
        parts.push(block.measured.into_iter());
    }
    let next = |number: u32| parts[number as usize % tasks].next().ok_or((0, corrupt("a reading is missing")));
    (0..total).map(next).collect()
}

/// Version of the document of readings.
const READINGS_VERSION: u32 = 1;
/// Name of the document of readings.
const READINGS_FORMAT: &str = "femc readings";

/// All readings of a frame, as a document for users and programs (JSON).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameReadings {
    /// `femc readings`.
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Identity of the measurement.
    #[serde(flatten)]
    pub id: MeasurementId,
    /// Seed.
    pub seed: u64,
    /// Number of rays.
    pub rays: u64,
    /// Number of samples that were not finite and are left out.
    pub bad_samples: u64,
    /// Number of readings that did not reach the requested error.
    pub not_converged: u64,
    /// Readings; each is followed by its lamps, if these were requested.
    pub readings: Vec<ReadingRow>,
    /// Summaries of the parts that have several readings.
    pub summaries: Vec<SummaryRow>,
}

impl FrameReadings {
    /// Creates the document from all readings of a request, in order.
    pub fn new(id: MeasurementId, seed: u64, measured: &[Measured]) -> Self {
        let readings = || measured.iter().map(|it| &it.reading);
        Self {
            format: READINGS_FORMAT.to_owned(),
            version: READINGS_VERSION,
            id,
            seed,
            rays: readings().map(|reading| reading.rays).sum(),
            bad_samples: readings().map(|reading| reading.bad_samples).sum(),
            not_converged: readings().filter(|reading| !reading.is_converged).count() as u64,
            readings: reading_rows(measured),
            summaries: summary_rows(&summarize(measured)),
        }
    }

    /// Checks a document that was read.
    /// - errors: damage, or another version.
    pub fn check(&self) -> Result<(), MessageError> {
        if self.format != READINGS_FORMAT {
            return Err(corrupt(format!("the format is {:?}", self.format)));
        }
        if self.version != READINGS_VERSION {
            return Err(MessageError::Version { found: self.version, expected: READINGS_VERSION });
        }
        let mut parts: BTreeMap<&str, u64> = BTreeMap::new();
        for row in &self.readings {
            if !row.is_sound() {
                return Err(corrupt(format!("reading {} of `{}`", row.number, row.part)));
            }
            if row.lamp.is_none() {
                *parts.entry(&row.part).or_default() += 1;
            }
        }
        let whole = || self.readings.iter().filter(|row| row.lamp.is_none());
        let is_counted = whole().map(|row| row.bad_samples).sum::<u64>() == self.bad_samples
            && whole().filter(|row| !row.converged).count() as u64 == self.not_converged;
        if !is_counted {
            return Err(corrupt("the sums differ from the readings"));
        }
        let of_whole = self.summaries.iter().filter(|row| row.lamp.is_none());
        let mut summed: BTreeMap<&str, u64> = of_whole.map(|row| (row.part.as_str(), row.readings)).collect();
        if parts.iter().any(|(part, count)| *count > 1 && summed.remove(part) != Some(*count)) || !summed.is_empty() {
            return Err(corrupt("the summaries differ from the readings"));
        }
        Ok(())
    }
}

impl MeasureRequest {
    /// Returns the settings of the readings.
    pub fn settings(&self, max_depth: u32, seed: u64) -> MeasureSettings {
        MeasureSettings { stop: self.stop(), max_depth, seed, by_lamp: self.by_lamp }
    }

    /// Returns the number of tasks of a frame, at least 1. A task has about as many samples as a task of an image.
    pub fn tasks(&self) -> u32 {
        let readings = (TASK_SAMPLES / self.expected_samples()).max(1);
        self.count().div_ceil(readings).clamp(1, MAX_TASKS) as u32
    }

    /// Returns the number of samples that tasks are expected to take on average, at least 1.
    pub fn samples_per_task(&self) -> u64 {
        let samples = self.count().saturating_mul(self.expected_samples()) / u64::from(self.tasks());
        samples.clamp(1, u32::MAX.into())
    }
}

/// Number of samples of a task. A task of an image has a quarter of a million at most.
const TASK_SAMPLES: u64 = 1 << 18;
/// Maximum number of tasks of a frame.
const MAX_TASKS: u64 = 4096;
