//! Tests of unions in any order, grouping and number, and of totals.

use crate::synthetic::{self, ROUNDS, SEED, ends, is_bad, merge_parts, scope, task, tasks, tiles};
use femc_math::hash::combine;
use femc_paths::histogram::{Histograms, Table};
use femc_paths::octree::{Octree, Root};
use femc_paths::pixels::PixelMaps;
use femc_paths::statistics::{IMAGE_BITS, image_weight};
use femc_paths::{LightStatistics, MergeError, PathKey, Scope};
use femc_stats::testing::{sidak, z_test};

const KEEP: u32 = 900;

fn shuffled<T>(mut items: Vec<T>, seed: u64) -> Vec<T> {
    for at in (1..items.len()).rev() {
        items.swap(at, (combine(&[seed, at as u64]) % (at as u64 + 1)) as usize);
    }
    items
}

/// Returns the samples of the frame that the film accepts.
fn valid_samples(scope: &Scope) -> Vec<PathKey> {
    let pixels = 0..scope.film[0] * scope.film[1];
    let keys = pixels.flat_map(|pixel| (0..16).map(move |sample| PathKey { frame: 3, pixel, sample }));
    keys.filter(|key| !is_bad(*key)).collect()
}

#[test]
fn shards_in_any_order_and_repeated_tasks_give_equal_bytes() {
    let scope = scope(KEEP);
    let tasks = tasks(&scope);
    let expected = merge_parts(&scope, tasks.clone());
    assert_eq!(expected.paths.len(), KEEP as usize, "the pool is full, so the threshold has moved");
    let bytes = expected.encode();
    for (shards, seed) in [(1, 1), (2, 2), (16, 3), (16, 4), (45, 5)] {
        // A third of the tasks is done twice, by other shards.
        let again = tasks.iter().step_by(3).cloned();
        let all = shuffled(tasks.iter().cloned().chain(again).collect(), seed);
        let mut parts = vec![Vec::new(); shards];
        all.into_iter().enumerate().for_each(|(at, task)| parts[at % shards].push(task));
        let parts = parts.into_iter().map(|part| merge_parts(&scope, part));
        assert!(merge_parts(&scope, parts).encode() == bytes, "{shards} shards, order {seed}");
    }
    let mut twice = expected.clone();
    twice.merge(expected.clone()).unwrap();
    assert_eq!(twice, expected, "idempotent");
}

#[test]
fn unions_are_associative_and_commutative() {
    let scope = scope(40);
    let parts = [task(&scope, 1, 0..4), task(&scope, 2, 0..4), task(&scope, 1, 4..8)];
    let unite = |a: &LightStatistics, b: &LightStatistics| {
        let mut all = a.clone();
        all.merge(b.clone()).unwrap();
        all
    };
    let [a, b, c] = &parts;
    assert_eq!(unite(&unite(a, b), c), unite(a, &unite(b, c)));
    assert_eq!(unite(a, b), unite(b, a));
    assert_eq!(unite(a, &LightStatistics::new(scope, 0.5)), *a, "nothing is neutral");
}

#[test]
fn counted_samples_do_not_depend_on_the_division_into_tasks() {
    let scope = scope(KEEP);
    let whole = merge_parts(&scope, tasks(&scope)).into_image_samples(0, ends);
    let other: Vec<LightStatistics> = tiles(&scope)
        .flat_map(|tile| [0..1, 1..4, 4..6, 6..7, 7..8, 8..13, 13..16].map(|range| task(&scope, tile, range)))
        .collect();
    let other = merge_parts(&scope, shuffled(other, 6)).into_image_samples(0, ends);
    assert!(whole.encode() == other.encode());
    assert_eq!(whole.fireflies(), other.fireflies());
}

