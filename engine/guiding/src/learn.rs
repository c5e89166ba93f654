//! Learning of a frame's targets from pilot paths.
//!
//! Pilot paths belong to no image. Their numbers depend only on the frame's scene and view, so all tasks and restarts of a frame
//! have the same targets. They run in rounds. After each round but the last, openings are searched where directions lead to more
//! light than the field expects ([`find_openings`]). After the second round, bright patches are searched ([`find_patches`]). After
//! each round, the shares of the targets are fitted to the light that directions found ([`Shares`]).

use crate::openings::{Line, Opening, find_openings};
use crate::patches::{Patch, Reached, find_patches, leaf_bins};
use crate::pilot::{MAX_DIRECTIONS, Passing, Pilot, PilotPlaces, keep_heaviest, trace_block};
use crate::shares::Shares;
use crate::sums::PositionGrid;
use femc_field::{Field, PACK_TARGETS, Parallelogram, RegionTargets, Target, TargetGuide, TargetPack};
use femc_montecarlo::Guidance;
use femc_prepared::Prepared;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of pilot paths by round, for films that are not small.
const PATHS: [u32; 3] = [1 << 14, 1 << 15, 1 << 16];
/// Maximum number of pilot paths for each pixel. More would cost more than the samples of a small film.
const MAX_PATHS_PER_PIXEL: u64 = 64;
/// Maximum number of pilot paths of a frame.
const MAX_PATHS: u32 = PATHS[0] + PATHS[1] + PATHS[2];
/// Number of blocks of a round.
const BLOCKS: u32 = 16;
/// Minimum and maximum number of surprising lines of a search.
const MIN_LINES: usize = 8;
const MAX_LINES: usize = 96;
/// Ratio of the edges of a target from which on it is divided.
const LONG: f32 = 2.0;

/// Estimate of the most memory that learning takes, bytes: that of the directions of a round, if all blocks have as many as they can,
/// and of the sums of as many places.
pub const MAX_BYTES: u64 = BLOCKS as u64 * MAX_DIRECTIONS as u64 * 256;

/// Targets of a frame, and how they were found.
#[derive(Clone, Debug, Default)]
pub struct Learned {
    /// Openings in the order in which they were found.
    pub openings: Vec<Opening>,
    /// Bright patches in the order in which they were found.
    pub patches: Vec<Patch>,
    /// Share of the indirect light of the picture that passes through each opening, then that which comes from each patch, in 0..1.
    pub light: Vec<f32>,
    /// Openings and patches, or parts of them: the pack that paths sample.
    pub parts: Vec<Target>,
    /// Targets by region.
    pub by_region: Vec<RegionTargets>,
    /// Index of the region by leaf of the field.
    pub region_by_leaf: Vec<u32>,
    /// Number of pilot paths.
    pub paths: u32,
    /// Number of rays of pilot paths.
    pub rays: u64,
}

/// Learns the targets of a frame. If the first rounds find no targets, the last one is left out. `None`: `cancel` was set.
/// - `field`: field of the frame, scaled to its brightness.
pub fn learn(scene: &Prepared, field: &Field, cancel: &AtomicBool) -> Option<Learned> {
    let mut out = Learned::default();
    if field.leaves.is_empty() {
        return Some(out);
    }
    // During learning, each leaf is a region.
    let mut guide = TargetGuide::without_targets(field);
    let grid = PositionGrid::new(scene.world.bounds());
    let places = PilotPlaces { bins: leaf_bins(field, &grid), grid };
    let mut pieces = Pieces::default();
    let mut shares = Shares::default();
    let round_paths = paths_by_round(scene.camera.film);
    for (round, &paths) in round_paths.iter().enumerate() {
        let guidance = Guidance::new(scene, field).with_targets(scene, &guide);
        let targets = out.targets();
        let blocks = (0..BLOCKS).into_par_iter().map(|block| {
            let first = round_paths[..round].iter().sum::<u32>();
            let [low, high] = [block, block + 1].map(|at| first + paths / BLOCKS * at);
            let pilot = Pilot::new(&guide, &places, &targets);
            (!cancel.load(Ordering::Relaxed)).then(|| trace_block(scene, guidance, pilot, low..high, paths))
        });
        let blocks: Option<Vec<Pilot<'_>>> = blocks.collect();
        let (mut records, mut reached) = (Vec::new(), Reached::default());
        let (mut lines, mut passing) = (Vec::new(), Passing::default());
        for block in blocks? {
            records.extend(block.records);
            passing.add(&block.passing);
            reached.add(&block.bins, &block.voxels);
            lines.extend(block.lines);
            out.rays += block.rays;
        }
        out.paths += paths;
        let mut is_last = round + 1 == PATHS.len();
        if !is_last && lines.len() >= MIN_LINES {
            keep_heaviest(&mut lines, MAX_LINES);
            let lines: Vec<Line> = lines.into_iter().map(|(line, _)| line).collect();
            let known: Vec<Parallelogram> = out.openings.iter().map(|opening| opening.target).collect();
            out.openings.extend(find_openings(scene, &lines, &known, PACK_TARGETS - targets.len()));
        }
        shares = Shares::new(field, records, &shares);
        if !is_last {
            // Light through openings must not count as light of patches, so openings come first.
            if round > 0 {
                out.patches = find_patches(field, &grid, &reached, PACK_TARGETS - out.openings.len());
            }
            let new = out.targets();
            // Without targets, more paths have nothing to learn.
            is_last = round > 0 && new.is_empty();
            if new.len() > targets.len() {
                let divided = Pieces::new(&new);
                shares.replace(&pieces.wholes, &divided.wholes, targets.len()..new.len());
                pieces = divided;
            }
        }
        let is_patch = |k: usize| pieces.wholes.get(k).is_some_and(|whole| *whole >= out.openings.len());
        let (by_region, region_by_leaf) = shares.regions(field.leaves.len(), is_patch);
        if is_last {
            (out.light, out.parts) = (passing.shares(targets.len()), pieces.targets);
            (out.by_region, out.region_by_leaf) = (by_region, region_by_leaf);
            break;
        }
        let by_leaf = region_by_leaf.iter().map(|&region| by_region[region as usize]).collect();
        guide.set_targets(packs(&pieces.targets), by_leaf);
    }
    Some(out)
}

