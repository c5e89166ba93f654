//! Tests of statistics as bytes.

use crate::world::{scope, task, tasks, united};
use femc_math::hash::combine;
use femc_paths::{PathsError, Scope, Statistics};

/// Recomputes the checksum.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let (front, body) = bytes.split_at_mut(28);
    front[12..28].copy_from_slice(&blake3::hash(body).as_bytes()[..16]);
    bytes
}

#[test]
fn statistics_round_trip_bit_exactly_through_bytes() {
    let scope = scope(900);
    for statistics in [
        Statistics::new(scope, 1.0),
        task(&scope, 14, 4..5),
        united(&scope, tasks(&scope)),
        united(&scope, tasks(&scope)).counted(4, |_, _| 8),
    ] {
        let bytes = statistics.encode();
        let again = Statistics::decode(&bytes).unwrap_or_else(|e| panic!("{e}"));
        assert!(again == statistics && again.encode() == bytes);
    }
}

#[test]
fn any_damage_is_an_error() {
    let bytes = task(&scope(20), 1, 0..2).encode();
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        assert!(Statistics::decode(&damaged).is_err(), "byte {at}");
        assert!(Statistics::decode(&bytes[..at]).is_err(), "the first {at} bytes");
    }
    let mut newer = bytes.clone();
    newer[8] = 4;
    assert_eq!(Statistics::decode(&newer), Err(PathsError::Version { found: 4, expected: 3 }));
    let mut bins = bytes.clone();
    bins[28] = 9;
    assert_eq!(Statistics::decode(&sealed(bins)), Err(PathsError::Schema { found: 9, expected: 1 }));
}

#[test]
fn bytes_with_a_right_checksum_are_refused_or_hold_all_laws() {
    is_refused_or_sound(&task(&scope(20), 1, 0..2));
    is_refused_or_sound(&task(&Scope { is_full: true, ..scope(20) }, 1, 0..2));
}

fn is_refused_or_sound(seed: &Statistics) {
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
        if let Ok(read) = Statistics::decode(&sealed(all)) {
            accepted += 1;
            let mut settled = read.clone();
            settled.settle();
            assert_eq!(settled, read);
            assert!(Statistics::decode(&read.encode()).is_ok_and(|again| again == read));
        }
    }
    assert!(accepted > 10 && accepted < 3000, "{accepted} of 4000");
}
