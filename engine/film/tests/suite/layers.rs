//! Layers of tiles: united in any parts they are the same, they are held as pictures are, and damage of any kind is an error.

use femc_film::tile::OPEN;
use femc_film::{
    FilmError, Frame, LayerImage, LayerLight, LayerPiece, LayerSums, LayerTile, Rect, Sample, SampleRange, Tile, Tiling,
};
use femc_math::{Rgb, hash};
use proptest::prelude::*;

const LAYERS: usize = 3;

fn tiling() -> Tiling {
    Tiling::new(20, 12, 8).unwrap()
}

/// The light of a sample in each layer.
fn light(x: u32, y: u32, sample: u32) -> [Rgb; LAYERS] {
    std::array::from_fn(|layer| {
        let v = hash::unit_f32(hash::combine(&[u64::from(x), u64::from(y), u64::from(sample), layer as u64]) as u32);
        if v < 0.3 { Rgb::ZERO } else { Rgb::new(v, 16.0 * v, v * v) }
    })
}

fn summed(mut counts: LayerSums, light: &mut LayerLight) -> LayerSums {
    counts.merge(&light.take().unwrap_or_default());
    counts
}

fn layers(rect: Rect, samples: std::ops::Range<u32>) -> LayerTile {
    let mut sums = Vec::new();
    for (x, y) in rect.pixels() {
        let (mut counts, mut all) = (LayerSums::default(), [(); LAYERS].map(|()| LayerLight::default()));
        for sample in samples.clone() {
            counts.count(sample);
            all.iter_mut().zip(light(x, y, sample)).for_each(|(light, color)| light.add(sample, color));
        }
        sums.extend(all.map(|mut light| summed(counts, &mut light)));
    }
    LayerTile::of_pixels(rect, samples, LAYERS as u32, &sums).unwrap()
}

/// The frame whose samples have the light of all layers.
fn picture(parts: &[std::ops::Range<u32>], ends: [u32; 2]) -> Frame {
    let mut frame = Frame::new(tiling());
    for (index, rect) in tiling().rects().enumerate() {
        for part in parts {
            let mut tile = Tile::new(rect, part.clone()).unwrap();
            for ((x, y), sample) in rect.pixels().flat_map(|at| part.clone().map(move |sample| (at, sample))) {
                let color = light(x, y, sample).into_iter().fold(Rgb::ZERO, |sum, color| sum + color);
                tile.add(x, y, sample, &Sample { color, albedo: Rgb::ZERO, depth: 1.0 });
            }
            tile.hold(ends).unwrap();
            frame.insert(tile).unwrap();
        }
        frame.hold(index, ends).unwrap();
    }
    frame
}

fn resolved(parts: &[std::ops::Range<u32>], ends: [u32; 2], group: usize) -> Vec<LayerImage> {
    let names = (0..LAYERS).map(|layer| format!("layer{layer}"));
    let mut images = LayerImage::black(names, 20, 12);
    for first in (0..tiling().count()).step_by(group) {
        let mut piece = LayerPiece::new(tiling(), first);
        for rect in (first..first + group).filter_map(|tile| tiling().rect(tile)) {
            let coded = parts.iter().map(|part| LayerTile::decode(&layers(rect, part.clone()).encode()).unwrap());
            let all = LayerTile::united(coded.collect(), 0, ends).unwrap();
            assert_eq!(all.samples(), SampleRange { start: 0, end: 12 });
            piece.put(&all, ends).unwrap();
        }
        let piece = LayerPiece::decode(&piece.encode()).unwrap();
        assert_eq!(piece.samples().len(), piece.tiles().len());
        LayerImage::put(&mut images, &piece).unwrap();
    }
    images
}

#[test]
fn layers_in_any_parts_and_groups_are_the_same_and_sum_up_to_the_picture_also_where_halves_are_held() {
    for ends in [OPEN, [4, u32::MAX], [8, 4]] {
        let whole = resolved(&[0..4, 4..8, 8..12], ends, 1);
        // In another order, one part twice, in larger groups; in one part only where nothing is held.
        assert_eq!(resolved(&[8..12, 0..4, 4..8, 0..4], ends, 4), whole);
        if ends == OPEN {
            assert_eq!(resolved(std::slice::from_ref(&(0..12)), ends, 6), whole);
        }
        let image = picture(&[0..4, 4..8, 8..12], ends).resolve();
        for (at, color) in image.color.pixels.iter().enumerate() {
            for (channel, wanted) in color.iter().enumerate() {
                let sum: f64 = whole.iter().map(|layer| f64::from(layer.color[at][channel])).sum();
                let wanted = f64::from(*wanted);
                assert!((sum - wanted).abs() <= 4e-7 * wanted, "{ends:?} {at}: {sum} {wanted}");
            }
        }
        assert!(whole.iter().all(|layer| layer.variance.iter().any(|v| v[0] > 0.0)));
    }
}

