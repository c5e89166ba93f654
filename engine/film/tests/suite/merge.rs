//! Tests of the merge laws: the image is a function of the set of samples, whatever the order, the division and the repetitions.

use femc_film::{BadKind, FilmError, Frame, InsertOutcome, Rect, Sample, Tile, Tiling};
use femc_math::{Rgb, hash};
use proptest::prelude::*;

const RECT: Rect = Rect { x: 16, y: 8, width: 5, height: 3 };
const SPP: u32 = 24;

/// Draws sample `index` of a pixel: values over forty binary orders, some misses, a few bad ones.
fn draw(x: u32, y: u32, index: u32) -> Sample {
    let word = |k: u64| hash::combine(&[u64::from(x), u64::from(y), u64::from(index), k]);
    let value = |k: u64| {
        hash::unit_f32(word(k) as u32)
            * (word(k + 100) % 40) as f32
            * 0.01
            * 2f32.powi((word(k + 200) % 40) as i32 - 20)
    };
    let mut sample = Sample {
        color: Rgb::new(value(0), value(1), value(2)),
        albedo: Rgb::splat(hash::unit_f32(word(3) as u32)),
        depth: if word(4) % 5 == 0 { f32::INFINITY } else { value(5) },
    };
    match word(6) % 40 {
        0 => sample.color.y = f32::NAN,
        1 => sample.color.x = f32::INFINITY,
        2 => sample.albedo.z = -0.5,
        _ => {}
    }
    sample
}

fn render(rect: Rect, samples: std::ops::Range<u32>) -> Tile {
    let mut tile = Tile::new(rect, samples.clone()).unwrap();
    for (x, y) in rect.pixels() {
        for i in samples.clone() {
            tile.add(x, y, i, &draw(x, y, i));
        }
    }
    tile
}

/// Returns the ranges between sorted distinct cuts of 0..SPP.
fn partition(mut cuts: Vec<u32>) -> Vec<std::ops::Range<u32>> {
    cuts.extend([0, SPP]);
    cuts.sort_unstable();
    cuts.dedup();
    cuts.windows(2).map(|w| w[0]..w[1]).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, rng_seed: proptest::test_runner::RngSeed::Fixed(7), ..ProptestConfig::default() })]

    #[test]
    fn any_order_and_partition_gives_the_same_bytes(
        cuts in prop::collection::vec(1..SPP, 0..6),
        picks in prop::collection::vec(any::<prop::sample::Index>(), 40),
    ) {
        let whole = render(RECT, 0..SPP);
        let parts: Vec<Tile> = partition(cuts).into_iter().map(|r| render(RECT, r)).collect();
        // Every part at least once, and some again, in a random order, some through the codec.
        let mut order: Vec<usize> = (0..parts.len()).chain(picks.iter().take(5).map(|p| p.index(parts.len()))).collect();
        for (i, pick) in (0..order.len()).zip(&picks[5..]) {
            let other = pick.index(order.len());
            order.swap(i, other);
        }
        let mut merged = parts[order[0]].clone();
        let mut seen = vec![order[0]];
        for &i in &order[1..] {
            let part = if i % 2 == 0 { Tile::decode(&parts[i].encode()).unwrap() } else { parts[i].clone() };
            let expected = if seen.contains(&i) { InsertOutcome::Known } else { InsertOutcome::New };
            prop_assert_eq!(merged.merge(&part).unwrap(), expected);
            seen.push(i);
        }
        prop_assert_eq!(merged.pixels(), whole.pixels());
        prop_assert_eq!(merged.bad_samples(), whole.bad_samples());
        prop_assert_eq!(merged.spp(), u64::from(SPP));

        // The same parts in key order, and grouped as a tree: the same bytes.
        let mut in_order = parts[0].clone();
        parts[1..].iter().for_each(|p| { in_order.merge(p).unwrap(); });
        prop_assert_eq!(in_order.encode(), merged.encode());
        let mut halves = parts.chunks(parts.len().div_ceil(2)).map(|half| {
            let mut sum = half[0].clone();
            half[1..].iter().rev().for_each(|p| { sum.merge(p).unwrap(); });
            sum
        });
        let mut tree = halves.next_back().unwrap();
        halves.for_each(|h| { tree.merge(&h).unwrap(); });
        prop_assert_eq!(tree.encode(), merged.encode());
    }

    #[test]
    fn any_cut_into_tiles_gives_the_same_image(edge in 3u32..40, turn in 0usize..50) {
        let (width, height) = (37, 21);
        let image = |edge: u32, turn: usize| {
            let tiling = Tiling::new(width, height, edge).unwrap();
            let mut frame = Frame::new(tiling);
            let mut rects: Vec<Rect> = tiling.rects().collect();
            let by = turn % rects.len();
            rects.rotate_left(by);
            for rect in rects {
                for range in [2..5, 0..2] {
                    frame.insert(render(rect, range)).unwrap();
                }
            }
            (frame.resolve(), frame.bad_samples())
        };
        prop_assert_eq!(image(edge, turn), image(64, 0));
    }
}

