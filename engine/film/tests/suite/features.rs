//! Tests of features: sums in any parts, means and shares, bytes.

use femc_film::features::RANKS;
use femc_film::tile::{NONE_HELD, half_of};
use femc_film::{
    AovPiece, AovTile, FeatureImage, FeatureLayout, FeatureSums, FeatureTile, FilmError, LayerSetLight, LayerTile,
    LightBuffer, Rect, Tiling,
};
use femc_math::Rgb;
use femc_math::sampler::replicate_of;
use std::ops::Range;

const RECT: Rect = Rect { x: 0, y: 0, width: 5, height: 3 };
const LAYOUT: FeatureLayout = FeatureLayout { values: 2, ids: 1 };

/// Returns the hit of sample `sample` of a pixel; every seventh sample misses.
fn hit(pixel: u32, sample: u32) -> Option<([f64; 2], [u32; 1])> {
    let word = pixel.wrapping_mul(0x9e37_79b9).wrapping_add(sample.wrapping_mul(0x85eb_ca6b));
    let id = [0xbf80_0000, 7, 7, 3, 0x3f00_0000, 11, 12, 13, 14][word as usize % 9];
    (!(word >> 8).is_multiple_of(7)).then(|| ([f64::from(word) - 2e9, -f64::from(sample) / 3.0], [id]))
}

fn sums(pixels: Range<u32>, samples: Range<u32>) -> FeatureSums {
    let mut sums = FeatureSums::new(LAYOUT);
    for pixel in pixels {
        sums.begin_pixel();
        for sample in samples.clone() {
            let hit = hit(pixel, sample);
            sums.add(hit.as_ref().map(|(values, ids)| (&values[..], &ids[..])));
        }
    }
    sums
}

fn tile(samples: Range<u32>) -> FeatureTile {
    // Sums as two threads fill them.
    let rows = [sums(0..5, samples.clone()), sums(5..15, samples.clone())];
    FeatureTile::new(RECT, samples, FeatureSums::concat(LAYOUT, rows)).unwrap()
}

fn light(samples: Range<u32>) -> LayerTile {
    let (mut light, mut counts) = (LightBuffer::default(), [0; 2]);
    for half in samples.clone().map(|sample| half_of(replicate_of(sample))) {
        light.add(half, Rgb::ONE);
        counts[half] += 1;
    }
    let light = LayerSetLight { layers: 1, sums: vec![light.take().unwrap(); 15] };
    LayerTile::new(RECT, samples, 1, vec![counts; 15], vec![light]).unwrap()
}

fn aov_tile(samples: Range<u32>) -> AovTile {
    AovTile { light: Some(light(samples.clone())), features: Some(tile(samples)) }
}

#[test]
fn samples_in_any_parts_and_order_have_the_same_bytes() {
    let whole = tile(0..40);
    for cuts in [&[0, 40][..], &[0, 1, 2, 17, 40], &[0, 39, 40]] {
        let mut parts: Vec<FeatureTile> = cuts.windows(2).map(|cut| tile(cut[0]..cut[1])).collect();
        parts.rotate_left(1);
        parts.push(parts[0].clone());
        let united = FeatureTile::from_parts(parts, 0).unwrap();
        assert_eq!(united.encode(), whole.encode());
    }
    assert_eq!(
        FeatureTile::from_parts(vec![tile(0..8), tile(8..40)], 8).unwrap(),
        tile(8..40),
        "what is before is left out"
    );
    assert!(matches!(FeatureTile::from_parts(vec![tile(0..8), tile(9..40)], 0), Err(FilmError::Gap(RECT))));
    assert!(FeatureTile::from_parts(Vec::new(), 0).is_err());
}

#[test]
fn feature_image_has_hit_means_and_sample_shares_by_rank() {
    let count = 60;
    let mut piece = AovPiece::new(Tiling::new(5, 3, 8).unwrap(), 0);
    piece.put(&aov_tile(0..count), NONE_HELD).unwrap();
    let piece = AovPiece::decode(&piece.encode()).unwrap();
    assert!(piece.light.is_some());
    let mut image = FeatureImage::new(LAYOUT, 5, 3);
    image.put(piece.features.as_ref().unwrap()).unwrap();
    for pixel in 0..15 {
        let all: Vec<_> = (0..count).filter_map(|sample| hit(pixel, sample)).collect();
        let at = |channel: usize| image.channels[channel][pixel as usize];
        for value in 0..2 {
            let mean: f64 = all.iter().map(|met| met.0[value]).sum::<f64>() / all.len() as f64;
            assert!((f64::from(at(value)) - mean).abs() <= 1e-7 * mean.abs() + 1e-6, "{} {mean}", at(value));
        }
        assert_eq!(at(2), all.len() as f32 / count as f32);
        let ids: Vec<u32> = (0..count).map(|sample| hit(pixel, sample).map_or(0, |met| met.1[0])).collect();
        let share_of = |id: f32| ids.iter().filter(|other| **other == id.to_bits()).count() as f32 / count as f32;
        let ranks: Vec<(f32, f32)> = (0..RANKS).map(|rank| (at(3 + 2 * rank), at(4 + 2 * rank))).collect();
        assert!(ranks.is_sorted_by(|a, b| a.1 >= b.1), "{ranks:?}");
        assert!(ranks.iter().filter(|rank| rank.1 > 0.0).all(|rank| rank.1 == share_of(rank.0)), "{ranks:?}");
        assert!(ranks.iter().any(|rank| rank.0 == 0.0 && rank.1 > 0.0), "what met nothing has an id: {ranks:?}");
        assert!(ranks.iter().filter(|rank| rank.1 == 0.0).all(|rank| rank.0 == 0.0), "{ranks:?}");
    }
    let known = (0..15).flat_map(|pixel| (0..count).filter_map(move |sample| hit(pixel, sample)));
    let known: std::collections::BTreeSet<u32> = known.map(|met| met.1[0]).collect();
    assert!(image.ids(0).is_subset(&known) && image.ids(0).len() > RANKS);
}

#[test]
fn bytes_say_all_and_damage_is_an_error() {
    let tiles = [
        aov_tile(3..9),
        AovTile { light: None, features: Some(tile(3..9)) },
        AovTile { light: Some(light(3..9)), features: None },
    ];
    for tile in tiles {
        let bytes = tile.encode();
        assert_eq!(AovTile::decode(&bytes).unwrap(), tile);
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x20;
            assert!(AovTile::decode(&damaged).is_err(), "byte {at}");
            assert!(AovTile::decode(&bytes[..at]).is_err(), "cut at {at}");
        }
    }
    let neither = AovTile { light: None, features: None };
    assert!(AovTile::decode(&neither.encode()).is_err());
    let others = AovTile { light: Some(light(0..8)), features: Some(tile(0..9)) };
    assert!(AovTile::decode(&others.encode()).is_err(), "of other samples");
}

#[test]
fn parts_that_lack_what_others_have_are_refused() {
    let without = AovTile { light: Some(light(8..16)), features: None };
    assert!(AovTile::from_parts(vec![aov_tile(0..8), without.clone()], 0, NONE_HELD).is_err());
    let mut piece = AovPiece::new(Tiling::new(5, 6, 3).unwrap(), 0);
    assert!(piece.put(&aov_tile(0..8), NONE_HELD).is_err(), "another tile");
    let mut piece = AovPiece::new(Tiling::new(5, 6, 5).unwrap(), 0);
    assert!(piece.put(&without, NONE_HELD).is_err(), "another tile");
    assert!(AovPiece::decode(&piece.encode()).is_err(), "nothing was put");
}