/// Returns the packs of all targets: one or none.
pub(crate) fn packs(targets: &[Target]) -> Vec<TargetPack> {
    if targets.is_empty() { Vec::new() } else { vec![TargetPack::new(targets)] }
}

/// Returns the number of pilot paths of a frame with targets, for a film of this size in pixels.
pub fn pilot_path_count(film: [u32; 2]) -> u32 {
    paths_by_round(film).iter().sum()
}

/// Returns the number of pilot paths by round for a film, a multiple of the number of blocks.
fn paths_by_round(film: [u32; 2]) -> [u32; 3] {
    let pixels = film.map(u64::from).iter().product::<u64>();
    let most = (MAX_PATHS_PER_PIXEL * pixels).min(MAX_PATHS.into());
    PATHS.map(|paths| (u64::from(paths) * most / u64::from(MAX_PATHS)) as u32 / BLOCKS * BLOCKS)
}

impl Learned {
    /// Returns the guide of paths by these targets.
    /// - `field`: field of the frame.
    pub fn guide(&self, field: &Field) -> TargetGuide {
        TargetGuide::new(field, packs(&self.parts), self.by_region.clone(), &self.region_by_leaf)
    }

    /// Returns the targets: openings, then patches.
    fn targets(&self) -> Vec<Target> {
        let openings = self.openings.iter().map(|opening| opening.target.into());
        openings.chain(self.patches.iter().map(|patch| patch.target)).collect()
    }
}

/// Parts of openings and patches. From a point near a long one, its parts bring different light.
#[derive(Default)]
struct Pieces {
    targets: Vec<Target>,
    /// Number of the whole by part.
    wholes: Vec<usize>,
}

impl Pieces {
    /// Divides targets until there are as many as a pack has, the longest for their width first.
    fn new(wholes: &[Target]) -> Self {
        let mut counts = vec![1u32; wholes.len()];
        // Ratio of the edges of a part.
        let ratio = |counts: &[u32], k: usize| {
            let Target::Parallelogram(whole) = wholes[k] else { return 1.0 };
            let [a, b] = whole.edges.map(|edge| edge.length());
            a.max(b) / counts[k] as f32 / a.min(b)
        };
        while counts.iter().sum::<u32>() < PACK_TARGETS as u32 {
            let longest =
                (0..counts.len()).fold(0, |best, k| if ratio(&counts, k) > ratio(&counts, best) { k } else { best });
            if counts.is_empty() || ratio(&counts, longest) <= LONG {
                break;
            }
            counts[longest] += 1;
        }
        let mut out = Self::default();
        for (k, (whole, &count)) in wholes.iter().zip(&counts).enumerate() {
            out.wholes.extend(std::iter::repeat_n(k, count as usize));
            let &Target::Parallelogram(Parallelogram { corner, edges }) = whole else {
                out.targets.push(*whole);
                continue;
            };
            let longer = usize::from(edges[1].length() > edges[0].length());
            let step = edges[longer] / count as f32;
            for part in 0..count {
                let mut target = Parallelogram { corner: corner + step * part as f32, edges };
                target.edges[longer] = step;
                out.targets.push(target.into());
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_field::Ball;
    use femc_math::glam::Vec3A;

    #[test]
    fn small_films_have_fewer_pilot_paths() {
        assert_eq!(paths_by_round([1920, 1080]), PATHS);
        assert_eq!(paths_by_round([48, 48]), PATHS);
        assert_eq!(paths_by_round([8, 8]), [576, 1168, 2336]);
        assert_eq!(paths_by_round([0, 8]), [0; 3]);
    }

    #[test]
    fn long_targets_are_divided_until_the_pack_is_full() {
        let slit = Parallelogram { corner: Vec3A::ZERO, edges: [Vec3A::X * 0.05, Vec3A::Z * 2.0] };
        let window = Parallelogram { corner: Vec3A::ONE, edges: [Vec3A::X * 0.9, Vec3A::Y] };
        let Pieces { targets, wholes } = Pieces::new(&[slit.into(), window.into()]);
        assert_eq!(wholes, [0, 0, 0, 0, 0, 0, 0, 1]);
        assert_eq!(targets[7], window.into());
        let parts: Vec<Parallelogram> = targets.iter().filter_map(Target::parallelogram).take(7).collect();
        let area: f32 = parts.iter().map(Parallelogram::area).sum();
        assert!((area / slit.area() - 1.0).abs() < 1e-5 && parts[6].corner.z > 1.7, "{targets:?}");
        // A part of less than twice its width stays.
        let short = Parallelogram { edges: [Vec3A::X, Vec3A::Z * 3.0], ..slit };
        assert_eq!(Pieces::new(&[short.into()]).wholes, [0, 0]);
        let ball = Target::from(Ball { center: Vec3A::ZERO, radius: 0.1 });
        assert_eq!(Pieces::new(&[ball, short.into()]).wholes, [0, 1, 1]);
        assert!(Pieces::new(&[]).targets.is_empty());
    }
}
