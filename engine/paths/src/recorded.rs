//! Recorded paths of frames in one list: numbers, weights, bins, and a representative set of any part of them.
//!
//! Paths are numbered from 0 in the order of the frames, and in each frame in the order of their hashes. This is the order of
//! `femc paths`. Intersections and lights are numbered from 0 in the order of their paths.

mod bins;
mod categories;

pub use bins::{CountedSamples, HistogramRequest, PairKey, RecordHistograms, Weighting};
pub use categories::{Categories, MAX_CATEGORIES, NameTable, OTHERS_BIN};

use crate::FrameStatistics;
use crate::attribute::path_bins;
use crate::histogram::{Counts, Histograms, Table};
use crate::octree::{Root, Voxel};
use crate::record::{LightPath, Names, PathKey};
use crate::represent::{Distance, PathBins, Target, choose_representative_within};
use crate::selection::{BitMask, CancelCheck, Cancelled, SelectedRecords, check_cancelled};
use crate::statistics::{LightStatistics, Scope};
use bins::RecordBins;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// Number of candidates for each path of a representative set.
const CANDIDATES_PER_PATH: usize = 8;

/// Maximum number of brightest samples.
pub const MAX_BRIGHTEST: usize = 20_000;

/// A box, world, m: lower and upper corner.
pub type Bounds = [[f64; 3]; 2];

/// A frame of recorded paths.
#[derive(Clone, Debug)]
pub struct RecordedFrame {
    /// Frame and settings.
    pub scope: Scope,
    /// Texts of the names in its records.
    pub names: Names,
    /// Number of its samples, including bad ones.
    pub samples: u64,
    /// Number of its bad samples.
    pub bad_samples: u64,
    /// Numbers of its paths.
    pub paths: Range<u32>,
}

/// Recorded paths of frames.
#[derive(Clone, Debug)]
pub struct RecordedPaths {
    frames: Vec<RecordedFrame>,
    share: f64,
    paths: Vec<LightPath>,
    /// Parts of the image, in units of 2^-32 of a pixel, by path.
    weights: Vec<u64>,
    /// Numbers of the first intersection and the first light of each path, and of one past the last path.
    firsts: Vec<[u32; 2]>,
    /// Numbers of the paths in order of hash and key.
    by_hash: Vec<u32>,
    /// Brightest samples with the indices of their frames, brightest first.
    brightest: Vec<(u32, LightPath)>,
    names: NameTable,
    categories: Vec<Categories>,
    path_bins: Vec<PathBins>,
    bins: RecordBins,
    /// Histograms of single attributes over all samples, by table, if all frames have them.
    full: Option<[Vec<Counts>; 3]>,
    /// Approximate size in memory, bytes.
    memory_bytes: usize,
}

/// Paths that represent others.
#[derive(Clone, Debug, PartialEq)]
pub struct RepresentativePaths {
    /// Their numbers, ascending.
    pub numbers: Vec<u32>,
    /// Weights that make all attributes match. Their sum is the number of these paths.
    pub weights: Vec<f64>,
    /// Number of the paths that they represent.
    pub represented: usize,
    /// Distance from the represented paths.
    pub distance: Distance,
    /// Effective number of equal weights.
    pub effective_size: f64,
}

impl RepresentativePaths {
    /// Chooses paths whose histograms are near the histograms of all given paths. Returns all of these if there are no more than
    /// `count`. The candidates are the paths with the smallest hashes.
    /// - `bins`: bins of paths, by number;
    /// - `by_hash`: numbers of the paths to represent, in order of their hashes.
    pub fn choose(bins: &[PathBins], by_hash: &[u32], count: usize) -> Self {
        let running = AtomicBool::new(false);
        let found = Self::choose_within(bins, by_hash, count, &mut CancelCheck::new(&running));
        found.expect("the flag is never set")
    }

    /// Like [`Self::choose`], with a cancel flag.
    fn choose_within(
        bins: &[PathBins],
        by_hash: &[u32],
        count: usize,
        check: &mut CancelCheck<'_>,
    ) -> Result<Self, Cancelled> {
        let bins_of = |number: &u32| &bins[*number as usize];
        let target = Target::from_paths(by_hash.iter().map(bins_of));
        let candidates = &by_hash[..by_hash.len().min(count.saturating_mul(CANDIDATES_PER_PATH))];
        let own: Vec<PathBins> = candidates.iter().map(|number| *bins_of(number)).collect();
        let found = choose_representative_within(&own, &target, count, check)?;
        let chosen = found.chosen.iter().map(|place| candidates[*place as usize]);
        let mut ordered: Vec<(u32, f64)> = chosen.zip(found.weights).collect();
        ordered.sort_unstable_by_key(|(number, _)| *number);
        let (numbers, weights) = ordered.into_iter().unzip();
        let (distance, effective_size) = (found.distance, found.effective_size);
        Ok(Self { numbers, weights, represented: by_hash.len(), distance, effective_size })
    }
}

