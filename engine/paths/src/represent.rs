//! A representative set: N paths whose histograms are close to the histograms of all paths.
//!
//! The distance of the founding documents (\[simons2016\]) is `D = sum |m_i / M - n_i / N|` over the 10 bins of each attribute,
//! summed over the attributes of a path. They keep the best of many random sets ([`best_random_set`]). `DJ` is the corresponding
//! sum over the 10 x 10 bins of each two attributes that are neighbors in a parallel coordinates plot, where a line connects them.
//! A set may match every attribute and still have wrong lines.
//!
//! Here the set is found by exchanges. From a pool of some times N candidates, the worst of a few members is exchanged for the best
//! of a few other candidates, if this reduces `D + DJ`. The arithmetic is in integers with a fixed sequence of draws, so equal
//! candidates give equal sets.

use crate::attribute::PATH_ATTRIBUTES;
use crate::schema::COARSE_BINS;
use crate::selection::{CancelCheck, Cancelled};
use femc_math::hash::mix64;
use std::sync::atomic::AtomicBool;

/// Number of attributes of a path.
const AXES: usize = PATH_ATTRIBUTES.len();
/// Space for the bins of an attribute. It is a power of two so that a mask keeps every index in bounds.
const SINGLE_BINS: usize = 16;
/// Space for the joint bins of a pair of attributes.
const JOINT_BINS: usize = SINGLE_BINS * SINGLE_BINS;
/// Units of one path in the residuals.
const UNIT: i64 = 256;
/// Number of members, and of candidates, that an exchange chooses among.
const TOURNAMENT_SIZE: usize = 6;
/// Number of attempted exchanges for each path of the set.
const EXCHANGES_PER_PATH: usize = 10;
/// Work of one attempted exchange, in units of [`CancelCheck`].
const EXCHANGE_WORK: usize = 2 * TOURNAMENT_SIZE;

/// Fine bins of a path, by [`path_bins`](crate::attribute::path_bins).
pub type PathBins = [u8; AXES];

/// Coarse bins of a path.
type CoarseBins = [u8; AXES];

fn coarse_bins(bins: &PathBins) -> CoarseBins {
    std::array::from_fn(|axis| PATH_ATTRIBUTES[axis].scale.coarse(bins[axis]))
}

/// One value for each bin of each attribute and of each pair of neighboring attributes.
#[derive(Clone, Debug, PartialEq, Eq)]
struct BinTable<T> {
    single: [[T; SINGLE_BINS]; AXES],
    joint: [[T; JOINT_BINS]; AXES - 1],
}

impl<T: Copy + Default> BinTable<T> {
    fn new() -> Self {
        Self { single: [[T::default(); SINGLE_BINS]; AXES], joint: [[T::default(); JOINT_BINS]; AXES - 1] }
    }

    fn all(&self) -> impl Iterator<Item = &T> {
        self.single.as_flattened().iter().chain(self.joint.as_flattened())
    }
}

/// Returns the index of a pair's bin.
#[inline]
fn joint_bin(coarse: &CoarseBins, at: usize) -> usize {
    usize::from(coarse[at] & 15) << 4 | usize::from(coarse[at + 1] & 15)
}

/// Counts of all paths in coarse bins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    counts: Box<BinTable<u64>>,
    total: u64,
}

impl Target {
    /// Counts the given paths.
    pub fn from_paths<'a>(paths: impl IntoIterator<Item = &'a PathBins>) -> Self {
        let (mut counts, mut total) = (Box::new(BinTable::<u64>::new()), 0);
        for bins in paths {
            let coarse = coarse_bins(bins);
            (0..AXES).for_each(|axis| counts.single[axis][usize::from(coarse[axis])] += 1);
            (0..AXES - 1).for_each(|at| counts.joint[at][joint_bin(&coarse, at)] += 1);
            total += 1;
        }
        Self { counts, total }
    }
}

/// Distance between a set and all paths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// Distance of the attributes (D).
    pub single: f64,
    /// Distance of the pairs of neighbors (DJ).
    pub joint: f64,
}

impl Distance {
    /// Computes the distance of a set from its bins.
    pub fn between<'a>(set: impl IntoIterator<Item = &'a PathBins>, target: &Target) -> Self {
        let own = Target::from_paths(set);
        let part = |count: u64, of: u64| count as f64 / of.max(1) as f64;
        let differences = own.counts.all().zip(target.counts.all());
        let mut differences = differences.map(|(n, m)| (part(*m, target.total) - part(*n, own.total)).abs());
        let single = differences.by_ref().take(AXES * SINGLE_BINS).sum();
        Self { single, joint: differences.sum() }
    }
}

/// A set that represents all paths.
#[derive(Clone, Debug, PartialEq)]
pub struct Representative {
    /// Indices of its paths among the candidates, ascending.
    pub chosen: Vec<u32>,
    /// Distance from all paths.
    pub distance: Distance,
    /// Weights of the paths that make all attributes match (raking, \[deming1940\]). Their sum is the number of paths.
    pub weights: Vec<f64>,
    /// Effective number of equal weights: (sum w)^2 / sum w^2 (\[kish1965\]).
    pub effective_size: f64,
}

