//! Statistics of the samples of a frame, or of a part of it, and the union of parts.
//!
//! Samples are counted by *portion*: a range of samples of one half of a tile. Only the finished frame knows which portions count
//! in its image, so each portion keeps its own counters until then. The key of a record says which portion it belongs to.
//! Statistics are united as sets, keyed by (tile, half, samples): the union is associative, commutative and idempotent to the byte.
//!
//! Records are the bottom-k of all samples by hash (\[cohen2007\]): `threshold` is at most the (k+1)-th least hash of all samples,
//! and all samples of lesser hashes are present. So they are a fair subset, and any count over them is exact over a known subset
//! with the share [`LightStatistics::share`]. Records of samples that turn out not to count are dropped. All samples that count and
//! lie below the same threshold remain.

use crate::attribute::{ALL_BINS, ATTRIBUTE_COUNTS, intersection_bins, light_bins, path_bins};
use crate::pixels::{self, PixelSums};
use crate::record::{LightPath, NameMap, Names, PathKey};
use crate::schema;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;

/// Frame and settings of statistics. Parts with different scopes cannot be united.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scope {
    /// Key of the random streams.
    pub seed: u64,
    /// Number of the frame.
    pub frame: u32,
    /// Width and height of the film, pixels; not 0.
    pub film: [u32; 2],
    /// Width and height of a tile, pixels; not 0.
    pub tile_size: u32,
    /// Lower corner of the box for positions, world, m.
    pub lower: [f64; 3],
    /// Upper corner of the box.
    pub upper: [f64; 3],
    /// Maximum number of records chosen by hash (k).
    pub max_records: u32,
    /// Maximum number of records of each sketch for each portion.
    pub sketch_size: u32,
    /// Whether the histograms of single attributes count all samples.
    pub has_full_histograms: bool,
}

impl Scope {
    /// Returns the number of tiles in a row, and the number of all tiles.
    pub(crate) fn tile_counts(&self) -> [u64; 2] {
        let [columns, rows] = self.film.map(|size| u64::from(size.div_ceil(self.tile_size.max(1))));
        [columns, columns * rows]
    }

    /// Returns the index of the tile of a pixel, row by row.
    pub fn tile_of(&self, pixel: u32) -> u32 {
        let (width, edge) = (self.film[0].max(1), self.tile_size.max(1));
        let (x, y) = (pixel % width / edge, pixel / width / edge);
        y * width.div_ceil(edge) + x
    }

    /// Returns the number of pixels of a tile.
    pub fn tile_area(&self, tile: u32) -> u64 {
        let [width, height] = self.film.map(u64::from);
        let (columns, edge) = (self.tile_counts()[0].max(1), u64::from(self.tile_size));
        let (x, y) = (u64::from(tile) % columns * edge, u64::from(tile) / columns * edge);
        edge.min(width.saturating_sub(x)) * edge.min(height.saturating_sub(y))
    }

    /// Returns the pixels of a tile, row by row.
    pub fn tile_pixels(&self, tile: u32) -> impl Iterator<Item = u32> + use<> {
        let (edge, [width, height]) = (self.tile_size.max(1), self.film);
        let columns = width.div_ceil(edge).max(1);
        let [x, y] = [tile % columns, tile / columns].map(|place| place.saturating_mul(edge));
        let end = |begin: u32, size: u32| begin.saturating_add(edge).min(size);
        let (columns, rows) = (x..end(x, width), y..end(y, height));
        rows.flat_map(move |y| columns.clone().map(move |x| y * width + x))
    }

    /// Returns the grid spacing, m. Positions of intersections are whole multiples of it. It is a power of two, 2^-20 to 2^-19 of
    /// the box's greatest extent.
    pub fn grid_spacing(&self) -> f64 {
        let extents = self.lower.iter().zip(&self.upper).map(|(low, high)| high - low);
        let extent = extents.fold(0.0, f64::max).clamp(1e-30, 1e30);
        // Keeps only the exponent.
        f64::from_bits(extent.to_bits() >> 52 << 52) / f64::from(1u32 << 19)
    }

