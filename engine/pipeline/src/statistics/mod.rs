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

use crate::render::{RenderError, RenderedTile, render_rows};
use crate::replay::Replay;
use crate::settings::Settings;
use femc_film::Rect;
use femc_montecarlo::Recorder;
use femc_montecarlo::record::RecorderPair;
use femc_paths::{LightPath, LightStatistics, PortionKey, SampleCounters, Scope};
use femc_prepared::Prepared;
use names::SceneNames;
use recorded::{RecordedSamples, TopKeys};
use recorder::PathRecorder;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64};

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

/// Renders samples of a tile as [`render_tile`](crate::render_tile) does, to the bit, and returns their statistics.
pub fn render_with_statistics(
    prepared: &Prepared,
    settings: &Settings,
    plan: &StatisticsPlan,
    rect: Rect,
    samples: Range<u32>,
    cancel: &AtomicBool,
    progress: &AtomicU64,
) -> Result<(RenderedTile, LightStatistics), RenderError> {
    let outcome = render_with_statistics_and_recorder(prepared, settings, plan, rect, samples, cancel, progress, || ());
    outcome.map(|(rendered, statistics, _)| (rendered, statistics))
}

/// Renders samples with statistics and with recorders of another kind. Returns these in order, too.
pub(crate) fn render_with_statistics_and_recorder<R: Recorder + Send>(
    prepared: &Prepared,
    settings: &Settings,
    plan: &StatisticsPlan,
    rect: Rect,
    samples: Range<u32>,
    cancel: &AtomicBool,
    progress: &AtomicU64,
    other: impl Fn() -> R + Sync,
) -> Result<(RenderedTile, LightStatistics, Vec<R>), RenderError> {
    let names = SceneNames::new(prepared);
    let mut statistics = LightStatistics::new(plan.scope, plan.share(settings, &samples));
    // Samples that are traced again are counted already.
    let again = Scope { has_full_histograms: false, ..plan.scope };
    let recorder = || RecorderPair::new(PathRecorder::new(&names, statistics.threshold, plan.scope), other());
    let (rendered, heard) = render_rows(prepared, settings, rect, samples.clone(), cancel, progress, recorder)?;
    let mut all = RecordedSamples::new();
    let mut others = Vec::with_capacity(heard.len());
    for RecorderPair { first, second, .. } in heard {
        all.merge(first.recorded);
        others.push(second);
    }
    let corner = rect.y * plan.scope.film[0] + rect.x;
    let tile = plan.scope.tile_of(corner);
    for ((half, counters), pixels) in (0..).zip(all.counters).zip(all.pixels) {
        let portion = PortionKey { tile, half, begin: samples.start, end: samples.end };
        statistics.portions.insert(portion, SampleCounters { pixels, ..counters });
    }
    let order = |path: LightPath| ((path.key.hash(plan.scope.seed), path.key), path);
    statistics.paths.extend(all.paths.drain(..).map(order));
    // All samples that are traced again are recorded.
    let mut replay = Replay::with_recorder(prepared, settings, PathRecorder::new(&names, u64::MAX, again));
    let [bright, deep] = [all.bright, all.deep].map(TopKeys::keys);
    let width = plan.scope.film[0];
    for key in bright.iter().chain(&deep) {
        let _ = replay.sample((key.pixel % width, key.pixel / width), key.sample);
    }
    let again = replay.into_recorder().recorded;
    for path in again.paths {
        let (key, path) = order(path);
        if bright.contains(&path.key) {
            statistics.brightest.insert(key, path.clone());
        }
        if deep.contains(&path.key) {
            statistics.deepest.insert(key, path);
        }
    }
    // Settling the statistics drops names that no record uses.
    statistics.names = names.used_names();
    statistics.trim();
    Ok((rendered, statistics, others))
}
