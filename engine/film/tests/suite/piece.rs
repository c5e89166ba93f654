//! Tests of pieces of a frame: together they give the frame's own image, and damage of any kind is an error.

use femc_film::{
    BadSamples, ErrorStatistics, FilmError, Frame, FrameError, FrameImage, ImagePiece, Rect, Sample, SampleRange, Tile,
    TileErrors, Tiling, pixel_digest,
};
use femc_math::{Rgb, hash};
use proptest::prelude::*;

/// Makes a frame of 6 tiles, two of them narrow, with misses and a bad sample.
fn frame() -> Frame {
    let tiling = Tiling::new(20, 16, 8).unwrap();
    let mut frame = Frame::new(tiling);
    for rect in tiling.rects() {
        for range in [0..2, 2..5] {
            frame.insert(tile(rect, range)).unwrap();
        }
    }
    frame
}

fn tile(rect: Rect, samples: std::ops::Range<u32>) -> Tile {
    let mut tile = Tile::new(rect, samples.clone()).unwrap();
    for ((x, y), i) in rect.pixels().flat_map(|pixel| samples.clone().map(move |i| (pixel, i))) {
        let v = hash::unit_f32(hash::combine(&[u64::from(x), u64::from(y), u64::from(i)]) as u32);
        let color = if (x, y, i) == (9, 3, 2) { Rgb::NAN } else { Rgb::new(v, 1e4 * v, 1e-6) };
        let depth = if v < 0.3 { f32::INFINITY } else { v };
        tile.add(x, y, i, &Sample { color, albedo: Rgb::splat(v), depth });
    }
    tile
}

#[test]
fn pieces_of_any_size_make_the_image_of_the_frame_to_the_bit() {
    let frame = frame();
    for size in 1..=6 {
        let mut image = FrameImage::black(20, 16);
        let mut bad = BadSamples::default();
        for start in (0..6).step_by(size) {
            let piece = ImagePiece::from_frame(&frame, start..(start + size).min(6)).unwrap();
            let bytes = piece.encode();
            let piece = ImagePiece::decode(&bytes).unwrap();
            let samples: Vec<SampleRange> = piece.tiles().map(|_| (0..5).into()).collect();
            assert_eq!((piece.encode(), piece.samples()), (bytes, &samples[..]));
            bad.merge(piece.bad_samples());
            image.put(&piece).unwrap();
        }
        assert_eq!((image, bad), (frame.resolve(), frame.bad_samples()), "pieces of {size} tiles");
    }
}

/// Renders a frame whose tiles have different numbers of samples, in parts that these cuts make, through all codecs and in groups
/// of `group` tiles. Returns the image, its bad samples, and the errors of the tiles.
fn render_in_parts(
    counts: &[u32],
    cuts: &[u32],
    group: usize,
    is_late: bool,
) -> (FrameImage, BadSamples, Vec<TileErrors>) {
    let tiling = Tiling::new(40, 20, 16).unwrap();
    let mut frame = Frame::new(tiling);
    let mut parts = Vec::new();
    for (rect, &count) in tiling.rects().zip(counts) {
        let mut bounds: Vec<u32> = cuts.iter().copied().filter(|&cut| cut < count).chain([0, count]).collect();
        bounds.sort_unstable();
        bounds.dedup();
        parts.extend(bounds.windows(2).map(|pair| tile(rect, pair[0]..pair[1])));
    }
    if is_late {
        parts.reverse();
    }
    for part in parts {
        frame.insert(Tile::decode(&part.encode()).unwrap()).unwrap();
    }
    let (mut image, mut bad, mut errors) = (FrameImage::black(40, 20), BadSamples::default(), Vec::new());
    for start in (0..6).step_by(group) {
        let tiles = start..(start + group).min(6);
        let piece = ImagePiece::decode(&ImagePiece::from_frame(&frame, tiles.clone()).unwrap().encode()).unwrap();
        let counted: Vec<u32> = piece.samples().iter().map(|range| range.len()).collect();
        assert_eq!(counted, counts[tiles.clone()]);
        image.put(&piece).unwrap();
        bad.merge(piece.bad_samples());
        let of =
            ErrorStatistics::decode(&ErrorStatistics::from_frame(&frame, tiles.clone()).unwrap().encode()).unwrap();
        assert_eq!((of.tiling(), of.tiles()), (tiling, tiles));
        errors.extend(of.into_tiles());
    }
    (image, bad, errors)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, rng_seed: proptest::test_runner::RngSeed::Fixed(5), ..ProptestConfig::default() })]

    #[test]
    fn uneven_tiles_are_bit_identical_for_any_parts_and_order(
        counts in prop::collection::vec(1u32..40, 6),
        cuts in prop::collection::vec(1u32..40, 0..6),
        group in 1usize..7,
        is_late in any::<bool>(),
    ) {
        let whole = render_in_parts(&counts, &[], 6, false);
        let (image, bad, errors) = render_in_parts(&counts, &cuts, group, is_late);
        prop_assert_eq!(&image.color, &whole.0.color);
        prop_assert_eq!(pixel_digest(&image.color), pixel_digest(&whole.0.color));
        prop_assert_eq!(format!("{:?}", (&image, bad, &errors)), format!("{:?}", (&whole.0, whole.1, &whole.2)));
        // Each tile is the same as alone: the sample counts of other tiles do not affect it.
        for (rect, (index, &count)) in Tiling::new(40, 20, 16).unwrap().rects().zip(counts.iter().enumerate()) {
            let alone = tile(rect, 0..count);
            for ((x, y), sums) in rect.pixels().zip(alone.pixels()) {
                let at = (y * 40 + x) as usize;
                prop_assert_eq!(image.samples[at], sums.samples());
            }
            prop_assert_eq!((errors[index].samples, errors[index].bad), ((0..count).into(), alone.bad_samples().total()));
        }
    }
}

