//! Tests of layer tiles: any parts unite to the same layers, layers are held like pictures, and damage of any kind is an error.

use femc_film::tile::{NONE_HELD, half_of};
use femc_film::{
    FilmError, Frame, LayerImage, LayerPiece, LayerSetLight, LayerTile, LightBuffer, LightSums, Rect, Sample,
    SampleRange, Tile, Tiling,
};
use femc_math::sampler::replicate_of;
use femc_math::{Rgb, hash};
use proptest::prelude::*;

const LAYERS: usize = 3;

fn tiling() -> Tiling {
    Tiling::new(20, 12, 8).unwrap()
}

/// Returns the light of a sample in each layer.
fn light(x: u32, y: u32, sample: u32) -> [Rgb; LAYERS] {
    std::array::from_fn(|layer| {
        let v = hash::unit_f32(hash::combine(&[u64::from(x), u64::from(y), u64::from(sample), layer as u64]) as u32);
        if v < 0.3 { Rgb::ZERO } else { Rgb::new(v, 16.0 * v, v * v) }
    })
}

fn half(sample: u32) -> usize {
    half_of(replicate_of(sample))
}

fn counts(rect: Rect, samples: std::ops::Range<u32>) -> Vec<[u32; 2]> {
    let mut counts = [0; 2];
    samples.for_each(|sample| counts[half(sample)] += 1);
    vec![counts; rect.area() as usize]
}

fn layers(rect: Rect, samples: std::ops::Range<u32>) -> LayerTile {
    let mut sums = vec![Vec::new(); LAYERS];
    for (x, y) in rect.pixels() {
        let mut all = [(); LAYERS].map(|()| LightBuffer::default());
        for sample in samples.clone() {
            all.iter_mut().zip(light(x, y, sample)).for_each(|(light, color)| light.add(half(sample), color));
        }
        all.iter_mut().zip(&mut sums).for_each(|(light, sums)| sums.push(light.take().unwrap_or_default()));
    }
    let light = sums.into_iter().enumerate().map(|(layer, sums)| LayerSetLight { layers: 1 << layer, sums }).collect();
    LayerTile::new(rect, samples.clone(), LAYERS as u32, counts(rect, samples), light).unwrap()
}

/// Makes the frame whose samples have the light of all layers.
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