    /// Returns the nearest position on the [grid](Self::grid_spacing).
    pub fn snap_to_grid(&self, position: [f64; 3]) -> [f64; 3] {
        let grid = self.grid_spacing();
        // Turns a negative zero into zero.
        position.map(|axis| (axis / grid).round() * grid + 0.0)
    }

    /// Returns the number of pixels of the film.
    pub(crate) fn pixel_count(&self) -> u64 {
        self.film.iter().map(|size| u64::from(*size)).product()
    }

    pub(crate) fn is_valid(&self) -> bool {
        let sizes = [self.film[0], self.film[1], self.tile_size];
        let corners = || self.lower.iter().zip(&self.upper);
        sizes.iter().all(|size| (1..=1 << 16).contains(size))
            && corners().all(|(low, high)| low.is_finite() && high.is_finite() && low <= high)
            && self.max_records > 0
    }
}

/// Range of samples of one half of a tile. Keys are ordered by the fields in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PortionKey {
    /// Index of the tile.
    pub tile: u32,
    /// 0: the even samples (A), 1: the odd ones (B).
    pub half: u8,
    /// First sample of each pixel, counted over both halves.
    pub begin: u32,
    /// One past the last sample.
    pub end: u32,
}

impl PortionKey {
    /// Returns the number of samples per pixel in its half.
    pub fn samples(self) -> u32 {
        let below = |end: u32| if self.half == 0 { end.div_ceil(2) } else { end / 2 };
        below(self.end) - below(self.begin)
    }

    fn contains(self, sample: u32) -> bool {
        (self.begin..self.end).contains(&sample) && sample % 2 == u32::from(self.half)
    }
}

/// Integer counts of all samples of a portion.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SampleCounters {
    /// Number of invalid samples (not finite, or negative). The film ignores them, and so do all statistics here.
    pub invalid: u64,
    /// Valid samples by the fine bin of their luminance.
    pub luminance: [u64; schema::FINE_BINS],
    /// Valid samples by the fine bin of their depth.
    pub depth: [u64; schema::FINE_BINS],
    /// Valid samples by the reason why the path ended, in the order of [`PathEnd::ALL`](crate::PathEnd::ALL).
    pub ends: [u64; ENDS],
    /// Sums of each pixel of the tile, row by row.
    pub pixels: Vec<PixelSums>,
    /// Histograms of all attributes of all tables, one after the other, if the [scope is full](Scope::has_full_histograms); else
    /// empty.
    pub bins: BinCounts,
}

/// Counts of all attributes of paths, then of intersections, then of lights, each in its fine bins; or empty.
pub type BinCounts = Vec<u64>;

/// Number of reasons why a path ends.
pub(crate) const ENDS: usize = crate::PathEnd::ALL.len();

impl Default for SampleCounters {
    fn default() -> Self {
        let (luminance, depth) = ([0; schema::FINE_BINS], [0; schema::FINE_BINS]);
        Self { invalid: 0, luminance, depth, ends: [0; ENDS], pixels: Vec::new(), bins: BinCounts::new() }
    }
}

impl SampleCounters {
    /// Creates counters without samples, for a tile with this number of pixels.
    pub fn with_pixels(pixels: usize) -> Self {
        Self { pixels: vec![PixelSums::default(); pixels], ..Self::default() }
    }

    /// Counts a sample by luminance, depth and end, but not in its pixel.
    #[inline]
    pub fn count(&mut self, luminance: f32, depth: u32, end: crate::PathEnd) {
        self.luminance[usize::from(schema::radiance_bin(luminance))] += 1;
        self.depth[usize::from(schema::count_bin(depth))] += 1;
        self.ends[end as usize] += 1;
    }

    /// Returns the number of counted samples, including bad ones.
    pub fn samples(&self) -> u64 {
        self.invalid.saturating_add(sum(&self.ends))
    }