/// Excess of each bin, and the change of the distance if one path is added or removed.
struct Residuals {
    residual: BinTable<i32>,
    if_added: BinTable<i16>,
    if_removed: BinTable<i16>,
}

impl Residuals {
    fn new(target: &Target, size: usize) -> Box<Self> {
        let wanted = |count: u64| {
            let (all, total) = (u128::from(count) * size as u128 * UNIT as u128, u128::from(target.total.max(1)));
            -(((all + total / 2) / total) as i32)
        };
        let mut all =
            Box::new(Self { residual: BinTable::new(), if_added: BinTable::new(), if_removed: BinTable::new() });
        for axis in 0..AXES {
            for bin in 0..SINGLE_BINS {
                all.add_single(axis, bin, wanted(target.counts.single[axis][bin]));
            }
        }
        for at in 0..AXES - 1 {
            for bin in 0..JOINT_BINS {
                all.add_joint(at, bin, wanted(target.counts.joint[at][bin]));
            }
        }
        all
    }

    #[inline]
    fn add_single(&mut self, axis: usize, bin: usize, delta: i32) {
        let residual = self.residual.single[axis][bin & (SINGLE_BINS - 1)] + delta;
        self.residual.single[axis][bin & (SINGLE_BINS - 1)] = residual;
        self.if_added.single[axis][bin & (SINGLE_BINS - 1)] = distance_change(residual, UNIT as i32);
        self.if_removed.single[axis][bin & (SINGLE_BINS - 1)] = distance_change(residual, -UNIT as i32);
    }

    #[inline]
    fn add_joint(&mut self, at: usize, bin: usize, delta: i32) {
        let residual = self.residual.joint[at][bin & (JOINT_BINS - 1)] + delta;
        self.residual.joint[at][bin & (JOINT_BINS - 1)] = residual;
        self.if_added.joint[at][bin & (JOINT_BINS - 1)] = distance_change(residual, UNIT as i32);
        self.if_removed.joint[at][bin & (JOINT_BINS - 1)] = distance_change(residual, -UNIT as i32);
    }

    /// Adds a path (1) or removes it (-1).
    fn add(&mut self, coarse: &CoarseBins, paths: i32) {
        (0..AXES).for_each(|axis| self.add_single(axis, usize::from(coarse[axis]), paths * UNIT as i32));
        (0..AXES - 1).for_each(|at| self.add_joint(at, joint_bin(coarse, at), paths * UNIT as i32));
    }

    /// Returns the correction of an exchange against a separate removal and addition: bins that both paths share do not change.
    fn shared_correction(&self, removed: &CoarseBins, added: &CoarseBins) -> i32 {
        let mut all = 0;
        for axis in 0..AXES {
            let bin = usize::from(removed[axis] & 15);
            if removed[axis] == added[axis] {
                all += i32::from(self.if_removed.single[axis][bin]) + i32::from(self.if_added.single[axis][bin]);
            }
            if axis + 1 < AXES && joint_bin(removed, axis) == joint_bin(added, axis) {
                let bin = joint_bin(removed, axis);
                all += i32::from(self.if_removed.joint[axis][bin]) + i32::from(self.if_added.joint[axis][bin]);
            }
        }
        all
    }
}

#[inline]
fn distance_change(residual: i32, delta: i32) -> i16 {
    ((residual + delta).abs() - residual.abs()) as i16
}

#[inline]
fn total_change(table: &BinTable<i16>, coarse: &CoarseBins) -> i32 {
    let single: i32 = (0..AXES).map(|axis| i32::from(table.single[axis][usize::from(coarse[axis] & 15)])).sum();
    let joint: i32 = (0..AXES - 1).map(|at| i32::from(table.joint[at][joint_bin(coarse, at)])).sum();
    single + joint
}

/// Pseudo-random draws of a fixed sequence.
struct Draws(u64);

impl Draws {
    #[inline]
    fn below(&mut self, count: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        ((u128::from(mix64(self.0)) * count as u128) >> 64) as usize
    }
}

/// Chooses `size` of the candidates as close to the target as exchanges get. Returns all candidates if there are no more than
/// `size`.
pub fn choose_representative(candidates: &[PathBins], target: &Target, size: usize) -> Representative {
    let running = AtomicBool::new(false);
    let found = choose_representative_within(candidates, target, size, &mut CancelCheck::new(&running));
    found.expect("the flag is never set")
}