impl RecordedPaths {
    /// Collects the recorded paths of united frames.
    pub fn new(frames: FrameStatistics) -> Self {
        let frames = frames.into_frames();
        let share = frames.first().map_or(1.0, LightStatistics::share);
        let full = total_histograms(&frames);
        let names = NameTable::new(frames.iter().map(|it| &it.names));
        let (mut infos, mut paths, mut weights, mut hashes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut brightest: Vec<(u32, LightPath)> = Vec::new();
        for (index, mut frame) in (0u32..).zip(frames) {
            brightest.extend(frame.fireflies().into_iter().map(|path| (index, path.clone())));
            let first = paths.len() as u32;
            for (key, path) in std::mem::take(&mut frame.paths) {
                weights.push(frame.image_weight(path.key));
                hashes.push(key);
                paths.push(path);
            }
            infos.push(RecordedFrame {
                scope: frame.scope,
                samples: frame.samples(),
                bad_samples: frame.totals().invalid,
                names: std::mem::take(&mut frame.names),
                paths: first..paths.len() as u32,
            });
        }
        // Copies lie in memory in the order in which they are read. That makes selections a third faster.
        let paths: Vec<LightPath> = paths.iter().map(LightPath::clone).collect();
        brightest.sort_by(|(_, a), (_, b)| b.luminance().total_cmp(&a.luminance()));
        brightest.truncate(MAX_BRIGHTEST);
        let mut by_hash: Vec<u32> = (0..paths.len() as u32).collect();
        by_hash.sort_unstable_by_key(|number| (hashes[*number as usize], *number));
        let mut next = [0u32; 2];
        let mut firsts = vec![next];
        for path in &paths {
            next = [next[0] + path.intersections.len() as u32, next[1] + path.lights.len() as u32];
            firsts.push(next);
        }
        let categories = categories::choose_categories(&names, &paths);
        let scopes = infos.iter().flat_map(|it| it.paths.clone().map(|_| &it.scope));
        let path_bins: Vec<PathBins> = scopes.zip(&paths).map(|(scope, path)| path_bins(scope, path)).collect();
        let bins = RecordBins::new(&infos, &paths, &path_bins, |axis, name| categories[axis].bin(names.number(name)));
        let mut all = Self {
            frames: infos,
            share,
            paths,
            weights,
            firsts,
            by_hash,
            brightest,
            names,
            categories,
            path_bins,
            bins,
            full,
            memory_bytes: 0,
        };
        all.memory_bytes = all.count_memory();
        all
    }

    /// Returns the frames in order of seed and number.
    pub fn frames(&self) -> &[RecordedFrame] {
        &self.frames
    }

    /// Returns the share of samples whose paths are recorded.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Returns the paths in order of their numbers.
    pub fn paths(&self) -> &[LightPath] {
        &self.paths
    }

    /// Returns the parts of the image that the paths are, in units of 2^-32 of a pixel, in order of their numbers.
    pub fn image_weights(&self) -> &[u64] {
        &self.weights
    }

    /// Returns the brightest samples of all samples, at most [`MAX_BRIGHTEST`], with the indices of their frames, brightest first.
    pub fn brightest(&self) -> &[(u32, LightPath)] {
        &self.brightest
    }

    /// Returns the names of all frames.
    pub fn names(&self) -> &NameTable {
        &self.names
    }

    /// Returns the categories of the attributes that are names.
    pub fn categories(&self) -> &[Categories] {
        &self.categories
    }

    /// Returns the numbers of paths, intersections and lights.
    pub fn totals(&self) -> [u32; 3] {
        let [intersections, lights] = self.firsts.last().copied().unwrap_or_default();
        [self.paths.len() as u32, intersections, lights]
    }

    /// Returns the numbers of a path's intersections.
    pub fn intersections_of(&self, path: u32) -> Range<u32> {
        self.items_of(path, 0)
    }

    /// Returns the numbers of a path's lights.
    pub fn lights_of(&self, path: u32) -> Range<u32> {
        self.items_of(path, 1)
    }

    fn items_of(&self, path: u32, kind: usize) -> Range<u32> {
        let at = path as usize;
        self.firsts[at][kind]..self.firsts[at + 1][kind]
    }

    /// Returns the index of the frame of a path.
    pub fn frame_of(&self, path: u32) -> usize {
        self.frames.partition_point(|frame| frame.paths.end <= path)
    }

    /// Returns the box of all frames.
    pub fn bounds(&self) -> Bounds {
        // United frames have one box.
        self.frames.first().map_or([[0.0; 3]; 2], |frame| [frame.scope.lower, frame.scope.upper])
    }

    /// Checks whether the histograms of single attributes over all samples are known.
    pub fn has_full_histograms(&self) -> bool {
        self.full.is_some()
    }

    /// Returns the numbers of the recorded paths of samples, by index of the frame and key.
    pub fn numbers_of(&self, samples: impl IntoIterator<Item = (u32, PathKey)>) -> Vec<Option<u32>> {
        let wanted: Vec<(u32, PathKey)> = samples.into_iter().collect();
        let mut found: HashMap<(u32, PathKey), Option<u32>> = wanted.iter().map(|it| (*it, None)).collect();
        for (index, frame) in (0u32..).zip(&self.frames) {
            for number in frame.paths.clone() {
                if let Some(own) = found.get_mut(&(index, self.paths[number as usize].key)) {
                    *own = Some(number);
                }
            }
        }
        wanted.iter().map(|it| found[it]).collect()
    }

    /// Chooses [`RepresentativePaths`] of the selected paths.
    /// - `selected`: the paths to represent; `None`: all.
    pub fn choose_representatives(
        &self,
        selected: Option<&BitMask>,
        bounds: Option<Bounds>,
        count: usize,
        is_cancelled: &AtomicBool,
    ) -> Result<RepresentativePaths, Cancelled> {
        let mut check = CancelCheck::new(is_cancelled);
        check.look()?;
        let bins = self.path_bins_within(bounds);
        let is_selected = |number: &u32| selected.is_none_or(|mask| mask.contains(*number));
        let by_hash: Vec<u32> = self.by_hash.iter().copied().filter(is_selected).collect();
        RepresentativePaths::choose_within(&bins, &by_hash, count, &mut check)
    }

    /// Returns the voxels of the finest level of a cube that have selected intersections, with their codes, ascending.
    /// - `selected`: `None`: all intersections;
    /// - `bounce`: `None`: all bounces.
    pub fn voxels(
        &self,
        root: Root,
        selected: Option<&SelectedRecords>,
        bounce: Option<u32>,
        is_cancelled: &AtomicBool,
    ) -> Result<Vec<(u64, Voxel)>, Cancelled> {
        let mut all: Vec<(u64, Voxel)> = Vec::new();
        for number in 0..self.paths.len() as u32 {
            check_cancelled(number, is_cancelled)?;
            for (own, it) in self.intersections_of(number).zip(&self.paths[number as usize].intersections) {
                let is_wanted = bounce.is_none_or(|bounce| it.bounce == bounce)
                    && selected.is_none_or(|selected| selected.intersections.contains(own));
                all.extend(Some(it).filter(|_| is_wanted).and_then(|it| root.voxel_of(it)));
            }
        }
        // Sums are integers, so the order of equal codes does not matter.
        all.sort_unstable_by_key(|(code, _)| *code);
        all.dedup_by(|(code, voxel), (first, sum)| {
            let is_same = code == first;
            if is_same {
                sum.merge(*voxel);
            }
            is_same
        });
        Ok(all)
    }

    /// Returns the approximate size in memory, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.memory_bytes
    }