    /// Adds the counts of other samples of the same tile.
    pub fn merge(&mut self, other: &Self) {
        self.merge_counts(other);
        self.pixels.iter_mut().zip(&other.pixels).for_each(|(mine, theirs)| mine.merge(theirs));
        self.merge_bins(&other.bins);
    }

    /// Counts a path of the frame in the histograms of all attributes.
    pub fn count_bins(&mut self, scope: &Scope, path: &LightPath) {
        self.bins.resize(ALL_BINS, 0);
        let mut counts = self.bins.as_chunks_mut::<{ schema::FINE_BINS }>().0.iter_mut();
        let [paths, intersections, lights] =
            ATTRIBUTE_COUNTS.map(|axes| counts.by_ref().take(axes).collect::<Vec<_>>());
        fn add(mut counts: Vec<&mut [u64; schema::FINE_BINS]>, bins: impl Iterator<Item = impl AsRef<[u8]>>) {
            for bins in bins {
                for (counts, bin) in counts.iter_mut().zip(bins.as_ref()) {
                    counts[usize::from(*bin)] += 1;
                }
            }
        }
        add(paths, [path_bins(scope, path)].into_iter());
        add(intersections, path.intersections.iter().map(|it| intersection_bins(scope, it)));
        add(lights, path.lights.iter().map(|it| light_bins(scope, it)));
    }

    /// Adds histograms of other samples.
    pub fn merge_bins(&mut self, other: &BinCounts) {
        self.bins.resize(self.bins.len().max(other.len()), 0);
        self.bins.iter_mut().zip(other).for_each(|(mine, theirs)| *mine = mine.saturating_add(*theirs));
    }

    /// Adds the counts of other samples of any tile, without the sums of pixels and the histograms.
    pub fn merge_counts(&mut self, other: &Self) {
        self.words_mut().zip(other.words()).for_each(|(mine, theirs)| *mine = mine.saturating_add(theirs));
    }

    /// Checks that all counts cover the same number of samples.
    pub(crate) fn is_valid(&self, key: PortionKey, scope: &Scope) -> bool {
        let (ends, area) = (sum(&self.ends), scope.tile_area(key.tile));
        let mut counts = self.bins.as_chunks::<{ schema::FINE_BINS }>().0.iter().map(|counts| sum(counts));
        // Each path is in one bin of each path attribute, and so are its intersections and lights for their attributes.
        let mut are_alike = |axes: usize, expected: Option<u64>| {
            let first = counts.next();
            first == expected.or(first) && counts.by_ref().take(axes - 1).all(|sum| Some(sum) == first)
        };
        let [paths, intersections, lights] = ATTRIBUTE_COUNTS;
        let has_bins = are_alike(paths, Some(ends)) && are_alike(intersections, None) && are_alike(lights, None);
        let are_there = if scope.has_full_histograms {
            self.bins.len() == ALL_BINS && has_bins || ends == 0 && self.bins.is_empty()
        } else {
            self.bins.is_empty()
        };
        are_there
            && sum(&self.luminance) == ends
            && sum(&self.depth) == ends
            && pixels::are_valid(key, area, ends, &self.pixels)
    }

    pub(crate) fn words(&self) -> impl Iterator<Item = u64> + '_ {
        [self.invalid].into_iter().chain(self.luminance.iter().chain(&self.depth).chain(&self.ends).copied())
    }

    pub(crate) fn words_mut(&mut self) -> impl Iterator<Item = &mut u64> + '_ {
        [&mut self.invalid].into_iter().chain(self.luminance.iter_mut().chain(&mut self.depth).chain(&mut self.ends))
    }
}

fn sum(counts: &[u64]) -> u64 {
    counts.iter().fold(0, |all: u64, count| all.saturating_add(*count))
}

