//! A representative set: N paths whose histograms are close to the histograms of all paths.
//!
//! The distance of the founding documents (\[simons2016\]) is `D = sum |m_i / M - n_i / N|` over the 10 bins of each attribute,
//! summed over the attributes of a path. They keep the best of many random sets ([`best_of`]). `DJ` is the corresponding sum over
//! the 10 x 10 bins of each two attributes that are neighbors in a parallel coordinates plot, where a line connects them. A set may
//! match every attribute and still have wrong lines.
//!
//! Here the set is found by exchanges. From a pool of some times N candidates, the worst of a few members is exchanged for the best
//! of a few other candidates, if this reduces `D + DJ`. The arithmetic is in integers with a fixed sequence of draws, so equal
//! candidates give equal sets.

use crate::schema::{COARSE, PATH};
use femc_math::hash::mix64;

/// Number of attributes of a path.
const AXES: usize = PATH.len();
/// Space for the bins of an attribute. It is a power of two so that a mask keeps every index in bounds.
const SINGLE: usize = 16;
/// Space for the joint bins of a pair of attributes.
const JOINT: usize = SINGLE * SINGLE;
/// Units of one path in the residuals.
const UNIT: i64 = 256;
/// Number of members, and of candidates, that an exchange chooses among.
const AMONG: usize = 6;
/// Number of attempted exchanges for each path of the set.
const TRIES: usize = 10;

/// Fine bins of a path, by [`path_bins`](crate::schema::path_bins).
pub type Bins = [u8; AXES];

/// Coarse bins of a path.
type Coarse = [u8; AXES];

fn coarse(bins: &Bins) -> Coarse {
    std::array::from_fn(|axis| PATH[axis].scale.coarse(bins[axis]))
}

/// One value for each bin of each attribute and of each pair of neighboring attributes.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Table<T> {
    single: [[T; SINGLE]; AXES],
    joint: [[T; JOINT]; AXES - 1],
}

impl<T: Copy + Default> Table<T> {
    fn new() -> Self {
        Self { single: [[T::default(); SINGLE]; AXES], joint: [[T::default(); JOINT]; AXES - 1] }
    }

    fn all(&self) -> impl Iterator<Item = &T> {
        self.single.as_flattened().iter().chain(self.joint.as_flattened())
    }
}

/// Returns the index of a pair's bin.
#[inline]
fn pair(coarse: &Coarse, at: usize) -> usize {
    usize::from(coarse[at] & 15) << 4 | usize::from(coarse[at + 1] & 15)
}

/// Counts of all paths in coarse bins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    counts: Box<Table<u64>>,
    total: u64,
}

