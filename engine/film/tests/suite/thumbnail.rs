//! Tests of the laws of thumbnails and levels: they are functions of the set of samples, whatever the division.

use femc_film::{Frame, Image, LuminanceLevels, Rect, Sample, Tile, Tiling, ToneCurve};
use femc_math::{Rgb, hash};

const FILM: Tiling = Tiling { width: 53, height: 37, edge: 16 };

/// Draws a sample over some twenty octaves, brighter to the right; the lowest rows are black.
fn draw(x: u32, y: u32, index: u32) -> Sample {
    let word = |k: u64| hash::combine(&[u64::from(x), u64::from(y), u64::from(index), k]);
    let light = if y >= 32 { 0.0 } else { hash::unit_f32(word(0) as u32) * 2f32.powi(x as i32 / 3 - 10) };
    let color = if word(1) % 50 == 0 { f32::NAN } else { light };
    Sample { color: Rgb::new(color, 0.5 * light, 0.1 * light), albedo: Rgb::splat(0.3), depth: 1.0 + light }
}

fn render(rect: Rect, samples: std::ops::Range<u32>) -> Tile {
    let mut tile = Tile::new(rect, samples.clone()).unwrap();
    for (x, y) in rect.pixels() {
        for index in samples.clone() {
            tile.add(x, y, index, &draw(x, y, index));
        }
    }
    tile
}

/// Makes the thumbnails of tiles that are divided at `cuts`, put together backwards and through their bytes.
fn thumbnails(edge: u32, cuts: &[u32]) -> Frame {
    let tiling = Tiling { edge, ..FILM };
    let mut small = Frame::new(tiling.thumbnail_tiling().unwrap());
    for cut in cuts.windows(2).rev() {
        for rect in tiling.rects() {
            let thumbnail = render(rect, cut[0]..cut[1]).thumbnail();
            small.insert(Tile::decode_thumbnail(&thumbnail.encode_thumbnail()).unwrap()).unwrap();
            assert!(Tile::decode(&thumbnail.encode_thumbnail()).is_err(), "a thumbnail is no tile");
        }
    }
    small
}

fn pixels(frame: &Frame) -> Vec<Vec<femc_film::tile::PixelSums>> {
    (0..frame.tiling().count()).map(|index| frame.tile(index).unwrap().pixels().to_vec()).collect()
}

#[test]
fn part_thumbnails_of_a_tile_sum_to_its_own_for_any_cut() {
    let whole = thumbnails(16, &[0, 12]);
    for cuts in [&[0, 1, 12][..], &[0, 3, 4, 11, 12]] {
        assert_eq!(pixels(&thumbnails(16, cuts)), pixels(&whole), "{cuts:?}");
    }
    assert_eq!(whole.tile(0).unwrap().pixels().len(), 4);
    let counted: u32 = pixels(&whole).concat().iter().map(|sums| sums.samples()).sum();
    let good = |x: u32, y: u32| (0..12).filter(|&index| draw(x, y, index).fault().is_none()).count() as u32;
    let rect = Rect { x: 0, y: 0, width: FILM.width, height: FILM.height };
    assert_eq!(counted, rect.pixels().map(|(x, y)| good(x, y)).sum::<u32>());
    assert_eq!(Tiling { edge: 12, ..FILM }.thumbnail_tiling(), None);
}

#[test]
fn levels_do_not_depend_on_the_tiles_and_add_up_in_any_order() {
    let whole = LuminanceLevels::from_thumbnails(&thumbnails(16, &[0, 12]));
    assert_eq!(whole.blocks(), 7 * 5);
    assert_eq!(whole.lit_bins().map(|(_, count)| count).sum::<u64>(), 7 * 4, "the lowest row is black");
    for edge in [8, 24, 64] {
        assert_eq!(LuminanceLevels::from_thumbnails(&thumbnails(edge, &[0, 5, 12])), whole, "tiles of {edge}");
    }
    let other = LuminanceLevels::from_thumbnails(&thumbnails(16, &[0, 1]));
    let sum = |a: &LuminanceLevels, b: &LuminanceLevels| {
        let mut sum = a.clone();
        sum.merge(b);
        sum
    };
    assert_eq!(sum(&whole, &other), sum(&other, &whole));
    assert_eq!(sum(&whole, &LuminanceLevels::default()), whole);
    let bytes = whole.encode();
    assert_eq!(LuminanceLevels::decode(&bytes).unwrap(), whole);
    assert!((0..bytes.len()).all(|end| LuminanceLevels::decode(&bytes[..end]).is_err()));
}

#[test]
fn image_levels_equal_thumbnail_levels_up_to_rounding() {
    let mut frame = Frame::new(FILM);
    for rect in FILM.rects() {
        frame.insert(render(rect, 0..12)).unwrap();
    }
    let image = frame.resolve().color;
    let [of_image, of_sums] =
        [LuminanceLevels::from_image(&image), LuminanceLevels::from_thumbnails(&thumbnails(16, &[0, 12]))];
    let lit = |levels: &LuminanceLevels| levels.lit_bins().map(|(_, count)| count).sum::<u64>();
    assert_eq!((of_image.blocks(), lit(&of_image)), (of_sums.blocks(), lit(&of_sums)));
    let [a, b] = [&of_image, &of_sums].map(|levels| femc_math::elementary::ln(ToneCurve::from_levels(levels).exposure));
    // Means of pixels weight every pixel equally; sums weight every good sample equally.
    assert!((a - b).abs() < 0.1, "{a}, {b}");
}

#[test]
fn level_exposure_is_within_half_a_bin_of_block_exposure() {
    // A 32nd of an octave, and the rounding of floats.
    let most = std::f32::consts::LN_2 / 32.0 + 1e-5;
    for samples in [1, 3, 12] {
        let small = thumbnails(16, &[0, samples]);
        let blocks: Image = small.resolve().color;
        let [exact, counted] =
            [ToneCurve::auto([&blocks]), ToneCurve::from_levels(&LuminanceLevels::from_thumbnails(&small))]
                .map(|curve| femc_math::elementary::ln(curve.exposure));
        assert!((exact - counted).abs() <= most, "{exact}, {counted} of {samples} samples");
    }
    assert_eq!(ToneCurve::from_levels(&LuminanceLevels::default()).exposure, 1.0);
}