fn resolve_layers(parts: &[std::ops::Range<u32>], ends: [u32; 2], group: usize) -> Vec<LayerImage> {
    let names = (0..LAYERS).map(|layer| format!("layer{layer}"));
    let mut images = LayerImage::black(names, 20, 12);
    for first in (0..tiling().count()).step_by(group) {
        let mut piece = LayerPiece::new(tiling(), first);
        for rect in (first..first + group).filter_map(|tile| tiling().rect(tile)) {
            let coded = parts.iter().map(|part| LayerTile::decode(&layers(rect, part.clone()).encode()).unwrap());
            let all = LayerTile::from_parts(coded.collect(), 0, ends).unwrap();
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
fn layers_ignore_partition_and_grouping_and_sum_to_the_picture() {
    for ends in [NONE_HELD, [4, u32::MAX], [8, 4]] {
        let whole = resolve_layers(&[0..4, 4..8, 8..12], ends, 1);
        // In another order, one part twice, in larger groups; as one single part only if nothing is held.
        assert_eq!(resolve_layers(&[8..12, 0..4, 4..8, 0..4], ends, 4), whole);
        if ends == NONE_HELD {
            assert_eq!(resolve_layers(std::slice::from_ref(&(0..12)), ends, 6), whole);
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
        let mut all = LightBuffer::default();
        for sample in 0..8 {
            let color = light(x, y, sample)[0];
            tile.add(x, y, sample, &Sample { color, albedo: Rgb::ZERO, depth: 1.0 });
            all.add(half(sample), color);
        }
        sums.push(all.take().unwrap_or_default());
    }
    let mut frame = Frame::new(tiling());
    frame.insert(tile).unwrap();
    let mut piece = LayerPiece::new(tiling(), 1);
    let light = vec![LayerSetLight { layers: 1, sums }];
    piece.put(&LayerTile::new(rect, 0..8, 1, counts(rect, 0..8), light).unwrap(), NONE_HELD).unwrap();
    let mut images = LayerImage::black(["all".to_owned()], 20, 12);
    LayerImage::put(&mut images, &piece).unwrap();
    let image = frame.resolve();
    assert_eq!((&images[0].color, &images[0].variance), (&image.color.pixels, &image.variance));
}

#[test]
fn parts_that_do_not_fit_together_are_refused() {
    let [first, second] = [0, 1].map(|tile| tiling().rect(tile).unwrap());
    let unite = |parts: Vec<LayerTile>, ends| LayerTile::from_parts(parts, 0, ends);
    assert!(matches!(unite(vec![], NONE_HELD), Err(FilmError::Corrupt(_))));
    assert!(matches!(unite(vec![layers(first, 0..4), layers(first, 6..8)], NONE_HELD), Err(FilmError::Gap(_))));
    assert!(matches!(unite(vec![layers(first, 0..4), layers(first, 3..8)], NONE_HELD), Err(FilmError::Gap(_))));
    assert!(matches!(
        unite(vec![layers(first, 0..4), layers(second, 4..8)], NONE_HELD),
        Err(FilmError::OtherPixels { .. })
    ));
    assert!(matches!(unite(vec![layers(first, 0..4)], [2, 8]), Err(FilmError::Corrupt(_))));
    let after = LayerTile::from_parts(vec![layers(first, 0..4), layers(first, 4..8)], 4, NONE_HELD).unwrap();
    assert_eq!(after, layers(first, 4..8));
    let mut piece = LayerPiece::new(tiling(), 0);
    assert!(matches!(piece.put(&layers(second, 0..4), NONE_HELD), Err(FilmError::NotInFrame(_))));
    piece.put(&layers(first, 0..4), NONE_HELD).unwrap();
    let mut other = LayerImage::black(["one".to_owned()], 20, 12);
    assert!(LayerImage::put(&mut other, &piece).is_err());
    let light = |layers, pixels| vec![LayerSetLight { layers, sums: vec![LightSums::default(); pixels] }];
    let of = |samples, layers, light| LayerTile::new(first, samples, layers, counts(first, 0..1), light);
    assert!(of(0..1, 2, light(0b11, 64)).is_ok());
    assert!(matches!(of(0..0, 2, vec![]), Err(FilmError::EmptyRange(_))));
    for (layers, light) in [(0, vec![]), (65, vec![]), (2, light(1, 63)), (2, light(0, 64)), (2, light(0b100, 64))] {
        assert!(matches!(of(0..1, layers, light), Err(FilmError::Corrupt(_))));
    }
    assert!(LayerTile::new(first, 0..1, 2, vec![[1, 0]], vec![]).is_err());
}

/// Makes one sample of `value` in the first pixel.
fn lit_pixel(layers: u64, value: f32) -> LayerSetLight {
    let mut light = LightBuffer::default();
    light.add(0, Rgb::splat(value));
    let mut sums = vec![LightSums::default(); 64];
    sums[0] = light.take().unwrap_or_default();
    LayerSetLight { layers, sums }
}

#[test]
fn light_shared_by_layers_counts_in_each_for_any_overlap() {
    let rect = tiling().rect(0).unwrap();
    let colors = |tile: &LayerTile| -> Vec<f32> {
        let mut piece = LayerPiece::new(tiling(), 0);
        piece.put(&LayerTile::decode(&tile.encode()).unwrap(), NONE_HELD).unwrap();
        let mut images = LayerImage::black((0..3).map(|layer| format!("layer{layer}")), 20, 12);
        LayerImage::put(&mut images, &piece).unwrap();
        images.iter().map(|image| image.color[0][0]).collect()
    };
    let tile =
        |samples: std::ops::Range<u32>, light| LayerTile::new(rect, samples, 3, vec![[1, 0]; 64], light).unwrap();
    // A set that occurs twice, one in another order, one without light.
    let some =
        tile(0..1, vec![lit_pixel(0b110, 1.0), lit_pixel(0b011, 2.0), lit_pixel(0b110, 4.0), lit_pixel(0b100, 0.0)]);
    assert_eq!(colors(&some), [2.0, 7.0, 5.0]);
    assert_eq!(some, tile(0..1, vec![lit_pixel(0b011, 2.0), lit_pixel(0b110, 5.0)]));
    // More sets than layers.
    let many = tile(
        0..1,
        vec![
            lit_pixel(0b001, 1.0),
            lit_pixel(0b010, 2.0),
            lit_pixel(0b011, 4.0),
            lit_pixel(0b110, 8.0),
            lit_pixel(0b111, 16.0),
        ],
    );
    assert_eq!(colors(&many), [21.0, 30.0, 24.0]);
    let other = tile(1..2, vec![lit_pixel(0b110, 3.0)]);
    for parts in [vec![some.clone(), other.clone()], vec![other.clone(), some.clone()]] {
        // The mean of two samples.
        assert_eq!(colors(&LayerTile::from_parts(parts, 0, NONE_HELD).unwrap()), [1.0, 5.0, 4.0]);
    }
    // A held half has no light, and a set without light is dropped.
    assert_eq!(colors(&LayerTile::from_parts(vec![some], 0, [0, 1]).unwrap()), [0.0; 3]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn damaged_layers_are_refused_and_never_a_panic(at in 0usize..1000, flip in 1u8.., cut in 0usize..1000) {
        let tile = layers(tiling().rect(0).unwrap(), 0..3);
        let mut piece = LayerPiece::new(tiling(), 0);
        piece.put(&tile, NONE_HELD).unwrap();
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