/// Reason why parts cannot be united.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MergeError {
    /// The parts differ in frame, film, box or size.
    #[error("the statistics belong to different frames or settings")]
    Scope,
    /// The parts contain the same samples in different portions.
    #[error("samples {} to {} of half {} of tile {} are in two portions", .0.begin, .0.end, .0.half, .0.tile)]
    Overlap(PortionKey),
    /// A portion arrived twice with different counts.
    #[error("samples {} to {} of half {} of tile {} have two different counts", .0.begin, .0.end, .0.half, .0.tile)]
    Conflict(PortionKey),
}

/// Light statistics of some samples of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightStatistics {
    /// Frame and settings.
    pub scope: Scope,
    /// Hash threshold. `paths` has exactly the records of those samples of the portions whose hash is below it.
    pub threshold: u64,
    /// Counters by portion.
    pub portions: BTreeMap<PortionKey, SampleCounters>,
    /// Records chosen by hash.
    pub paths: Records,
    /// Records of greatest luminance of each portion: fireflies.
    pub brightest: Records,
    /// Records of greatest throughput of each portion, among paths with at least [`DEEP_PATH_DEPTH`] intersections: bottlenecks.
    pub deepest: Records,
    /// Texts of the names in the records.
    pub names: Names,
}

/// Records in order of hash and key.
pub type Records = BTreeMap<(u64, PathKey), LightPath>;

/// Minimum number of intersections of a deep path.
pub const DEEP_PATH_DEPTH: u32 = 8;

/// Returns the rank of a path among the brightest: its luminance, cd/m2.
pub fn brightness(path: &LightPath) -> f32 {
    path.luminance()
}

/// Returns the rank of a path among the deepest: its greatest throughput. `None` if the path is not deep.
pub fn depth_rank(path: &LightPath) -> Option<f32> {
    (path.depth >= DEEP_PATH_DEPTH).then(|| path.throughput.into_iter().fold(0.0, f32::max))
}

impl LightStatistics {
    /// Creates statistics without samples.
    /// - `share`: the initial share of samples whose paths are recorded, in (0, 1].
    pub fn new(scope: Scope, share: f64) -> Self {
        // `u64::MAX` accepts all hashes, since no hash has that value.
        let threshold = if share < 1.0 { (share.max(0.0) * TWO_64) as u64 } else { u64::MAX };
        Self { scope, threshold, ..Self::default() }
    }

    /// Returns the share of samples whose paths are recorded.
    pub fn share(&self) -> f64 {
        if self.threshold == u64::MAX { 1.0 } else { self.threshold as f64 / TWO_64 }
    }

    /// Returns the number of counted samples, including bad ones.
    pub fn samples(&self) -> u64 {
        self.portions.values().fold(0, |all: u64, counters| all.saturating_add(counters.samples()))
    }

    /// Returns the sums of the counters of all portions, without pixels.
    pub fn totals(&self) -> SampleCounters {
        let mut all = SampleCounters::default();
        self.portions.values().for_each(|counters| all.merge_counts(counters));
        all
    }

    /// Checks whether the path of a sample must be recorded.
    #[inline]
    pub fn must_record(&self, key: PathKey) -> bool {
        key.hash(self.scope.seed) < self.threshold
    }

    /// Returns the portion that contains a sample.
    pub fn portion_of(&self, key: PathKey) -> Option<PortionKey> {
        find_portion(&self.scope, &self.portions, key)
    }

    /// Adds another part of the frame. Data that both parts have counts once. An error changes nothing.
    pub fn merge(&mut self, other: Self) -> Result<(), MergeError> {
        self.add(other)?;
        self.trim();
        Ok(())
    }

    /// Adds several parts of the frame, as [`Self::merge`] does. An error leaves the parts before it added, but not settled.
    pub fn merge_all(&mut self, others: impl IntoIterator<Item = Self>) -> Result<(), MergeError> {
        for other in others {
            self.merge_untrimmed(other)?;
        }
        self.trim();
        Ok(())
    }