#[test]
fn totals_are_the_samples_and_histograms_those_of_the_subset() {
    let scope = scope(KEEP);
    let all = merge_parts(&scope, tasks(&scope));
    let counted = all.clone().into_image_samples(0, ends);
    assert_eq!(all.samples(), 36 * 20 * 16);
    assert_eq!(all.totals().invalid, (36 * 20 * 16 - valid_samples(&scope).len()) as u64);
    let counts = |key: &PathKey| key.sample < ends(scope.tile_of(key.pixel), key.half());
    let subset: Vec<PathKey> =
        valid_samples(&scope).into_iter().filter(|key| counts(key) && key.hash(SEED) < counted.threshold).collect();
    assert!((300..KEEP as usize).contains(&subset.len()), "{}", subset.len());
    assert_eq!(counted.threshold, all.threshold);
    assert!(counted.paths.keys().map(|(_, key)| *key).eq({
        let mut ordered = subset.clone();
        ordered.sort_by_key(|key| (key.hash(SEED), *key));
        ordered
    }));
    assert_eq!(counted.samples(), {
        let half = |tile, half| u64::from(ends(tile, half)).div_ceil(2) * scope.tile_area(tile);
        tiles(&scope).map(|tile| half(tile, 0) + half(tile, 1)).sum::<u64>()
    });
    for table in Table::ALL {
        let records = |path: &femc_paths::LightPath| match table {
            Table::Paths => 1,
            Table::Intersections => path.intersections.len(),
            Table::Lights => path.lights.len(),
        };
        let expected: usize = subset.iter().map(|key| records(&synthetic::path(&scope, *key))).sum();
        let histograms = Histograms::from_statistics(&counted, table);
        assert_eq!(histograms.pairs.len(), histograms.pair_names().count());
        for counts in histograms.attributes.iter().chain(&histograms.pairs) {
            assert_eq!(counts.samples.iter().sum::<u64>(), expected as u64, "{table:?}");
        }
        // The row and column sums of a pair are the histograms of its two attributes.
        let pair = &histograms.pairs[0];
        let row = |bin: usize| pair.samples[64 * bin..64 * bin + 64].iter().sum::<u64>();
        assert!((0..64).map(row).eq(histograms.attributes[0].samples.iter().copied()));
    }
}

#[test]
fn image_weights_sum_to_one_per_pixel_for_any_sample_counts() {
    for counts in [[1, 0], [0, 5], [1, 1], [3, 4], [8, 2], [1000, 999]] {
        let sum: u64 = (0..2).map(|half| counts[usize::from(half)] * image_weight(counts, half)).sum();
        let rounding = (counts[0] + counts[1]) / 2 + 1;
        assert!(sum.abs_diff(1 << IMAGE_BITS) <= rounding, "{counts:?}: {sum}");
    }
    let scope = scope(1 << 20);
    let mut all = LightStatistics::new(scope, 1.0);
    all.merge_all(tiles(&scope).map(|tile| synthetic::record_task(&scope, tile, 0..16, 1.0, |_, _| true))).unwrap();
    let histograms = Histograms::from_statistics(&all, Table::Paths);
    let image: u64 = histograms.attributes[0].image.iter().sum();
    let bad = all.totals().invalid as f64 / 16.0;
    let pixels = image as f64 / (1u64 << IMAGE_BITS) as f64;
    assert!((pixels - (36.0 * 20.0 - bad)).abs() < 1e-4, "{pixels}");
}

/// Checks that a choice of samples with the share `share` is fair: it has the expected number of pixels of either parity, of every
/// third column, and of either half. The chance of a false alarm is 1e-4 for three such tests.
pub(crate) fn is_fair(share: f64, chooses: impl Fn(PathKey) -> bool) -> bool {
    let classes = |key: PathKey| (key.pixel % 2 + 2 * (key.sample % 2) + 4 * (key.pixel % 3)) as usize;
    let mut counts = [[0u64; 2]; 12];
    for pixel in 0..1000 {
        for sample in 0..40 {
            let key = PathKey { frame: 2, pixel, sample };
            counts[classes(key)][usize::from(chooses(key))] += 1;
        }
    }
    counts.iter().all(|[no, yes]| {
        let all = (no + yes) as f64;
        let error = (share * (1.0 - share) / all).sqrt();
        z_test(*yes as f64 / all, error, share) > sidak(1e-4, 3 * 12)
    })
}

#[test]
fn the_subset_is_fair() {
    for (seed, share) in [(0, 0.5), (1, 0.1), (u64::MAX, 0.03)] {
        let statistics = LightStatistics::new(Scope { seed, ..scope(9) }, share);
        assert!(is_fair(share, |key| statistics.must_record(key)), "seed {seed}, share {share}");
    }
}

