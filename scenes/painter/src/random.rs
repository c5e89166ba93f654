//! Stateless randomness and noise: equal words give equal values.

use femc_math::hash::{combine, mix32, unit_f32};

/// Returns a number in 0..1 from a hash of `words`.
pub fn unit(words: &[u64]) -> f32 {
    unit_f32((combine(words) >> 32) as u32)
}

/// Returns a number in -1..1 from a hash of `words`.
pub fn signed(words: &[u64]) -> f32 {
    2.0 * unit(words) - 1.0
}

/// Smooth noise in -1..1 with features one unit wide.
pub fn noise(seed: u32, x: f32, y: f32) -> f32 {
    let (column, row) = (x.floor(), y.floor());
    let (u, v) = (x - column, y - row);
    let at = |dx: i32, dy: i32| {
        let key = mix32(mix32((column as i32 + dx) as u32 ^ seed.wrapping_mul(0x9e37_79b9)) ^ (row as i32 + dy) as u32);
        2.0 * unit_f32(key) - 1.0
    };
    let (s, t) = (u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v));
    let top = at(0, 0) + s * (at(1, 0) - at(0, 0));
    let bottom = at(0, 1) + s * (at(1, 1) - at(0, 1));
    top + t * (bottom - top)
}

/// Noise of several sizes, about -1..1: features of one unit, a half, a quarter, and so on.
pub fn cloud(seed: u32, x: f32, y: f32, octaves: u32) -> f32 {
    let (mut sum, mut weight, mut scale) = (0.0, 0.5, 1.0);
    for octave in 0..octaves {
        sum += weight * noise(seed + octave, x * scale, y * scale);
        (weight, scale) = (weight * 0.5, scale * 2.03);
    }
    1.4 * sum
}

/// Possible start of a stroke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StrokeStart {
    /// Key for all random properties of the stroke.
    pub key: u64,
    /// Column in picture pixels.
    pub x: f32,
    /// Row in picture pixels.
    pub y: f32,
}

/// Draws positions over a picture and slightly beyond, one in each square of `apart` pixels, in an order without direction.
pub fn stroke_starts(seed: u64, width: usize, height: usize, apart: f32) -> Vec<StrokeStart> {
    let count = |pixels: usize| (pixels as f32 / apart) as u64 + 1;
    let (columns, rows) = (count(width), count(height));
    let start = |square: u64| {
        let key = combine(&[seed, square]);
        let within = |word: u64| unit(&[key, word]);
        let (column, row) = ((square % columns) as f32, (square / columns) as f32);
        StrokeStart { key, x: (column + within(u64::MAX)) * apart, y: (row + within(u64::MAX - 1)) * apart }
    };
    let mut starts: Vec<StrokeStart> = (0..columns * rows).map(start).collect();
    starts.sort_by_key(|place| place.key);
    starts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_one_to_a_square_and_in_no_order_of_rows() {
        let starts = stroke_starts(3, 40, 20, 10.0);
        let mut squares: Vec<_> = starts.iter().map(|p| ((p.y / 10.0) as usize, (p.x / 10.0) as usize)).collect();
        assert!(!squares.is_sorted());
        squares.sort_unstable();
        let all: Vec<_> = (0..3).flat_map(|row| (0..5).map(move |column| (row, column))).collect();
        assert_eq!(squares, all);
        assert_eq!(stroke_starts(3, 40, 20, 10.0), starts);
        assert_ne!(stroke_starts(4, 40, 20, 10.0), starts);
    }

    #[test]
    fn noise_is_smooth_and_within_its_bounds() {
        for n in 0..2000 {
            let (x, y) = (0.37 * n as f32 - 300.0, 0.11 * n as f32);
            let [here, near] = [noise(9, x, y), noise(9, x + 1e-3, y)];
            assert!(here.abs() <= 1.0 && (here - near).abs() < 5e-3, "at {x}, {y}: {here} and {near}");
            assert!(cloud(9, x, y, 4).abs() <= 1.4);
        }
    }
}