    /// Adds another part without trimming the records to the limits of the scope. Call [`Self::trim`] after the last part. If
    /// there are more than twice as many records as the limit, it trims at once, so that memory does not grow with the number of
    /// parts.
    pub fn merge_untrimmed(&mut self, other: Self) -> Result<(), MergeError> {
        self.add(other)?;
        if self.paths.len() > 2 * self.scope.max_records as usize {
            self.trim();
        }
        Ok(())
    }

    fn add(&mut self, other: Self) -> Result<(), MergeError> {
        if self.scope != other.scope {
            return Err(MergeError::Scope);
        }
        for (key, counters) in &other.portions {
            match self.portions.get(key) {
                Some(mine) if mine != counters => return Err(MergeError::Conflict(*key)),
                Some(_) => {}
                None if is_disjoint(&self.portions, *key) => {}
                None => return Err(MergeError::Overlap(*key)),
            }
        }
        self.portions.extend(other.portions);
        self.threshold = self.threshold.min(other.threshold);
        for (mine, theirs) in
            [(&mut self.paths, other.paths), (&mut self.brightest, other.brightest), (&mut self.deepest, other.deepest)]
        {
            mine.extend(theirs);
        }
        self.names.extend(other.names);
        Ok(())
    }

    /// Trims the records to the limits of the scope, and the names to those that the records use. The result is a function of the
    /// samples.
    pub fn trim(&mut self) {
        if let Some(((hash, _), _)) = self.paths.iter().nth(self.scope.max_records as usize) {
            self.threshold = self.threshold.min(*hash);
        }
        drop(self.paths.split_off(&(self.threshold, PathKey::default())));
        let most = self.scope.sketch_size as usize;
        let mut brightest = std::mem::take(&mut self.brightest);
        self.keep_best(&mut brightest, most, |path| Some(brightness(path)));
        let mut deepest = std::mem::take(&mut self.deepest);
        self.keep_best(&mut deepest, most, depth_rank);
        (self.brightest, self.deepest) = (brightest, deepest);
        let records = [&self.paths, &self.brightest, &self.deepest];
        let all = records.into_iter().flat_map(|records| records.values()).flat_map(LightPath::names);
        let used: NameMap<()> = all.map(|name| (name, ())).collect();
        self.names.retain(|name, _| used.contains_key(name));
    }

    /// Keeps the `limit` records of greatest `rank` of each portion. Among equal ranks, the record with the lesser hash wins.
    fn keep_best(&self, records: &mut Records, limit: usize, rank: impl Fn(&LightPath) -> Option<f32>) {
        let mut by_portion = BTreeMap::<PortionKey, Vec<(f32, (u64, PathKey))>>::new();
        for (key, path) in records.iter() {
            if let (Some(rank), Some(portion)) = (rank(path), self.portion_of(key.1)) {
                by_portion.entry(portion).or_default().push((rank, *key));
            }
        }
        let mut kept = BTreeSet::new();
        for mut ranked in by_portion.into_values() {
            ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            kept.extend(ranked.into_iter().take(limit).map(|(_, key)| key));
        }
        records.retain(|key, _| kept.contains(key));
    }

    /// Keeps what counts in the image: samples from `begin` on, up to the end of each half. Adjacent portions are joined.
    ///
    /// The result does not depend on the division of the samples into portions. Call it when all parts are present: the union does
    /// not recognize a joined portion as the portions it consists of.
    /// - `ends`: returns, for a tile and a half, one past the last sample that counts.
    #[must_use]
    pub fn into_image_samples(mut self, begin: u32, ends: impl Fn(u32, u8) -> u32) -> Self {
        let counts = |key: &PortionKey| key.begin >= begin && key.end <= ends(key.tile, key.half);
        self.portions.retain(|key, _| counts(key));
        let mut joined = BTreeMap::<PortionKey, SampleCounters>::new();
        for (key, counters) in std::mem::take(&mut self.portions) {
            match joined.last_entry() {
                Some(last) if (last.key().tile, last.key().half, last.key().end) == (key.tile, key.half, key.begin) => {
                    let (before, mut all) = last.remove_entry();
                    all.merge(&counters);
                    joined.insert(PortionKey { end: key.end, ..before }, all);
                }
                _ => drop(joined.insert(key, counters)),
            }
        }
        self.portions = joined;
        for records in [&mut self.paths, &mut self.brightest, &mut self.deepest] {
            let mut all = std::mem::take(records);
            all.retain(|(_, key), _| find_portion(&self.scope, &self.portions, *key).is_some());
            *records = all;
        }
        self.trim();
        self
    }

