//! Light statistics of the samples that a task renders.
//!
//! Every sample is counted. The few that are chosen by their hash are fully recorded while they are rendered. The brightest and the
//! deepest are known only at the end. They are then traced again, as any sample can be.
//!
//! The choice is a function of the settings. The target is about as many records as a frame keeps, of all samples that the frame
//! may have at the end of a round. There is an upper limit of one sample in 256, so that recording takes no more than a few percent
//! of the time, and a lower limit of 5,000 records, which take a twentieth of a second. A task of a later round keeps a smaller
//! share. The least share applies to the frame.

mod names;
mod recorded;
mod recorder;

use crate::render::RenderTask;
use crate::replay::Replay;
use crate::settings::Settings;
use femc_paths::{LightPath, LightStatistics, PathKey, PortionKey, SampleCounters, Scope};
use femc_prepared::Prepared;
use names::SceneNames;
use recorded::{RecordedSamples, TopKeys};
use recorder::PathRecorder;
use std::ops::Range;

/// Number of records that a frame keeps: 16 for each of the 5,000 of a representative set.
const RECORDS_PER_FRAME: u32 = 16 * 5000;
/// Number of records of each sketch for each half of a tile.
const TOP_RECORDS: u32 = 16;
/// Maximum share of records in all samples. Recording, packing and uniting a path takes as long as tracing five ordinary ones of a
/// cheap scene.
const MAX_RECORDED_SHARE: f64 = 1.0 / 256.0;
/// Minimum number of records, equal to the size of one representative set.
const MIN_RECORDS: f64 = 5000.0;

/// Configuration of a frame's statistics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatisticsPlan {
    /// Frame and settings of the statistics.
    pub scope: Scope,
}

impl StatisticsPlan {
    /// Creates the configuration for a frame.
    /// - `edge`: width and height of its tiles, pixels.
    pub fn new(prepared: &Prepared, settings: &Settings, edge: u32) -> Self {
        let bounds = prepared.world.bounds();
        let (lower, upper) = snap_bounds(prepared.to_world(bounds.min), prepared.to_world(bounds.max));
        let (film, frame) = (prepared.camera.film, prepared.frame);
        let (seed, is_full) = (settings.seed, settings.full_statistics);
        Self {
            scope: Scope {
                seed,
                frame,
                film,
                tile_size: edge,
                lower,
                upper,
                max_records: RECORDS_PER_FRAME,
                sketch_size: TOP_RECORDS,
                has_full_histograms: is_full,
            },
        }
    }

    /// Returns the share of the samples whose paths a task records.
    fn share(&self, settings: &Settings, samples: &Range<u32>) -> f64 {
        let rounds = settings.rounds();
        let end = rounds.into_iter().find(|end| *end >= samples.end).unwrap_or(samples.end);
        let [width, height] = self.scope.film.map(f64::from);
        let all = width * height * f64::from(end.max(1));
        (f64::from(self.scope.max_records) / all).min(MAX_RECORDED_SHARE).max(MIN_RECORDS / all)
    }
}

/// Enlarges a box to multiples of a power of two that is a sixteenth to an eighth of its size, so that worlds with small
/// differences get the same box.
fn snap_bounds(lower: [f64; 3], upper: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let size = (0..3).map(|axis| upper[axis] - lower[axis]).fold(0.0, f64::max);
    if !size.is_finite() || size <= 0.0 {
        return ([0.0; 3], [1.0; 3]);
    }
    let mut step = 1.0f64;
    while step * 16.0 < size {
        step *= 2.0;
    }
    while step * 8.0 >= size {
        step /= 2.0;
    }
    (lower.map(|x| (x / step).floor() * step), upper.map(|x| (x / step).ceil() * step))
}

/// Recording of the statistics of a task.
pub(crate) struct StatisticsRecording<'a> {
    task: &'a RenderTask<'a>,
    plan: &'a StatisticsPlan,
    names: SceneNames<'a>,
    statistics: LightStatistics,
}

impl<'a> StatisticsRecording<'a> {
    /// Begins a recording without samples.
    pub(crate) fn new(task: &'a RenderTask<'a>, plan: &'a StatisticsPlan) -> Self {
        let statistics = LightStatistics::new(plan.scope, plan.share(task.settings, &task.samples));
        Self { task, plan, names: SceneNames::new(task.prepared), statistics }
    }

    /// Creates a recorder for some samples of the task.
    pub(crate) fn recorder(&self) -> PathRecorder<'_> {
        PathRecorder::new(&self.names, self.statistics.threshold, self.plan.scope)
    }

    /// Returns the statistics of the task, from the data of its recorders in order.
    pub(crate) fn finish(mut self, recorded: Vec<RecordedSamples>) -> LightStatistics {
        let (task, scope) = (self.task, self.plan.scope);
        let mut all = RecordedSamples::new();
        recorded.into_iter().for_each(|part| all.merge(part));
        let corner = task.rect.y * scope.film[0] + task.rect.x;
        let tile = scope.tile_of(corner);
        for ((half, counters), pixels) in (0..).zip(all.counters).zip(all.pixels) {
            let portion = PortionKey { tile, half, begin: task.samples.start, end: task.samples.end };
            self.statistics.portions.insert(portion, SampleCounters { pixels, ..counters });
        }
        let order = |path: LightPath| ((path.key.hash(scope.seed), path.key), path);
        self.statistics.paths.extend(all.paths.drain(..).map(order));
        let [bright, deep] = [all.bright, all.deep].map(TopKeys::keys);
        for path in self.trace_again(bright.iter().chain(&deep)) {
            let (key, path) = order(path);
            if bright.contains(&path.key) {
                self.statistics.brightest.insert(key, path.clone());
            }
            if deep.contains(&path.key) {
                self.statistics.deepest.insert(key, path);
            }
        }
        // Settling the statistics drops names that no record uses.
        self.statistics.names = self.names.used_names();
        self.statistics.trim();
        self.statistics
    }

    /// Traces samples again, and returns their paths. The samples are counted already.
    fn trace_again<'k>(&self, keys: impl Iterator<Item = &'k PathKey>) -> Vec<LightPath> {
        let scope = Scope { has_full_histograms: false, ..self.plan.scope };
        let recorder = PathRecorder::new(&self.names, u64::MAX, scope);
        let mut replay = Replay::with_recorder(self.task.prepared, self.task.settings, recorder);
        let width = scope.film[0];
        for key in keys {
            let _ = replay.sample((key.pixel % width, key.pixel / width), key.sample);
        }
        replay.into_recorder().recorded.paths
    }
}
