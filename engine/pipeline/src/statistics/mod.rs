//! Light statistics of the samples that a task renders.
//!
//! Every sample is counted; the few that are chosen by their hash are recorded whole while they are rendered. The brightest and the deepest
//! are known only when all are done: they are traced again then, as any sample can be.
//!
//! What is chosen is a function of the settings: of all samples that a frame may have at the end of a round about as many records as it keeps,
//! but no more than one sample in 256, so that recording takes no more than some hundredths of the time, nor fewer than 5,000, which
//! take a twentieth of a second. A task of a later round keeps a smaller share, and the least share holds for the frame.

mod heard;
mod names;
mod recorder;

use crate::render::{RenderError, RenderedTile, render_rows};
use crate::replay::Replay;
use crate::settings::Settings;
use femc_film::Rect;
use femc_montecarlo::Recorder;
use femc_montecarlo::record::Both;
use femc_paths::{Counters, Path, PortionKey, Scope, Statistics};
use femc_prepared::Prepared;
use heard::{Heard, Tops};
use names::SceneNames;
use recorder::PathRecorder;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Records that a frame keeps: 16 for each of the 5,000 of a representative set.
const KEEP: u32 = 16 * 5000;
/// Records of each sketch for each half of a tile.
const TOP: u32 = 16;
/// Most records that are chosen, as a share of all samples: to record a path, to pack it and to unite it takes as long as to trace five
/// ordinary ones of a cheap scene.
const MOST: f64 = 1.0 / 256.0;
/// Records that are chosen in any case: as many as one representative set has.
const LEAST: f64 = 5000.0;

/// What a frame's statistics are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatisticsPlan {
    /// What they are of.
    pub scope: Scope,
}

impl StatisticsPlan {
    /// Of a frame.
    /// - `edge`: width and height of its tiles, pixels.
    pub fn of(prepared: &Prepared, settings: &Settings, edge: u32) -> Self {
        let bounds = prepared.world.bounds();
        let (lower, upper) = rounded(prepared.in_world(bounds.min), prepared.in_world(bounds.max));
        let (film, frame) = (prepared.camera.film, prepared.frame);
        let (seed, is_full) = (settings.seed, settings.full_statistics);
        Self { scope: Scope { seed, frame, film, edge, lower, upper, keep: KEEP, top: TOP, is_full } }
    }

    /// Share of the samples whose paths are recorded by a task.
    fn share(&self, settings: &Settings, samples: &Range<u32>) -> f64 {
        let rounds = settings.rounds();
        let end = rounds.into_iter().find(|end| *end >= samples.end).unwrap_or(samples.end);
        let [width, height] = self.scope.film.map(f64::from);
        let all = width * height * f64::from(end.max(1));
        (f64::from(self.scope.keep) / all).min(MOST).max(LEAST / all)
    }
}

/// A box made larger to a multiple of a sixteenth of its size, rounded to a power of two: the same for worlds that differ a little.
fn rounded(lower: [f64; 3], upper: [f64; 3]) -> ([f64; 3], [f64; 3]) {
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

/// Renders samples of a tile as [`render_tile`](crate::render_tile) does, to the bit, and says what is known of them.
pub fn render_with_statistics(
    prepared: &Prepared,
    settings: &Settings,
    plan: &StatisticsPlan,
    rect: Rect,
    samples: Range<u32>,
    cancel: &AtomicBool,
    progress: &AtomicU64,
) -> Result<(RenderedTile, Statistics), RenderError> {
    let outcome = render_with_statistics_and(prepared, settings, plan, rect, samples, cancel, progress, || ());
    outcome.map(|(rendered, statistics, _)| (rendered, statistics))
}

/// The same beside recorders of another kind; returns these in order, too.
pub(crate) fn render_with_statistics_and<R: Recorder + Send>(
    prepared: &Prepared,
    settings: &Settings,
    plan: &StatisticsPlan,
    rect: Rect,
    samples: Range<u32>,
    cancel: &AtomicBool,
    progress: &AtomicU64,
    other: impl Fn() -> R + Sync,
) -> Result<(RenderedTile, Statistics, Vec<R>), RenderError> {
    let names = SceneNames::new(prepared);
    let mut statistics = Statistics::new(plan.scope, plan.share(settings, &samples));
    // What is traced again is counted already.
    let again = Scope { is_full: false, ..plan.scope };
    let recorder = || Both::new(PathRecorder::new(&names, statistics.threshold, plan.scope), other());
    let (rendered, heard) = render_rows(prepared, settings, rect, samples.clone(), cancel, progress, recorder)?;
    let mut all = Heard::new();
    let mut others = Vec::with_capacity(heard.len());
    for Both { first, second, .. } in heard {
        all.merge(first.heard);
        others.push(second);
    }
    let corner = rect.y * plan.scope.film[0] + rect.x;
    let tile = plan.scope.tile_of(corner);
    for ((half, counters), pixels) in (0..).zip(all.counters).zip(all.pixels) {
        let portion = PortionKey { tile, half, begin: samples.start, end: samples.end };
        statistics.portions.insert(portion, Counters { pixels, ..counters });
    }
    let order = |path: Path| ((path.key.hash(plan.scope.seed), path.key), path);
    statistics.paths.extend(all.paths.drain(..).map(order));
    // Everything is wanted of what is traced again.
    let mut replay = Replay::recording(prepared, settings, PathRecorder::new(&names, u64::MAX, again));
    let [bright, deep] = [all.bright, all.deep].map(Tops::keys);
    let width = plan.scope.film[0];
    for key in bright.iter().chain(&deep) {
        let _ = replay.sample((key.pixel % width, key.pixel / width), key.sample);
    }
    let again = replay.into_recorder().heard;
    for path in again.paths {
        let (key, path) = order(path);
        if bright.contains(&path.key) {
            statistics.brightest.insert(key, path.clone());
        }
        if deep.contains(&path.key) {
            statistics.deepest.insert(key, path);
        }
    }
    // Those that no record has go when the statistics settle.
    statistics.names = names.texts();
    statistics.settle();
    Ok((rendered, statistics, others))
}
