//! Pieces of a frame: the image that they make is the frame's own, and damage of any kind is an error.

use femc_film::{FilmError, Frame, FrameImage, Piece, Rect, Sample, SampleRange, Tile, Tiling};
use femc_math::{Rgb, hash};

/// A frame of 6 tiles, two of them narrow, with misses and a bad sample.
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
        let mut bad = femc_film::BadSamples::default();
        for start in (0..6).step_by(size) {
            let piece = Piece::of(&frame, start..(start + size).min(6)).unwrap();
            let bytes = piece.encode();
            let piece = Piece::decode(&bytes).unwrap();
            assert_eq!((piece.encode(), Some(piece.samples())), (bytes, SampleRange::joined(frame.ranges(0))));
            bad.merge(piece.bad());
            image.put(&piece).unwrap();
        }
        assert_eq!((image, bad), (frame.resolve(), frame.bad()), "pieces of {size} tiles");
    }
}

#[test]
fn tiles_that_hold_other_samples_make_no_piece() {
    let tiling = Tiling::new(16, 8, 8).unwrap();
    let mut frame = Frame::new(tiling);
    let rects: Vec<Rect> = tiling.rects().collect();
    frame.insert(tile(rects[0], 0..4)).unwrap();
    assert!(matches!(Piece::of(&frame, 0..2), Err(FilmError::Uneven(rect)) if rect == rects[1]));
    frame.insert(tile(rects[1], 0..2)).unwrap();
    assert!(Piece::of(&frame, 0..2).is_err());
    frame.insert(tile(rects[1], 2..4)).unwrap();
    assert_eq!(
        Piece::of(&frame, 0..2).map(|piece| piece.samples()).ok(),
        Some((0..4).into()),
        "in whatever parts they came"
    );
    assert!(Piece::of(&frame, 0..1).is_ok() && Piece::of(&frame, 1..3).is_err());
    let mut frame = Frame::new(tiling);
    frame.insert(tile(rects[0], 0..2)).unwrap();
    frame.insert(tile(rects[0], 3..4)).unwrap();
    assert!(Piece::of(&frame, 0..1).is_err(), "a gap");
}

#[test]
fn a_piece_of_another_film_is_refused() {
    let piece = Piece::of(&frame(), 0..6).unwrap();
    let mut other = FrameImage::black(16, 20);
    assert!(matches!(other.put(&piece), Err(FilmError::OtherPixels { .. })));
    assert_eq!(other, FrameImage::black(16, 20));
}

#[test]
fn every_cut_and_every_flipped_bit_is_an_error() {
    let bytes = Piece::of(&frame(), 2..3).unwrap().encode();
    for cut in 0..bytes.len() {
        assert!(Piece::decode(&bytes[..cut]).is_err(), "cut at {cut}");
    }
    for bit in 0..8 * bytes.len() {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(Piece::decode(&damaged).is_err(), "bit {bit}");
    }
    assert!(Tile::decode(&bytes).is_err());
}