#[test]
fn a_single_layer_of_all_light_has_the_variance_of_the_picture() {
    let rect = tiling().rect(1).unwrap();
    let (mut tile, mut sums) = (Tile::new(rect, 0..8).unwrap(), Vec::new());
    for (x, y) in rect.pixels() {
        let (mut counts, mut all) = (LayerSums::default(), LayerLight::default());
        for sample in 0..8 {
            let color = light(x, y, sample)[0];
            tile.add(x, y, sample, &Sample { color, albedo: Rgb::ZERO, depth: 1.0 });
            counts.count(sample);
            all.add(sample, color);
        }
        sums.push(summed(counts, &mut all));
    }
    let mut frame = Frame::new(tiling());
    frame.insert(tile).unwrap();
    let mut piece = LayerPiece::new(tiling(), 1);
    piece.put(&LayerTile::of_pixels(rect, 0..8, 1, &sums).unwrap(), OPEN).unwrap();
    let mut images = LayerImage::black(["all".to_owned()], 20, 12);
    LayerImage::put(&mut images, &piece).unwrap();
    let image = frame.resolve();
    assert_eq!((&images[0].color, &images[0].variance), (&image.color.pixels, &image.variance));
}

#[test]
fn parts_that_do_not_fit_together_are_refused() {
    let [first, second] = [0, 1].map(|tile| tiling().rect(tile).unwrap());
    let unite = |parts: Vec<LayerTile>, ends| LayerTile::united(parts, 0, ends);
    assert!(matches!(unite(vec![], OPEN), Err(FilmError::Corrupt(_))));
    assert!(matches!(unite(vec![layers(first, 0..4), layers(first, 6..8)], OPEN), Err(FilmError::Gap(_))));
    assert!(matches!(unite(vec![layers(first, 0..4), layers(first, 3..8)], OPEN), Err(FilmError::Gap(_))));
    assert!(matches!(unite(vec![layers(first, 0..4), layers(second, 4..8)], OPEN), Err(FilmError::OtherPixels { .. })));
    assert!(matches!(unite(vec![layers(first, 0..4)], [2, 8]), Err(FilmError::Corrupt(_))));
    let after = LayerTile::united(vec![layers(first, 0..4), layers(first, 4..8)], 4, OPEN).unwrap();
    assert_eq!(after, layers(first, 4..8));
    let mut piece = LayerPiece::new(tiling(), 0);
    assert!(matches!(piece.put(&layers(second, 0..4), OPEN), Err(FilmError::NotInFrame(_))));
    piece.put(&layers(first, 0..4), OPEN).unwrap();
    let mut other = LayerImage::black(["one".to_owned()], 20, 12);
    assert!(LayerImage::put(&mut other, &piece).is_err());
    assert!(LayerTile::of_pixels(first, 0..0, 1, &[]).is_err());
    assert!(LayerTile::of_pixels(first, 0..1, 1, &[LayerSums::default()]).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn damaged_layers_are_refused_and_never_a_panic(at in 0usize..1000, flip in 1u8.., cut in 0usize..1000) {
        let tile = layers(tiling().rect(0).unwrap(), 0..3);
        let mut piece = LayerPiece::new(tiling(), 0);
        piece.put(&tile, OPEN).unwrap();
        for bytes in [tile.encode(), piece.encode()] {
            let mut damaged = bytes.clone();
            let place = at % damaged.len();
            damaged[place] ^= flip;
            prop_assert!(LayerTile::decode(&damaged).is_err() && LayerPiece::decode(&damaged).is_err());
            let short = &bytes[..cut % bytes.len()];
            prop_assert!(LayerTile::decode(short).is_err() && LayerPiece::decode(short).is_err());
        }
    }
}