    fn count_memory(&self) -> usize {
        let records = self.paths.iter().chain(self.brightest.iter().map(|(_, path)| path));
        let own = |path: &LightPath| {
            size_of::<LightPath>()
                + size_of_val(&path.intersections[..])
                + size_of_val(&path.lights[..])
                // Overhead of two allocations.
                + 32
        };
        let names: usize =
            self.frames.iter().map(|it| it.names.values().map(|(_, text)| text.len() + 64).sum::<usize>()).sum();
        let columns = size_of_val(&self.weights[..])
            + size_of_val(&self.firsts[..])
            + size_of_val(&self.by_hash[..])
            + size_of_val(&self.path_bins[..])
            + self.bins.memory_bytes();
        records.map(own).sum::<usize>() + 2 * names + columns
    }
}

/// Returns the histograms of single attributes over all samples of all frames, or `None` if a frame lacks them.
fn total_histograms(frames: &[LightStatistics]) -> Option<[Vec<Counts>; 3]> {
    let total = |table: Table| {
        let mut all: Option<Vec<Counts>> = None;
        for frame in frames {
            let own = Histograms::attributes_of_all_samples(frame, table)?;
            match &mut all {
                Some(all) => all.iter_mut().zip(&own).for_each(|(all, own)| all.merge(own)),
                None => all = Some(own),
            }
        }
        all
    };
    let [paths, intersections, lights] = Table::ALL.map(total);
    Some([paths?, intersections?, lights?])
}