/// Like [`choose_representative`], with a cancel flag.
pub fn choose_representative_within(
    candidates: &[PathBins],
    target: &Target,
    size: usize,
    check: &mut CancelCheck<'_>,
) -> Result<Representative, Cancelled> {
    let size = size.min(candidates.len());
    let coarse: Vec<CoarseBins> = candidates.iter().map(coarse_bins).collect();
    let mut places: Vec<u32> = (0..candidates.len() as u32).collect();
    let (members, others) = places.split_at_mut(size);
    if !others.is_empty() {
        exchange(&coarse, [members, others], target, check, |_, _| ())?;
    }
    members.sort_unstable();
    let chosen = members.to_vec();
    let bins: Vec<&PathBins> = chosen.iter().map(|place| &candidates[*place as usize]).collect();
    let distance = Distance::between(bins.iter().copied(), target);
    let weights = rake(&bins, target);
    let (sum, squares) = weights.iter().fold((0.0, 0.0), |(sum, squares), w| (sum + w, squares + w * w));
    let effective = if squares > 0.0 { sum * sum / squares } else { 0.0 };
    Ok(Representative { chosen, distance, weights, effective_size: effective })
}

/// Exchanges members of a set for other candidates.
/// - `exchanged`: called after each exchange with the members, and the change of the distance that the exchange is made for, in units
///   of the residuals.
fn exchange(
    coarse: &[CoarseBins],
    [members, others]: [&mut [u32]; 2],
    target: &Target,
    check: &mut CancelCheck<'_>,
    mut exchanged: impl FnMut(&[u32], i32),
) -> Result<(), Cancelled> {
    let mut residuals = Residuals::new(target, members.len());
    let coarse = |place: u32| &coarse[place as usize];
    members.iter().for_each(|place| residuals.add(coarse(*place), 1));
    let mut draws = Draws(0);
    let mut best = |among: &[u32], table: &BinTable<i16>| {
        let drawn = (0..TOURNAMENT_SIZE).map(|_| draws.below(among.len()));
        drawn.map(|at| (total_change(table, coarse(among[at])), at)).min().unwrap_or_default()
    };
    for _ in 0..EXCHANGES_PER_PATH * members.len() {
        check.add(EXCHANGE_WORK)?;
        let (lost, removed) = best(members, &residuals.if_removed);
        let (won, added) = best(others, &residuals.if_added);
        let (out, new) = (coarse(members[removed]), coarse(others[added]));
        let change = lost + won - residuals.shared_correction(out, new);
        if change < 0 {
            residuals.add(out, -1);
            residuals.add(new, 1);
            std::mem::swap(&mut members[removed], &mut others[added]);
            exchanged(members, change);
        }
    }
    Ok(())
}

/// Number of rounds of raking.
const RAKING_ROUNDS: usize = 10;

fn rake(set: &[&PathBins], target: &Target) -> Vec<f64> {
    let mut weights = vec![1.0f64; set.len()];
    let size = set.len() as f64;
    for axis in (0..RAKING_ROUNDS).flat_map(|_| 0..AXES) {
        let coarse = |bins: &PathBins| usize::from(PATH_ATTRIBUTES[axis].scale.coarse(bins[axis]));
        let mut sums = [0.0f64; COARSE_BINS];
        set.iter().zip(&weights).for_each(|(bins, weight)| sums[coarse(bins)] += weight);
        let wanted = |bin: usize| target.counts.single[axis][bin] as f64 / target.total.max(1) as f64 * size;
        // A weight cannot fill a bin in which the set has no path.
        let factors: [f64; COARSE_BINS] =
            std::array::from_fn(|bin| if sums[bin] > 0.0 { wanted(bin) / sums[bin] } else { 1.0 });
        set.iter().zip(&mut weights).for_each(|(bins, weight)| *weight *= factors[coarse(bins)]);
    }
    let sum: f64 = weights.iter().sum();
    if sum > 0.0 {
        weights.iter_mut().for_each(|weight| *weight *= size / sum);
    }
    weights
}

/// Computes the reduction of the founding documents, for comparison: the closest of `sets` random sets, drawn with replacement.
pub fn best_random_set(candidates: &[PathBins], target: &Target, size: usize, sets: usize) -> Distance {
    let mut draws = Draws(1);
    let mut set = || -> Vec<&PathBins> { (0..size).map(|_| &candidates[draws.below(candidates.len())]).collect() };
    let distances = (0..sets).map(|_| Distance::between(set(), target));
    let nothing = Distance { single: f64::INFINITY, joint: f64::INFINITY };
    distances.fold(nothing, |best, distance| if distance.single < best.single { distance } else { best })
}

/// Returns the indices of the paths in the rarest bins, the rarest first: those with an attribute in a fine bin that few paths are
/// in.
pub fn rarest_paths(candidates: &[PathBins], max_paths: usize) -> Vec<u32> {
    let mut counts = [[0u32; crate::schema::FINE_BINS]; AXES];
    for bins in candidates {
        counts.iter_mut().zip(bins).for_each(|(counts, bin)| counts[usize::from(*bin)] += 1);
    }
    let least = |bins: &PathBins| counts.iter().zip(bins).map(|(counts, bin)| counts[usize::from(*bin)]).min();
    let mut all: Vec<(Option<u32>, u32)> = (0..).zip(candidates).map(|(place, bins)| (least(bins), place)).collect();
    all.sort_unstable();
    all.into_iter().take(max_paths).map(|(_, place)| place).collect()
}

#[cfg(test)]
mod exchanges;