#[test]
fn the_error_of_the_tiles_is_the_error_of_the_image() {
    let (image, _, errors) = render_in_parts(&[4, 7, 32, 2, 16, 9], &[], 4, false);
    let of_tiles = FrameError::from_blocks(errors.iter().flat_map(|tile| &tile.blocks).map(|it| it.block).collect());
    assert_eq!(of_tiles, image.error());
    for half in 0..2 {
        assert!(
            errors[2].worst_error(half, of_tiles.floor, 0.0) < errors[4].worst_error(half, of_tiles.floor, 0.0),
            "more samples"
        );
        assert_eq!(errors[3].worst_error(half, of_tiles.floor, 0.0), f64::INFINITY, "two samples tell a half nothing");
    }
}

/// Makes a block of 16 x 16 pixels with independent samples: `v(x, y, sample)`.
fn block(samples: std::ops::Range<u32>, v: impl Fn(u32, u32, u32) -> f32) -> TileErrors {
    let rect = Rect { x: 0, y: 0, width: 16, height: 16 };
    let mut frame = Frame::new(Tiling::new(16, 16, 16).unwrap());
    let mut all = Tile::new(rect, samples.clone()).unwrap();
    for ((x, y), i) in rect.pixels().flat_map(|pixel| samples.clone().map(move |i| (pixel, i))) {
        all.add(x, y, i, &Sample { color: Rgb::splat(v(x, y, i)), ..Sample::MISS });
    }
    frame.insert(all).unwrap();
    ErrorStatistics::from_frame(&frame, 0..1).unwrap().into_tiles().remove(0)
}

fn unit(x: u32, y: u32, i: u32, place: u64) -> f32 {
    hash::unit_f32(hash::combine(&[u64::from(x), u64::from(y), u64::from(i), place]) as u32)
}

#[test]
fn block_variance_and_bounds_match_independent_samples() {
    for samples in [16, 20, 63] {
        let all: Vec<TileErrors> = (0..64).map(|place| block(0..samples, |x, y, i| unit(x, y, i, place))).collect();
        // A uniform number has the variance 1/12.
        let expected = 256.0 / 12.0 / f64::from(samples);
        let found = all.iter().map(|tile| tile.blocks[0].block.variance).sum::<f64>() / 64.0 / expected;
        // 64 x 256 squares of a normal number: their mean deviates by sqrt(2 / 64 / 256), and this is 4 times that.
        assert!((found - 1.0).abs() < 4.0 * (2.0f64 / 64.0 / 256.0).sqrt(), "{samples}: {found}");
        let freedom = all.iter().map(|tile| tile.blocks[0].block.freedom).sum::<f64>() / 64.0;
        assert!((freedom / 256.0 - 1.0).abs() < 0.1, "{freedom}");
        for half in 0..2 {
            let bounds = all.iter().map(|tile| tile.blocks[0].halves[half].bound / (2.0 * expected));
            let above = bounds.filter(|bound| *bound > 1.0).count();
            assert!(
                (55..64).contains(&above),
                "{samples}: {above} of 64 bounds are above the variance, 95 % of 64 are 61"
            );
        }
    }
}

#[test]
fn bounds_include_unseen_light_and_ignore_always_bad_pixels() {
    // A constant: nothing varies, but three more events of the brightest sample's size may be unseen.
    let tile = block(0..16, |_, _, _| 2.0);
    assert_eq!((tile.blocks[0].block.variance, tile.blocks[0].halves[0].bound), (0.0, 3.0 * (2.0f64 / 8.0).powi(2)));
    let relative = tile.worst_error(0, 0.0, f64::INFINITY);
    assert!((relative - 1.959_964 * 1.5f64.sqrt() * 0.25 / 512.0).abs() < 1e-9, "{relative}");
    let black = block(0..16, |_, _, _| 0.0);
    assert_eq!((black.worst_error(0, 1.0, 7.0), black.blocks[0].block.relative_error(1.0)), (7.0, None), "unlit");
    let bad = block(0..16, |x, y, _| if (x, y) == (3, 3) { f32::NAN } else { 2.0 });
    assert!(bad.worst_error(1, 0.0, 0.0).is_finite() && bad.bad == 16);
    assert!(
        block(0..4, |x, y, _| if (x, y) == (3, 3) { f32::NAN } else { 2.0 }).worst_error(1, 0.0, 0.0).is_infinite()
    );
}

