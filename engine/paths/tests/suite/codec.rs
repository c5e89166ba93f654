//! Tests of statistics as bytes.

use crate::synthetic::{merge_parts, scope, task, tasks};
use femc_math::hash::combine;
use femc_paths::{LightStatistics, PathsError, Scope};

/// Recomputes the checksum.
fn with_checksum(mut bytes: Vec<u8>) -> Vec<u8> {
    let (front, body) = bytes.split_at_mut(28);
    front[12..28].copy_from_slice(&blake3::hash(body).as_bytes()[..16]);
    bytes
}

#[test]
fn statistics_round_trip_bit_exactly_through_bytes() {
    let scope = scope(900);
    for statistics in [
        LightStatistics::new(scope, 1.0),
        task(&scope, 14, 4..5),
        merge_parts(&scope, tasks(&scope)),
        merge_parts(&scope, tasks(&scope)).into_image_samples(4, |_, _| 8),
    ] {
        let bytes = statistics.encode();
        let again = LightStatistics::decode(&bytes).unwrap_or_else(|e| panic!("{e}"));
        assert!(again == statistics && again.encode() == bytes);
    }
}

/// A file of a program that did not split paths: 4 x 3 pixels of `scenes/cornell-fog.mgf`, 2 samples each.
#[test]
fn files_of_format_3_are_read_as_paths_without_branches() {
    let bytes = include_bytes!("../data/format-3.paths");
    let old = LightStatistics::decode(bytes).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(old.paths.len(), 24);
    for path in old.paths.values() {
        assert!(path.is_valid() && path.depth as usize == path.intersections.len());
        assert!((0..).zip(&path.intersections).all(|(index, it)| it.parent == index));
        assert!(path.lights.iter().all(|light| light.vertex == light.order));
        let sum: f32 = path.lights.iter().map(|light| light.radiance[1]).sum();
        assert!((sum - path.radiance[1]).abs() <= 1e-5 * sum, "{sum} {path:?}");
    }
    assert_eq!(LightStatistics::decode(&old.encode()).as_ref(), Ok(&old));
}

#[test]
fn any_damage_is_an_error() {
    let bytes = task(&scope(20), 1, 0..2).encode();
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        assert!(LightStatistics::decode(&damaged).is_err(), "byte {at}");
        assert!(LightStatistics::decode(&bytes[..at]).is_err(), "the first {at} bytes");
    }
    let mut newer = bytes.clone();
    newer[8] = 5;
    assert_eq!(LightStatistics::decode(&newer), Err(PathsError::Version { found: 5, expected: 4 }));
    let mut bins = bytes.clone();
    bins[28] = 9;
    assert_eq!(LightStatistics::decode(&with_checksum(bins)), Err(PathsError::Schema { found: 9, expected: 1 }));
}

#[test]
fn bytes_with_a_right_checksum_are_refused_or_hold_all_laws() {
    assert_refused_or_valid(&task(&scope(20), 1, 0..2));
    assert_refused_or_valid(&task(&Scope { has_full_histograms: true, ..scope(20) }, 1, 0..2));
}

fn assert_refused_or_valid(seed: &LightStatistics) {
    let bytes = seed.encode();
    const FRONT: usize = 28 + 4 + 8 + 28 + 48 + 8 + 28;
    let tables = zstd::bulk::decompress(&bytes[FRONT + 8..], 1 << 20).unwrap();
    let mut accepted = 0;
    for trial in 0..4000u64 {
        let (mut front, mut tables) = (bytes[..FRONT].to_vec(), tables.clone());
        let place = combine(&[trial, 1]) as usize;
        let value = combine(&[trial, 2]) as u8;
        let damaged = if trial % 3 == 0 { &mut front[28..] } else { &mut tables[..] };
        let at = place % damaged.len();
        damaged[at] = value;
        if trial % 5 == 0 {
            tables.truncate(place % tables.len());
        }
        let compressed = zstd::bulk::compress(&tables, 1).unwrap();
        let all = [&front[..], &(tables.len() as u64).to_le_bytes(), &compressed].concat();
        if let Ok(read) = LightStatistics::decode(&with_checksum(all)) {
            accepted += 1;
            let mut settled = read.clone();
            settled.trim();
            assert_eq!(settled, read);
            assert!(LightStatistics::decode(&read.encode()).is_ok_and(|again| again == read));
        }
    }
    assert!(accepted > 10 && accepted < 3000, "{accepted} of 4000");
}