#[test]
fn overlapping_ranges_are_an_error_and_change_nothing() {
    let mut tile = render(RECT, 4..8);
    let before = tile.clone();
    for range in [3..5, 7..9, 5..6, 0..20, 4..7] {
        assert!(matches!(tile.merge(&render(RECT, range)), Err(FilmError::Overlap { .. })));
    }
    let mut known_and_new = render(RECT, 8..10);
    known_and_new.merge(&before).unwrap();
    assert!(matches!(tile.merge(&known_and_new), Err(FilmError::Overlap { .. })));
    let elsewhere = Rect { x: RECT.x + 1, ..RECT };
    assert!(matches!(tile.merge(&render(elsewhere, 8..9)), Err(FilmError::OtherPixels { .. })));
    assert_eq!(tile, before);
    assert!(matches!(Frame::new(Tiling::new(64, 64, 16).unwrap()).insert(before), Err(FilmError::NotInFrame(_))));
}

#[test]
fn nan_sample_is_counted_with_its_place_and_changes_no_pixel() {
    let rect = Rect { x: 0, y: 0, width: 2, height: 2 };
    let mut clean = Tile::new(rect, 0..4).unwrap();
    let mut planted = clean.clone();
    for i in 0..4 {
        let good = Sample { color: Rgb::splat(i as f32), albedo: Rgb::splat(0.5), depth: 3.0 };
        for (x, y) in rect.pixels() {
            if (x, y, i) != (1, 0, 2) {
                clean.add(x, y, i, &good);
                planted.add(x, y, i, &good);
            }
        }
    }
    planted.add(1, 0, 2, &Sample { color: Rgb::new(1.0, f32::NAN, 1.0), ..Sample::MISS });
    assert_eq!(planted.pixels(), clean.pixels());
    assert_eq!((planted.bad_samples().total(), planted.bad_samples().count(BadKind::NotANumber)), (1, 1));
    let first = planted.bad_samples().first.unwrap();
    assert_eq!((first.x, first.y, first.sample), (1, 0, 2));

    let mut frame = Frame::new(Tiling::new(2, 2, 64).unwrap());
    frame.insert(planted).unwrap();
    let image = frame.resolve();
    assert_eq!(image.samples, [4, 3, 4, 4]);
    assert_eq!(image.color.pixels[1], [4.0 / 3.0; 3]);
    assert_eq!(image.color.pixels[0], [1.5; 3]);
    assert_eq!(
        frame.bad_samples().to_string(),
        "1 bad samples (1 NaN, 0 infinite, 0 negative, 0 out of range), first: pixel 1,0 sample 2"
    );
}