#[test]
fn damaged_errors_are_refused() {
    let bytes = ErrorStatistics::from_frame(&frame(), 2..3).unwrap().encode();
    for cut in 0..bytes.len() {
        assert!(ErrorStatistics::decode(&bytes[..cut]).is_err(), "cut at {cut}");
    }
    for bit in 0..8 * bytes.len() {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(ErrorStatistics::decode(&damaged).is_err(), "bit {bit}");
    }
    assert!(ImagePiece::decode(&bytes).is_err() && Tile::decode(&bytes).is_err());
    // Correct checksums around wrong numbers.
    let words = [8u32, 8, 8, 0, 1, 0, 4, 0, 0, 7, 0, 4, u32::MAX];
    let forged = |words: &[u32], numbers: [f64; 7]| {
        let planes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let payload = zstd::bulk::compress(&planes, 1).unwrap();
        let body: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).chain(payload).collect();
        ErrorStatistics::decode(
            &[b"FEMCERRS", &3u32.to_le_bytes()[..], &blake3::hash(&body).as_bytes()[..16], &body].concat(),
        )
    };
    assert!(forged(&words, [1.0, 0.5, 1.0, 1.5, 0.0, 0.0, 2.0]).is_ok());
    assert!(forged(&words, [1.0, f64::INFINITY, f64::INFINITY, 0.0, f64::INFINITY, 1.0, 1.0]).is_ok());
    for (place, wrong) in
        [(0, f64::INFINITY), (3, f64::INFINITY), (5, -1.0)].into_iter().chain((0..7).map(|i| (i, f64::NAN)))
    {
        let mut numbers = [1.0; 7];
        numbers[place] = wrong;
        assert!(forged(&words, numbers).is_err(), "{numbers:?}");
    }
    assert!(forged(&[8, 8, 8, 0, 1, 4, 4, 0, 0, 4, 4], [1.0; 7]).is_err(), "no samples");
    assert!(forged(&[8, 8, 8, 0, 2, 0, 4, 0, 0, 4, 4], [1.0; 7]).is_err(), "more tiles than the film has");
    assert!(
        forged(&[1 << 13, 1 << 13, 8, 0, 1 << 20, 0, 4, 0, 0, 4, 4], [1.0; 7]).is_err(),
        "more than its bytes tell of"
    );
}

#[test]
fn a_tile_that_is_not_whole_makes_no_piece() {
    let tiling = Tiling::new(16, 8, 8).unwrap();
    let mut frame = Frame::new(tiling);
    let rects: Vec<Rect> = tiling.rects().collect();
    frame.insert(tile(rects[0], 0..4)).unwrap();
    assert!(matches!(ImagePiece::from_frame(&frame, 0..2), Err(FilmError::Gap(rect)) if rect == rects[1]));
    frame.insert(tile(rects[1], 0..2)).unwrap();
    assert_eq!(ImagePiece::from_frame(&frame, 0..2).unwrap().samples(), [(0..4).into(), (0..2).into()]);
    frame.insert(tile(rects[1], 2..4)).unwrap();
    assert_eq!(
        ImagePiece::from_frame(&frame, 0..2).unwrap().samples(),
        [(0..4).into(); 2],
        "in whatever parts they came"
    );
    assert!(ImagePiece::from_frame(&frame, 0..1).is_ok() && ImagePiece::from_frame(&frame, 1..3).is_err());
    let mut frame = Frame::new(tiling);
    frame.insert(tile(rects[0], 0..2)).unwrap();
    frame.insert(tile(rects[0], 3..4)).unwrap();
    assert!(
        ImagePiece::from_frame(&frame, 0..1).is_err() && ErrorStatistics::from_frame(&frame, 0..1).is_err(),
        "a gap"
    );
    assert!(
        ImagePiece::from_frame(&frame, 0..0).is_err() && ErrorStatistics::from_frame(&frame, 0..0).is_err(),
        "no tiles"
    );
}

#[test]
fn a_piece_of_another_film_is_refused() {
    let piece = ImagePiece::from_frame(&frame(), 0..6).unwrap();
    let mut other = FrameImage::black(16, 20);
    assert!(matches!(other.put(&piece), Err(FilmError::OtherPixels { .. })));
    assert_eq!(other, FrameImage::black(16, 20));
}

#[test]
fn every_cut_and_every_flipped_bit_is_an_error() {
    let bytes = ImagePiece::from_frame(&frame(), 2..3).unwrap().encode();
    for cut in 0..bytes.len() {
        assert!(ImagePiece::decode(&bytes[..cut]).is_err(), "cut at {cut}");
    }
    for bit in 0..8 * bytes.len() {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(ImagePiece::decode(&damaged).is_err(), "bit {bit}");
    }
    assert!(Tile::decode(&bytes).is_err());
}
