//! Learning of a frame's targets from pilot paths.
//!
//! Pilot paths belong to no image. Their numbers depend only on the frame's scene and view, so all tasks and restarts of a frame
//! have the same targets. They run in rounds. After each round but the last, openings are searched where directions lead to more
//! light than the field expects ([`find_openings`]). After each round, the shares of the targets follow the light that directions
//! toward them found.

use crate::openings::{Line, Opening, find_openings};
use crate::patches::{Patch, find_patches};
use crate::pilot::{Pilot, keep_heaviest, trace_block};
use crate::shares::Shares;
use crate::sums::{SumsByPlace, SumsByRegion};
use femc_field::{Field, PACK_TARGETS, Target, TargetGuide, TargetPack};
use femc_montecarlo::Guidance;
use femc_prepared::Prepared;
use rayon::prelude::*;

/// Number of pilot paths by round.
const PATHS: [u32; 3] = [1 << 14, 1 << 15, 1 << 16];
/// Number of blocks of a round.
const BLOCKS: u32 = 16;
/// Minimum and maximum number of surprising lines of a search.
const MIN_LINES: usize = 8;
const MAX_LINES: usize = 96;
/// Minimum share of openings in surprising light for [`learn_openings`].
const MIN_OPENING_SHARE: f32 = 0.7;
/// Ratio of the edges of a target from which on it is divided.
const LONG: f32 = 2.0;

/// Targets of a frame, and how they were found.
#[derive(Clone, Debug, Default)]
pub struct Learned {
    /// Targets and shares.
    pub guide: TargetGuide,
    /// Openings in the order in which they were found.
    pub openings: Vec<Opening>,
    /// Bright patches in the order in which they were found.
    pub patches: Vec<Patch>,
    /// Number of pilot paths.
    pub paths: u32,
    /// Number of rays of pilot paths.
    pub rays: u64,
}

/// Learns the targets of a frame.
/// - `field`: field of the frame, scaled to its brightness.
pub fn learn(scene: &Prepared, field: &Field) -> Learned {
    learn_if(scene, field, |_| true).unwrap_or_default()
}

/// Learns the targets of a frame if most of the light that surprises comes through openings. `None`: it does not. Then only the
/// first round of pilot paths was traced.
/// - `field`: field of the frame, scaled to its brightness.
pub fn learn_openings(scene: &Prepared, field: &Field) -> Option<Learned> {
    learn_if(scene, field, |openings| openings.iter().map(|it| it.share).sum::<f32>() >= MIN_OPENING_SHARE)
}

/// Learns the targets of a frame.
/// - `is_worthwhile`: condition for the openings of the first round; without it, the result is `None`.
fn learn_if(scene: &Prepared, field: &Field, is_worthwhile: impl Fn(&[Opening]) -> bool) -> Option<Learned> {
    let mut out = Learned::default();
    if field.leaves.is_empty() {
        return None;
    }
    let leaves: Vec<u32> = (0..field.leaves.len() as u32).collect();
    // During learning, each leaf is a region.
    out.guide = TargetGuide::new(field, Vec::new(), Vec::new(), &leaves);
    let mut pieces = Pieces::default();
    let mut shares = Shares::default();
    for (round, &paths) in PATHS.iter().enumerate() {
        let guidance = Guidance::new(scene, field).with_targets(scene, &out.guide);
        let blocks = (0..BLOCKS).into_par_iter().map(|block| {
            let first = PATHS[..round].iter().sum::<u32>();
            let [low, high] = [block, block + 1].map(|at| first + paths / BLOCKS * at);
            trace_block(scene, guidance, &out.guide, low..high, paths)
        });
        let blocks: Vec<Pilot<'_>> = blocks.collect();
        let (mut sums, mut places) = (SumsByRegion::new(), SumsByPlace::new());
        let mut lines = Vec::new();
        for block in blocks {
            block.sums.iter().for_each(|(&region, more)| sums.entry(region).or_default().add(more));
            for (&region, more) in &block.places {
                let sums = places.entry(region).or_default();
                *sums = sums.with(more);
            }
            lines.extend(block.lines);
            out.rays += block.rays;
        }
        out.paths += paths;
        let is_last = round + 1 == PATHS.len();
        let targets = out.targets();
        if !is_last && lines.len() >= MIN_LINES {
            keep_heaviest(&mut lines, MAX_LINES);
            let lines: Vec<Line> = lines.into_iter().map(|(line, _)| line).collect();
            out.openings.extend(find_openings(scene, &lines, &targets, PACK_TARGETS - targets.len()));
        }
        if round == 0 && !is_worthwhile(&out.openings) {
            return None;
        }
        shares = Shares::new(field, &sums, &shares);
        if !is_last {
            // Light through openings must not count as light of patches, so openings come first.
            if round > 0 {
                out.patches = find_patches(field, &places, PACK_TARGETS - out.openings.len());
            }
            let new = out.targets();
            if new.len() > targets.len() {
                let divided = Pieces::new(&new);
                shares.replace(&pieces.wholes, &divided.wholes, targets.len()..new.len());
                pieces = divided;
            }
        }
        let packs = if pieces.targets.is_empty() { Vec::new() } else { vec![TargetPack::new(&pieces.targets)] };
        let is_patch = |k: usize| pieces.wholes.get(k).is_some_and(|whole| *whole >= out.openings.len());
        let (by_region, region_by_leaf) = shares.regions(leaves.len(), is_patch);
        if is_last {
            out.guide = TargetGuide::new(field, packs, by_region, &region_by_leaf);
        } else {
            let by_leaf = region_by_leaf.iter().map(|&region| by_region[region as usize]).collect();
            out.guide.set_targets(packs, by_leaf);
        }
    }
    Some(out)
}

impl Learned {
    /// Returns the targets: openings, then patches.
    fn targets(&self) -> Vec<Target> {
        let openings = self.openings.iter().map(|opening| opening.target);
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
            let [a, b] = wholes[k].edges.map(|edge| edge.length());
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
        for (k, (&Target { corner, edges }, &count)) in wholes.iter().zip(&counts).enumerate() {
            let longer = usize::from(edges[1].length() > edges[0].length());
            let step = edges[longer] / count as f32;
            for part in 0..count {
                let mut target = Target { corner: corner + step * part as f32, edges };
                target.edges[longer] = step;
                out.targets.push(target);
                out.wholes.push(k);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::glam::Vec3A;

    #[test]
    fn long_targets_are_divided_until_the_pack_is_full() {
        let slit = Target { corner: Vec3A::ZERO, edges: [Vec3A::X * 0.05, Vec3A::Z * 2.0] };
        let window = Target { corner: Vec3A::ONE, edges: [Vec3A::X * 0.9, Vec3A::Y] };
        let Pieces { targets, wholes } = Pieces::new(&[slit, window]);
        assert_eq!(wholes, [0, 0, 0, 0, 0, 0, 0, 1]);
        assert_eq!(targets[7], window);
        let area: f32 = targets[..7].iter().map(Target::area).sum();
        assert!((area / slit.area() - 1.0).abs() < 1e-5 && targets[6].corner.z > 1.7, "{targets:?}");
        // A part of less than twice its width stays.
        assert_eq!(Pieces::new(&[Target { edges: [Vec3A::X, Vec3A::Z * 3.0], ..slit }]).wholes, [0, 0]);
        assert!(Pieces::new(&[]).targets.is_empty());
    }
}