impl Target {
    /// Counts the given paths.
    pub fn of<'a>(paths: impl IntoIterator<Item = &'a Bins>) -> Self {
        let (mut counts, mut total) = (Box::new(Table::<u64>::new()), 0);
        for bins in paths {
            let coarse = coarse(bins);
            (0..AXES).for_each(|axis| counts.single[axis][usize::from(coarse[axis])] += 1);
            (0..AXES - 1).for_each(|at| counts.joint[at][pair(&coarse, at)] += 1);
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
    pub fn of<'a>(set: impl IntoIterator<Item = &'a Bins>, target: &Target) -> Self {
        let own = Target::of(set);
        let part = |count: u64, of: u64| count as f64 / of.max(1) as f64;
        let differences = own.counts.all().zip(target.counts.all());
        let mut differences = differences.map(|(n, m)| (part(*m, target.total) - part(*n, own.total)).abs());
        let single = differences.by_ref().take(AXES * SINGLE).sum();
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
    pub effective: f64,
}

/// Excess of each bin, and the change of the distance if one path is added or removed.
struct Residuals {
    residual: Table<i32>,
    more: Table<i16>,
    less: Table<i16>,
}

impl Residuals {
    fn new(target: &Target, size: usize) -> Box<Self> {
        let wanted = |count: u64| {
            let (all, total) = (u128::from(count) * size as u128 * UNIT as u128, u128::from(target.total.max(1)));
            -(((all + total / 2) / total) as i32)
        };
        let mut all = Box::new(Self { residual: Table::new(), more: Table::new(), less: Table::new() });
        for axis in 0..AXES {
            for bin in 0..SINGLE {
                all.single(axis, bin, wanted(target.counts.single[axis][bin]));
            }
        }
        for at in 0..AXES - 1 {
            for bin in 0..JOINT {
                all.joint(at, bin, wanted(target.counts.joint[at][bin]));
            }
        }
        all
    }

    #[inline]
    fn single(&mut self, axis: usize, bin: usize, by: i32) {
        let residual = self.residual.single[axis][bin & (SINGLE - 1)] + by;
        self.residual.single[axis][bin & (SINGLE - 1)] = residual;
        self.more.single[axis][bin & (SINGLE - 1)] = change(residual, UNIT as i32);
        self.less.single[axis][bin & (SINGLE - 1)] = change(residual, -UNIT as i32);
    }

    #[inline]
    fn joint(&mut self, at: usize, bin: usize, by: i32) {
        let residual = self.residual.joint[at][bin & (JOINT - 1)] + by;
        self.residual.joint[at][bin & (JOINT - 1)] = residual;
        self.more.joint[at][bin & (JOINT - 1)] = change(residual, UNIT as i32);
        self.less.joint[at][bin & (JOINT - 1)] = change(residual, -UNIT as i32);
    }

    /// Adds a path (1) or removes it (-1).
    fn add(&mut self, coarse: &Coarse, paths: i32) {
        (0..AXES).for_each(|axis| self.single(axis, usize::from(coarse[axis]), paths * UNIT as i32));
        (0..AXES - 1).for_each(|at| self.joint(at, pair(coarse, at), paths * UNIT as i32));
    }

    /// Returns the correction of an exchange against a separate removal and addition: bins that both paths share do not change.
    fn shared(&self, goes: &Coarse, comes: &Coarse) -> i32 {
        let mut all = 0;
        for axis in 0..AXES {
            let bin = usize::from(goes[axis] & 15);
            if goes[axis] == comes[axis] {
                all += i32::from(self.less.single[axis][bin]) + i32::from(self.more.single[axis][bin]);
            }
            if axis + 1 < AXES && pair(goes, axis) == pair(comes, axis) {
                let bin = pair(goes, axis);
                all += i32::from(self.less.joint[axis][bin]) + i32::from(self.more.joint[axis][bin]);
            }
        }
        all
    }
}

#[inline]
fn change(residual: i32, by: i32) -> i16 {
    ((residual + by).abs() - residual.abs()) as i16
}

#[inline]
fn total(table: &Table<i16>, coarse: &Coarse) -> i32 {
    let single: i32 = (0..AXES).map(|axis| i32::from(table.single[axis][usize::from(coarse[axis] & 15)])).sum();
    let joint: i32 = (0..AXES - 1).map(|at| i32::from(table.joint[at][pair(coarse, at)])).sum();
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
pub fn representative(candidates: &[Bins], target: &Target, size: usize) -> Representative {
    let size = size.min(candidates.len());
    let coarse: Vec<Coarse> = candidates.iter().map(coarse).collect();
    let mut places: Vec<u32> = (0..candidates.len() as u32).collect();
    let (members, others) = places.split_at_mut(size);
    if !others.is_empty() {
        exchange(&coarse, members, others, target);
    }
    members.sort_unstable();
    let chosen = members.to_vec();
    let bins: Vec<&Bins> = chosen.iter().map(|place| &candidates[*place as usize]).collect();
    let distance = Distance::of(bins.iter().copied(), target);
    let weights = rake(&bins, target);
    let (sum, squares) = weights.iter().fold((0.0, 0.0), |(sum, squares), w| (sum + w, squares + w * w));
    let effective = if squares > 0.0 { sum * sum / squares } else { 0.0 };
    Representative { chosen, distance, weights, effective }
}

fn exchange(coarse: &[Coarse], members: &mut [u32], others: &mut [u32], target: &Target) {
    let mut residuals = Residuals::new(target, members.len());
    let coarse = |place: u32| &coarse[place as usize];
    members.iter().for_each(|place| residuals.add(coarse(*place), 1));
    let mut draws = Draws(0);
    let mut best = |among: &[u32], table: &Table<i16>| {
        let drawn = (0..AMONG).map(|_| draws.below(among.len()));
        drawn.map(|at| (total(table, coarse(among[at])), at)).min().unwrap_or_default()
    };
    for _ in 0..TRIES * members.len() {
        let (lost, goes) = best(members, &residuals.less);
        let (won, comes) = best(others, &residuals.more);
        let (out, new) = (coarse(members[goes]), coarse(others[comes]));
        if lost + won - residuals.shared(out, new) < 0 {
            residuals.add(out, -1);
            residuals.add(new, 1);
            std::mem::swap(&mut members[goes], &mut others[comes]);
        }
    }
}

/// Number of rounds of raking.
const RAKES: usize = 10;

fn rake(set: &[&Bins], target: &Target) -> Vec<f64> {
    let mut weights = vec![1.0f64; set.len()];
    let size = set.len() as f64;
    for axis in (0..RAKES).flat_map(|_| 0..AXES) {
        let coarse = |bins: &Bins| usize::from(PATH[axis].scale.coarse(bins[axis]));
        let mut sums = [0.0f64; COARSE];
        set.iter().zip(&weights).for_each(|(bins, weight)| sums[coarse(bins)] += weight);
        let wanted = |bin: usize| target.counts.single[axis][bin] as f64 / target.total.max(1) as f64 * size;
        // A weight cannot fill a bin in which the set has no path.
        let factors: [f64; COARSE] =
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
pub fn best_of(candidates: &[Bins], target: &Target, size: usize, sets: usize) -> Distance {
    let mut draws = Draws(1);
    let mut set = || -> Vec<&Bins> { (0..size).map(|_| &candidates[draws.below(candidates.len())]).collect() };
    let distances = (0..sets).map(|_| Distance::of(set(), target));
    let nothing = Distance { single: f64::INFINITY, joint: f64::INFINITY };
    distances.fold(nothing, |best, distance| if distance.single < best.single { distance } else { best })
}

/// Returns the indices of the paths in the rarest bins, the rarest first: those with an attribute in a fine bin that few paths are
/// in.
pub fn rarest(candidates: &[Bins], most: usize) -> Vec<u32> {
    let mut counts = [[0u32; crate::schema::FINE]; AXES];
    for bins in candidates {
        counts.iter_mut().zip(bins).for_each(|(counts, bin)| counts[usize::from(*bin)] += 1);
    }
    let least = |bins: &Bins| counts.iter().zip(bins).map(|(counts, bin)| counts[usize::from(*bin)]).min();
    let mut all: Vec<(Option<u32>, u32)> = (0..).zip(candidates).map(|(place, bins)| (least(bins), place)).collect();
    all.sort_unstable();
    all.into_iter().take(most).map(|(_, place)| place).collect()
}