#[test]
fn parts_that_do_not_go_together_are_refused_and_change_nothing() {
    let scope = scope(40);
    let mut all = task(&scope, 1, 0..4);
    let before = all.clone();
    let clash = all.merge(task(&scope, 1, 2..6)).unwrap_err();
    assert!(matches!(clash, MergeError::Overlap(key) if (key.tile, key.begin) == (1, 2)), "{clash}");
    let mut other = task(&scope, 1, 0..4);
    other.portions.values_mut().for_each(|counters| counters.invalid += 1);
    assert!(matches!(all.merge(other), Err(MergeError::Conflict(_))));
    assert_eq!(all.merge(LightStatistics::new(synthetic::scope(41), 0.5)), Err(MergeError::Scope));
    assert_eq!(all, before);
}

#[test]
fn the_brightest_of_the_frame_are_those_of_its_portions() {
    let scope = scope(40);
    let counted = merge_parts(&scope, tasks(&scope)).into_image_samples(0, |_, _| 16);
    let mut all: Vec<f32> = valid_samples(&scope).iter().map(|key| synthetic::path(&scope, *key).luminance()).collect();
    all.sort_by(|a, b| b.total_cmp(a));
    let found: Vec<f32> = counted.fireflies().iter().map(|path| path.luminance()).collect();
    assert_eq!(found[0], all[0]);
    assert!(found.is_sorted_by(|a, b| a >= b) && found.len() <= 3 * 30);
    let deep = counted.bottlenecks();
    assert!(!deep.is_empty() && deep.iter().all(|path| path.depth >= 8));
}

#[test]
fn energy_of_disjoint_parts_adds_up_to_the_total_bit_exactly() {
    let scope = scope(1 << 20);
    let root = Root::around(scope.lower, scope.upper, 7);
    let all = merge_parts(&scope, tasks(&scope));
    let whole = Octree::from_paths(root, all.paths.values());
    let mut parts = Octree::new(root);
    for tile in tiles(&scope).rev() {
        let own = all.paths.values().filter(|path| scope.tile_of(path.key.pixel) == tile);
        parts.merge(&Octree::from_paths(root, own)).unwrap();
    }
    assert_eq!(parts, whole);
    assert_eq!(whole.outside, 0);
    let count = |level, bounce| whole.level(level, bounce).values().map(|voxel| voxel.count).sum::<u64>();
    let intersections: usize = all.paths.values().map(|path| path.intersections.len()).sum();
    for level in [0, 3, 7] {
        assert_eq!(count(level, None), intersections as u64);
        assert_eq!((0..80).map(|bounce| count(level, Some(bounce))).sum::<u64>(), intersections as u64);
    }
    assert_eq!(whole.level(0, None).len(), 1);
    let nothing = Octree::new(root);
    let energy = whole.level(4, Some(1));
    let difference = nothing.difference(&whole, 4, Some(1)).unwrap();
    assert!(difference.len() == energy.len() && energy.iter().all(|(code, voxel)| difference[code] == -voxel.mean()));
    assert!(whole.difference(&whole, 7, None).unwrap().values().all(|value| *value == 0.0));
    let elsewhere = Octree::new(Root::around(scope.lower, scope.upper, 6));
    assert!(parts.merge(&elsewhere).is_err() && whole.difference(&elsewhere, 3, None).is_err());
}

#[test]
fn a_pilot_and_halves_that_ended_earlier_do_not_count() {
    let scope = scope(KEEP);
    let all = merge_parts(&scope, tasks(&scope));
    let after = all.clone().into_image_samples(ROUNDS[0].end, |_, _| 16);
    assert_eq!(after.samples(), 36 * 20 * 12);
    assert!(after.paths.keys().all(|(_, key)| key.sample >= 4));
    let held = all.into_image_samples(0, ends);
    for records in [&held.paths, &held.brightest, &held.deepest] {
        assert!(records.keys().all(|(_, key)| key.sample < ends(scope.tile_of(key.pixel), key.half())));
    }
}

