//! Exchanges against the definition of the distance. The definition here has its own histograms and rational numbers, and calls
//! nothing of the module.

use super::*;
use std::collections::BTreeMap;

/// Deterministic numbers.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, count: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % count
    }
}

/// Returns paths whose attributes depend on their neighbors, in few bins, so that paths of an exchange share many.
fn paths(count: usize, numbers: &mut Numbers) -> Vec<PathBins> {
    let path = |numbers: &mut Numbers| {
        let mut bin = numbers.below(60) as u8;
        std::array::from_fn(|_| {
            if numbers.below(3) > 0 {
                bin = (u64::from(bin) + numbers.below(20)).min(63) as u8;
            } else {
                bin = numbers.below(64) as u8;
            }
            bin.min(crate::schema::FINE_BINS as u8 - 1)
        })
    };
    (0..count).map(|_| path(numbers)).collect()
}

/// Counts of a set by attribute and bin, and by pair of neighbors and bins.
type Histogram = BTreeMap<(usize, u8, Option<u8>), i64>;

fn histogram<'a>(paths: impl IntoIterator<Item = &'a PathBins>) -> Histogram {
    let mut out = Histogram::new();
    for bins in paths {
        let coarse: Vec<u8> = bins.iter().zip(&PATH_ATTRIBUTES).map(|(bin, it)| it.scale.coarse(*bin)).collect();
        for (axis, bin) in coarse.iter().enumerate() {
            *out.entry((axis, *bin, None)).or_default() += 1;
        }
        for (axis, pair) in coarse.windows(2).enumerate() {
            *out.entry((axis, pair[0], Some(pair[1]))).or_default() += 1;
        }
    }
    out
}

/// Returns D and DJ of a set, each times the number of all paths and the number of the set's, as whole numbers.
fn definition(set: &Histogram, size: i64, all: &Histogram, total: i64) -> [i64; 2] {
    let mut sums = [0; 2];
    let mut keys: Vec<_> = set.keys().chain(all.keys()).collect();
    keys.sort_unstable();
    keys.dedup();
    for key in keys {
        let [n, m] = [set, all].map(|counts| counts.get(key).copied().unwrap_or(0));
        sums[usize::from(key.2.is_some())] += (m * size - n * total).abs();
    }
    sums
}

/// All candidates are a power of two times the members, so residuals in units are exact. Then each change that an exchange claims is
/// the change of the definition, and each step lowers it.
#[test]
fn a_claimed_change_is_the_change_of_the_definition() {
    let mut numbers = Numbers(7);
    for (size, pool, total) in [(16, 64, 256), (32, 96, 512), (8, 40, 128)] {
        let all = paths(total, &mut numbers);
        let coarse: Vec<CoarseBins> = all.iter().take(pool).map(coarse_bins).collect();
        let target = Target::from_paths(&all);
        let whole = histogram(&all);
        let mut members: Vec<usize> = (0..size).collect();
        let mut residuals = Residuals::new(&target, size);
        members.iter().for_each(|at| residuals.add(&coarse[*at], 1));
        let distance = |members: &[usize]| {
            let [single, joint] =
                definition(&histogram(members.iter().map(|at| &all[*at])), size as i64, &whole, total as i64);
            single + joint
        };
        let (mut kept, mut shared) = (0, 0);
        for _ in 0..600 {
            let place = numbers.below(size as u64) as usize;
            let (out, new) = (members[place], numbers.below(pool as u64) as usize);
            if members.contains(&new) {
                continue;
            }
            let [lost, won] = [(&residuals.if_removed, out), (&residuals.if_added, new)]
                .map(|(table, at)| total_change(table, &coarse[at]));
            let correction = residuals.shared_correction(&coarse[out], &coarse[new]);
            let claimed = i64::from(lost + won - correction);
            let mut after = members.clone();
            after[place] = new;
            let change = distance(&after) - distance(&members);
            // A path is `UNIT` in the residuals, and the number of all paths in the definition.
            assert_eq!(claimed * total as i64, change * UNIT, "{size} of {total}: {out} for {new}");
            shared += u32::from(correction != 0);
            if claimed < 0 || kept < 20 {
                residuals.add(&coarse[out], -1);
                residuals.add(&coarse[new], 1);
                members = after;
                kept += 1;
            }
        }
        assert!(kept > 20 && shared > 60, "{kept} exchanges, {shared} of paths that share bins");
    }
}

/// The stated distance of a chosen set is the definition's, and no run ends further away than it began.
#[test]
fn a_chosen_set_has_the_distance_of_the_definition() {
    let mut numbers = Numbers(11);
    for (size, pool, total) in [(50, 400, 3000), (20, 21, 777), (7, 300, 300), (40, 40, 40)] {
        let all = paths(total, &mut numbers);
        let target = Target::from_paths(&all);
        let found = choose_representative(&all[..pool], &target, size);
        let whole = histogram(&all);
        let stated = |chosen: &mut dyn Iterator<Item = &PathBins>| {
            let sums = definition(&histogram(chosen), size as i64, &whole, total as i64);
            sums.map(|sum| sum as f64 / (size * total) as f64)
        };
        let [single, joint] = stated(&mut found.chosen.iter().map(|at| &all[*at as usize]));
        let Distance { single: d, joint: dj } = found.distance;
        assert!((d - single).abs() < 1e-9 && (dj - joint).abs() < 1e-9, "{d} {dj} for {single} {joint}");
        assert!(found.chosen.is_sorted_by(|a, b| a < b) && found.chosen.len() == size, "{:?}", found.chosen);
        let [first, first_joint] = stated(&mut all[..size].iter());
        assert!(d + dj <= first + first_joint + 1e-9, "{d} + {dj} from {first} + {first_joint}");
        assert!(pool < 2 * size || d + dj < 0.9 * (first + first_joint), "{d} + {dj} from {first} + {first_joint}");
    }
}

/// Each exchange of a real run lowers the distance of the definition by what it claims.
#[test]
fn every_exchange_of_a_run_lowers_the_distance_as_claimed() {
    for (seed, size, total, pool) in [(13, 32, 512, 256), (17, 64, 256, 128), (19, 8, 128, 128)] {
        let all = paths(total, &mut Numbers(seed));
        let (target, whole) = (Target::from_paths(&all), histogram(&all));
        let coarse: Vec<CoarseBins> = all.iter().map(coarse_bins).collect();
        let mut places: Vec<u32> = (0..pool).collect();
        let (members, others) = places.split_at_mut(size);
        let distance = |members: &[u32]| {
            let set = histogram(members.iter().map(|at| &all[*at as usize]));
            definition(&set, size as i64, &whole, total as i64).iter().sum::<i64>()
        };
        let (running, mut distances) = (AtomicBool::new(false), vec![distance(members)]);
        let first = distances[0];
        let check = &mut CancelCheck::new(&running);
        let exchanged = |members: &[u32], change: i32| {
            let (before, now) = (distances[distances.len() - 1], distance(members));
            assert_eq!(i64::from(change) * total as i64, (now - before) * UNIT, "{seed}, number {}", distances.len());
            assert!(now < before, "{seed}: {now} after {before}");
            distances.push(now);
        };
        exchange(&coarse, [members, others], &target, check, exchanged).expect("the flag is never set");
        assert!(distances.len() > 5, "{seed}: {} exchanges", distances.len());
        assert!(10 * distances[distances.len() - 1] < 9 * first, "{seed}: {distances:?}");
        places.sort_unstable();
        assert!(places.into_iter().eq(0..pool), "{seed}: a path was lost or doubled");
    }
}
