//! Bugs planted in the synthetic renderer and the union. The invariants must detect each of them.

use crate::invariants::is_fair;
use crate::synthetic::{ends, merge_parts, path, record_task, scope, task, tasks, tiles};
use femc_paths::histogram::{Histograms, Table};
use femc_paths::{LightStatistics, PathKey, schema};

/// Checks the invariants of statistics: encoding and decoding must not change them.
fn is_consistent(statistics: &LightStatistics) -> bool {
    LightStatistics::decode(&statistics.encode()).is_ok_and(|read| read == *statistics)
}

#[test]
fn a_record_that_is_counted_twice_is_found() {
    let scope = scope(900);
    let mut all = task(&scope, 1, 0..4);
    assert!(is_consistent(&all));
    // The sample is counted twice.
    let key = all.paths.first_key_value().unwrap().0.1;
    let portion = all.portion_of(key).unwrap();
    let sample = path(&scope, key);
    all.portions.get_mut(&portion).unwrap().count(sample.luminance(), sample.depth, sample.end);
    assert!(!is_consistent(&all), "the counters say more samples than there are");
    // A task arrives again as another task, as with a union without keys.
    let mut twice = merge_parts(&scope, tasks(&scope));
    assert!(twice.merge(task(&scope, 4, 0..8)).is_err(), "the samples are there in two portions");
}

#[test]
fn a_subset_by_the_parity_of_pixels_is_found() {
    assert!(!is_fair(0.5, |key| key.pixel % 2 == 0));
    assert!(!is_fair(0.5, |key| key.sample % 2 == 0));
    let scope = scope(900);
    let planted =
        record_task(&scope, 1, 0..4, 0.5, |statistics, key| key.pixel % 2 == 0 && statistics.must_record(key));
    let expected = task(&scope, 1, 0..4);
    assert!(planted.paths.len() < expected.paths.len(), "records below the threshold are missing");
}

#[test]
fn a_pool_that_is_cut_by_arrival_is_found() {
    // A pool that keeps records in order of arrival until it is full.
    let cut = |parts: Vec<LightStatistics>| {
        let mut kept = Vec::<(u64, PathKey)>::new();
        for part in parts {
            let room = 900 - kept.len();
            kept.extend(part.paths.into_keys().take(room));
        }
        kept.sort_unstable();
        kept
    };
    let scope = scope(900);
    let mut parts = tasks(&scope);
    let (forward, expected) = (cut(parts.clone()), merge_parts(&scope, parts.clone()));
    parts.reverse();
    assert_ne!(forward, cut(parts.clone()), "it depends on the order");
    assert_ne!(forward, expected.paths.keys().copied().collect::<Vec<_>>());
    assert_eq!(merge_parts(&scope, parts), expected);
}

#[test]
fn a_bin_edge_that_is_off_by_one_is_found() {
    // Each edge belongs to the bin that begins there. With `>` for `>=` it would not.
    for bin in 2..64 {
        let edge = schema::radiance_edge(bin) as f32;
        let planted = schema::radiance_bin(edge.next_down());
        assert!(schema::radiance_bin(edge) == bin && planted == bin - 1);
    }
    // The totals of bins equal those of the numbers themselves.
    let scope = scope(1 << 20);
    let all = merge_parts(&scope, tasks(&scope));
    let depths = &Histograms::from_statistics(&all, Table::Paths).attributes[8].samples;
    let of = |depth: u32| all.paths.values().filter(|path| path.depth == depth).count() as u64;
    assert!((0..20).all(|depth| depths[depth as usize] == of(depth)));
    assert!((0..20).any(|depth| depths[depth as usize] != of(depth + 1)), "what is off by one differs");
}

#[test]
fn a_held_sample_that_is_counted_is_found() {
    let scope = scope(900);
    let all = merge_parts(&scope, tasks(&scope));
    let expected: u64 = tiles(&scope)
        .flat_map(|tile| [0, 1].map(|half| u64::from(ends(tile, half)).div_ceil(2) * scope.tile_area(tile)))
        .sum();
    assert_eq!(all.clone().into_image_samples(0, ends).samples(), expected);
    // Both halves end with their tile.
    let planted = all.clone().into_image_samples(0, |tile, _| ends(tile, 0).max(ends(tile, 1)));
    assert_ne!(planted.samples(), expected);
    // A record of a portion that was removed.
    let mut counted = all.clone().into_image_samples(0, ends);
    let held = all.paths.iter().find(|(_, path)| counted.portion_of(path.key).is_none()).unwrap();
    counted.paths.insert(*held.0, held.1.clone());
    assert!(!is_consistent(&counted));
}