#[test]
fn maps_hold_all_counted_samples_and_tiles_own_their_pixels() {
    let scope = scope(KEEP);
    let mut all: Vec<u32> = tiles(&scope).flat_map(|tile| scope.tile_pixels(tile)).collect();
    assert!(tiles(&scope).all(|tile| scope.tile_pixels(tile).all(|pixel| scope.tile_of(pixel) == tile)));
    all.sort_unstable();
    assert!(all.into_iter().eq(0..36 * 20));
    let counted = merge_parts(&scope, shuffled(tasks(&scope), 8)).into_image_samples(0, ends);
    let maps = PixelMaps::from_statistics(&counted);
    assert_eq!((maps.film, maps.pixels().len()), ([36, 20], 36 * 20));
    let keys = valid_samples(&scope).into_iter().filter(|key| key.sample < ends(scope.tile_of(key.pixel), key.half()));
    let mut by_pixel = vec![Vec::new(); 36 * 20];
    keys.for_each(|key| by_pixel[key.pixel as usize].push(synthetic::path(&scope, key)));
    for (pixel, paths) in maps.pixels().zip(&by_pixel) {
        assert_eq!(pixel.samples, paths.len() as u64);
        let halves = [0, 1].map(|half| paths.iter().filter(|path| path.key.half() == half).collect::<Vec<_>>());
        let mean = |of: &dyn Fn(&femc_paths::LightPath) -> f64| {
            let there = halves.iter().filter(|half| !half.is_empty());
            let means = there.map(|half| half.iter().map(|path| of(path)).sum::<f64>() / half.len() as f64);
            means.clone().sum::<f64>() / means.count().max(1) as f64
        };
        let luminance = mean(&|path| f64::from(path.luminance()));
        assert!((pixel.luminance - luminance).abs() < 1e-5, "{pixel:?} {luminance}");
        assert_eq!(pixel.depth, mean(&|path| f64::from(path.depth)));
        let greatest = |path: &femc_paths::LightPath| path.throughput.into_iter().fold(0.0, f32::max);
        assert!((pixel.throughput - mean(&|path| f64::from(greatest(path)))).abs() < 2e-4);
    }
    let sum: f64 = maps.pixels().map(|pixel| pixel.variance).sum();
    assert!(sum > 0.0);
}

#[test]
fn full_histograms_hold_counted_samples_by_sample_and_by_image() {
    let scope = Scope { has_full_histograms: true, ..scope(KEEP) };
    let parts = shuffled(tasks(&scope), 9);
    let all = merge_parts(&scope, parts.clone());
    assert!(LightStatistics::decode(&all.encode()).is_ok_and(|read| read == all));
    let mut again = merge_parts(&scope, parts[..20].to_vec());
    again.merge(merge_parts(&scope, parts[10..].to_vec())).unwrap();
    assert!(again.encode() == all.encode());
    let counted = all.into_image_samples(0, ends);
    let counts = |key: &PathKey| key.sample < ends(scope.tile_of(key.pixel), key.half());
    let keys: Vec<PathKey> = valid_samples(&scope).into_iter().filter(counts).collect();
    let weight: u64 = keys.iter().map(|key| counted.image_weight(*key)).sum();
    for table in Table::ALL {
        let histograms = Histograms::attributes_of_all_samples(&counted, table).unwrap();
        assert_eq!(histograms.len(), table.attributes().len());
        let records = |key: &PathKey| match table {
            Table::Paths => 1,
            Table::Intersections => synthetic::path(&scope, *key).intersections.len() as u64,
            Table::Lights => synthetic::path(&scope, *key).lights.len() as u64,
        };
        let expected: u64 = keys.iter().map(records).sum();
        for counts in &histograms {
            assert_eq!(counts.samples.iter().sum::<u64>(), expected, "{table:?}");
        }
        if table == Table::Paths {
            assert!(histograms.iter().all(|counts| counts.image.iter().sum::<u64>() == weight));
            let depth =
                |depth: u32| keys.iter().filter(|key| synthetic::path(&scope, **key).depth == depth).count() as u64;
            assert!((0..9).all(|number| histograms[8].samples[number as usize] == depth(number)));
        }
    }
    // A sample missing from the histograms is detected.
    let mut damaged = counted.clone();
    let counters = damaged.portions.values_mut().next().unwrap();
    let bin = counters.bins.iter().position(|count| *count > 0).unwrap();
    counters.bins[bin] -= 1;
    assert!(LightStatistics::decode(&damaged.encode()).is_err());
    assert_eq!(
        Histograms::attributes_of_all_samples(
            &merge_parts(&synthetic::scope(KEEP), tasks(&synthetic::scope(KEEP))),
            Table::Paths
        ),
        None
    );
}
