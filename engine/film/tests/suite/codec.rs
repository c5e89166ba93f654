//! Tests of the tile codec: round trips, and errors for any other bytes.

use femc_film::{FilmError, Rect, Sample, Tile};
use femc_math::{Rgb, hash};
use proptest::prelude::*;

fn tile(width: u32, height: u32, spp: u32) -> Tile {
    let rect = Rect { x: 3, y: 5, width, height };
    let mut tile = Tile::new(rect, 7..7 + spp).unwrap();
    for (x, y) in rect.pixels() {
        for i in 7..7 + spp {
            let v = hash::unit_f32(hash::combine(&[u64::from(x), u64::from(y), u64::from(i)]) as u32);
            let color = if (x, i) == (4, 8) { Rgb::NAN } else { Rgb::new(v, 10.0 * v, 0.1) };
            tile.add(x, y, i, &Sample { color, albedo: Rgb::splat(v), depth: 1.0 + v });
        }
    }
    tile
}

#[test]
fn a_tile_survives_its_bytes() {
    for (w, h, spp) in [(1, 1, 1), (2, 1, 3), (16, 9, 4)] {
        let mut t = tile(w, h, spp);
        assert_eq!(Tile::decode(&t.encode()).unwrap(), t);
        t.hold([100, u32::MAX]).unwrap();
        t.merge(&Tile::new(t.rect(), 100..200).unwrap()).unwrap();
        assert_eq!(Tile::decode(&t.encode()).unwrap(), t);
    }
}

#[test]
fn bytes_are_compact() {
    let bytes = tile(64, 64, 16).encode();
    let each = bytes.len() as f64 / (64.0 * 64.0);
    assert!(each < 118.0, "{each} bytes a pixel, half of the plain sums' 236");
}

#[test]
fn every_cut_and_every_flipped_bit_is_an_error() {
    let bytes = tile(3, 2, 2).encode();
    for cut in 0..bytes.len() {
        assert!(Tile::decode(&bytes[..cut]).is_err(), "cut at {cut}");
    }
    for bit in 0..8 * bytes.len() {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(Tile::decode(&damaged).is_err(), "bit {bit}");
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(Tile::decode(&longer).is_err());
}

#[test]
fn another_version_is_named() {
    let mut bytes = tile(1, 1, 1).encode();
    bytes[8] = 9;
    assert!(matches!(Tile::decode(&bytes), Err(FilmError::Version { found: 9, expected: 4 })));
}

/// Makes a header with a correct checksum around any fields and payload.
fn forged(words: &[u32], payload: &[u8]) -> Vec<u8> {
    let body: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).chain(payload.iter().copied()).collect();
    [b"FEMCTILE", &4u32.to_le_bytes()[..], &blake3::hash(&body).as_bytes()[..16], &body].concat()
}

#[test]
fn forged_sizes_are_refused_before_they_are_allocated() {
    let open_without_bad: Vec<u32> = [u32::MAX; 2].into_iter().chain([0; 15]).collect();
    let payload = zstd::bulk::compress(&[0; 236], 1).unwrap();
    let with = |head: &[u32]| Tile::decode(&forged(&[head, &open_without_bad].concat(), &payload));
    assert!(with(&[0, 0, 1, 1, 1, 0, 1]).is_ok());
    assert!(matches!(with(&[0, 0, 1 << 31, 1 << 31, 1, 0, 1]), Err(FilmError::Size { .. })));
    assert!(matches!(with(&[u32::MAX, 0, 1, 1, 1, 0, 1]), Err(FilmError::Size { .. })));
    assert!(matches!(with(&[0, 0, 2048, 2048, 1, 0, 1]), Err(FilmError::Corrupt("wrong number of pixels"))));
    assert!(matches!(with(&[0, 0, 1, 1, u32::MAX, 0, 1]), Err(FilmError::Corrupt(_))));
    assert!(matches!(with(&[0, 0, 1, 1, 1, 5, 5]), Err(FilmError::Corrupt("sample ranges out of order"))));
    assert!(matches!(with(&[0, 0, 1, 1, 2, 0, 5, 4, 8]), Err(FilmError::Corrupt("sample ranges out of order"))));
    let mut counted = vec![0; 236];
    counted[212] = 2; // two samples where the range holds one
    let payload = zstd::bulk::compress(&counted, 1).unwrap();
    assert!(Tile::decode(&forged(&[&[0, 0, 1, 1, 1, 0, 1][..], &open_without_bad].concat(), &payload)).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, rng_seed: proptest::test_runner::RngSeed::Fixed(3), ..ProptestConfig::default() })]

    #[test]
    fn garbage_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(Tile::decode(&bytes).is_err());
    }

    #[test]
    fn garbage_behind_a_right_checksum_never_panics(
        words in prop::collection::vec(prop_oneof![0u32..4, any::<u32>()], 0..30),
        payload in prop::collection::vec(any::<u8>(), 0..100),
    ) {
        // Decoding must return; whether it is an error depends on the words.
        let bytes = forged(&words, &payload);
        if let Ok(tile) = Tile::decode(&bytes) {
            prop_assert!(tile.spp() > 0);
        }
    }
}