    /// Returns the records of greatest luminance of all portions, in descending order.
    pub fn fireflies(&self) -> Vec<&LightPath> {
        sort_by_rank(&self.brightest, |path| Some(brightness(path)))
    }

    /// Returns the deep records of greatest throughput of all portions, in descending order.
    pub fn bottlenecks(&self) -> Vec<&LightPath> {
        sort_by_rank(&self.deepest, depth_rank)
    }

    /// Returns the part of the image that a sample is, in units of 2^-[`IMAGE_BITS`] of its pixel. With n_A samples of half A in
    /// the pixel and n_B of B, each sample of A weighs 1 / (2 n_A) and each of B 1 / (2 n_B). If there is only one half, each
    /// weighs 1 / n. The result is rounded to the nearest unit, ties up. It is 0 if the sample does not count.
    pub fn image_weight(&self, key: PathKey) -> u64 {
        let counts = self.half_counts(self.scope.tile_of(key.pixel));
        image_weight(counts, key.half())
    }

    /// Returns the number of samples per pixel of each half of a tile.
    pub fn half_counts(&self, tile: u32) -> [u64; 2] {
        let mut counts = [0; 2];
        let first = PortionKey { tile, half: 0, begin: 0, end: 0 };
        for (key, _) in self.portions.range(first..).take_while(|(key, _)| key.tile == tile) {
            counts[usize::from(key.half)] += u64::from(key.samples());
        }
        counts
    }
}

const TWO_64: f64 = 18_446_744_073_709_551_616.0;

/// Fraction bits of a part of a pixel.
pub const IMAGE_BITS: u32 = 32;

/// Computes [`LightStatistics::image_weight`] from the numbers of samples of the halves.
pub fn image_weight(counts: [u64; 2], half: u8) -> u64 {
    let [own, other] = if half == 0 { counts } else { [counts[1], counts[0]] };
    let parts = if other == 0 { own } else { 2 * own };
    ((1 << IMAGE_BITS) + parts / 2).checked_div(parts).unwrap_or(0)
}

fn find_portion(scope: &Scope, portions: &BTreeMap<PortionKey, SampleCounters>, key: PathKey) -> Option<PortionKey> {
    let (tile, half) = (scope.tile_of(key.pixel), key.half());
    let after = PortionKey { tile, half, begin: key.sample, end: u32::MAX };
    let (portion, _) = portions.range(..=after).next_back()?;
    (portion.tile == tile && portion.contains(key.sample)).then_some(*portion)
}

fn sort_by_rank(records: &Records, rank: impl Fn(&LightPath) -> Option<f32>) -> Vec<&LightPath> {
    let mut all: Vec<(f32, &LightPath)> = records.values().filter_map(|path| Some((rank(path)?, path))).collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.into_iter().map(|(_, path)| path).collect()
}

/// Checks that no other portion has samples of this one.
pub(crate) fn is_disjoint(portions: &BTreeMap<PortionKey, SampleCounters>, key: PortionKey) -> bool {
    let is_disjoint = |other: &PortionKey| {
        (other.tile, other.half) != (key.tile, key.half) || other.end <= key.begin || key.end <= other.begin
    };
    let before = portions.range(..key).next_back();
    let after = portions.range((Bound::Excluded(key), Bound::Unbounded)).next();
    [before, after].into_iter().flatten().all(|(other, _)| is_disjoint(other))
}