#[test]
fn means_variances_and_layers_are_those_of_the_samples() {
    let mut tile = Tile::new(Rect { x: 0, y: 0, width: 1, height: 1 }, 0..4).unwrap();
    for (i, v) in [1.0f32, 2.0, 3.0, 6.0].into_iter().enumerate() {
        let depth = if i == 0 { f32::INFINITY } else { v };
        let sample = Sample { color: Rgb::new(v, 2.0 * v, 0.0), albedo: Rgb::new(0.25, 1.0, 300.0), depth };
        tile.add(0, 0, i as u32, &sample);
    }
    let mut frame = Frame::new(Tiling::new(1, 1, 64).unwrap());
    frame.insert(tile).unwrap();
    let image = frame.resolve();
    assert_eq!(image.color.pixels[0], [3.0, 6.0, 0.0]);
    // The halves have the means 2 and 4: a quarter of the square of their difference.
    assert_eq!(image.variance[0], [1.0, 4.0, 0.0]);
    assert!((image.luminance_variance[0] / (0.2126f32 + 2.0 * 0.7152).powi(2) - 1.0).abs() < 1e-4);
    assert_eq!(image.albedo[0], [0.25, 1.0, 255.0]);
    assert_eq!(image.depth[0], 11.0 / 3.0);
    assert_eq!((image.samples[0], image.mean_spp()), (4, 4.0));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, rng_seed: proptest::test_runner::RngSeed::Fixed(9), ..ProptestConfig::default() })]

    #[test]
    fn what_is_held_does_not_count_in_the_image_whatever_the_order(
        cuts in prop::collection::vec(1..SPP, 1..6),
        at in prop::collection::vec(any::<prop::sample::Index>(), 2),
        turn in any::<prop::sample::Index>(),
        is_late in any::<bool>(),
    ) {
        let ranges = partition(cuts);
        let ends = [0, 1].map(|half| ranges[at[half].index(ranges.len())].end);
        let mut parts: Vec<Tile> = ranges.iter().map(|range| render(RECT, range.clone())).collect();
        let by = turn.index(parts.len());
        parts.rotate_left(by);
        let mut merged = parts[0].clone();
        if !is_late {
            merged.hold(ends).unwrap();
        }
        for part in &parts[1..] {
            // Some parts know what is held, others do not. A part still knows it after a round trip through its bytes.
            let mut part = part.clone();
            if is_late {
                part.hold(ends).unwrap();
            }
            merged.merge(&Tile::decode(&part.encode()).unwrap()).unwrap();
        }
        if parts.len() == 1 {
            merged.hold(ends).unwrap();
        }
        let whole = render(RECT, 0..SPP);
        for (half, &end) in ends.iter().enumerate() {
            let counted = render(RECT, 0..end);
            for ((found, counted), whole) in merged.pixels().iter().zip(counted.pixels()).zip(whole.pixels()) {
                prop_assert_eq!((found.color[half], found.half_counts[half]), (counted.color[half], counted.half_counts[half]));
                prop_assert_eq!((found.luminance, found.replicate_counts, found.peak), (whole.luminance, whole.replicate_counts, whole.peak));
                prop_assert_eq!((found.depth, found.albedo, found.hits), (whole.depth, whole.albedo, whole.hits));
            }
        }
        prop_assert_eq!((merged.ends(), merged.spp()), (ends, u64::from(SPP)));
    }
}

#[test]
fn sum_across_an_end_cannot_be_held_and_ends_never_move_back() {
    let mut tile = render(RECT, 0..8);
    let before = tile.clone();
    assert!(tile.hold([4, 8]).is_err());
    assert_eq!(tile, before);
    tile.hold([8, 16]).unwrap();
    tile.hold([12, 12]).unwrap();
    assert_eq!(tile.ends(), [8, 12]);
    let mut late = render(RECT, 4..16);
    assert!(late.merge(&render(RECT, 0..4)).is_ok() && tile.merge(&late).is_err(), "half of what comes is held");
}

#[test]
fn of_halves_that_ended_apart_each_has_half_of_the_weight() {
    let mut tile = Tile::new(Rect { x: 0, y: 0, width: 1, height: 1 }, 0..4).unwrap();
    for i in 0..4 {
        tile.add(0, 0, i, &Sample { color: Rgb::splat(1.0 + (i % 2) as f32), ..Sample::MISS });
    }
    let mut more = Tile::new(tile.rect(), 4..12).unwrap();
    for i in 4..12 {
        more.add(0, 0, i, &Sample { color: Rgb::splat(5.0), ..Sample::MISS });
    }
    tile.hold([4, u32::MAX]).unwrap();
    tile.merge(&more).unwrap();
    let mut frame = Frame::new(Tiling::new(1, 1, 64).unwrap());
    frame.insert(tile).unwrap();
    let image = frame.resolve();
    let of_b = (2.0 * 2.0 + 4.0 * 5.0) / 6.0;
    assert!((image.color.pixels[0][1] - 0.5 * (1.0 + of_b)).abs() < 1e-6);
    assert!((image.variance[0][1] - 0.25 * (of_b - 1.0) * (of_b - 1.0)).abs() < 1e-6);
    assert_eq!(image.samples[0], 8);
}

#[test]
fn pixels_without_samples_are_black_and_never_nan() {
    let frame = Frame::new(Tiling::new(20, 20, 16).unwrap());
    let image = frame.resolve();
    assert!(image.color.pixels.iter().flatten().all(|&v| v == 0.0));
    assert!(image.variance.iter().flatten().all(|&v| v == 0.0));
    assert_eq!(image.error().worst, f64::INFINITY);
}

#[test]
fn a_sum_out_of_range_is_reported() {
    let mut tile = Tile::new(Rect { x: 0, y: 0, width: 2, height: 1 }, 0..300).unwrap();
    for i in 0..300 {
        tile.add(0, 0, i, &Sample { depth: 1e30, ..Sample::MISS });
        tile.add(1, 0, i, &Sample { color: Rgb::splat(femc_film::sample::MAX_RADIANCE), ..Sample::MISS });
    }
    assert_eq!((tile.saturated_pixels(), tile.bad_samples().total()), (1, 0));
}
