//! Laws of bins: the edges come from the table of scales in whole numbers, and the bins of a value from comparisons with all edges.

use crate::synthetic::scope;
use femc_paths::schema::{FINE_BINS, Scale, Value, Words, count_bin, name_bin, radiance_bin, throughput_bin};
use femc_paths::{Name, Scope};

/// Checks whether `mantissa` 2^`exponent` is at least 2^(`fourths` / 4), in whole numbers.
fn is_at_least(mantissa: u64, exponent: i32, fourths: i32) -> bool {
    let power = fourths - 4 * exponent;
    power <= 0 || power < 128 && u128::from(mantissa).pow(4) >= 1 << power
}

/// Returns the mantissa and the exponent of a positive number.
fn parts(value: f32) -> (u64, i32) {
    let (exponent, mantissa) = (value.to_bits() >> 23, u64::from(value.to_bits() & 0x7f_ffff));
    if exponent == 0 { (mantissa, -149) } else { (mantissa | 0x80_0000, exponent as i32 - 150) }
}

/// Returns the 32-bit number that is nearest to 2^(`fourths` / 4).
pub(crate) fn nearest_power(fourths: i32) -> f32 {
    // The least number at or above it.
    let (mut low, mut high) = (1u32, f32::MAX.to_bits());
    while low < high {
        let middle = low + (high - low) / 2;
        let (mantissa, exponent) = parts(f32::from_bits(middle));
        if is_at_least(mantissa, exponent, fourths) { high = middle } else { low = middle + 1 }
    }
    let (above, below) = (f32::from_bits(low), f32::from_bits(low - 1));
    let ((above_part, exponent), (below_part, other)) = (parts(above), parts(below));
    // A power of two is itself a number. Otherwise, the middle between both numbers decides.
    if exponent == other && is_at_least(above_part + below_part, exponent - 1, fourths) { below } else { above }
}

/// Edges of the bins 2 to 63: two an octave from 2^-10 on, and four an octave from 2^-11.75 on.
pub(crate) fn edges(scale: Scale) -> Vec<f32> {
    let is_radiance = scale == Scale::Radiance;
    (0..62).map(|bin| nearest_power(if is_radiance { -40 + 2 * bin } else { -47 + bin })).collect()
}

/// Returns the bin of a number among edges.
pub(crate) fn bin_among(edges: &[f32], value: f32) -> u8 {
    if value > 0.0 { 1 + edges.iter().filter(|edge| **edge <= value).count() as u8 } else { 0 }
}

#[test]
fn bins_of_light_begin_at_powers_of_two() {
    let radiance: (Scale, fn(f32) -> u8) = (Scale::Radiance, radiance_bin);
    for (scale, bin) in [radiance, (Scale::Throughput, throughput_bin)] {
        let edges = edges(scale);
        let ends = if scale == Scale::Radiance { [1.0 / 1024.0, 1_482_910.4] } else { [0.000_290_3, 11.313_708] };
        assert!((edges[0] / ends[0] - 1.0).abs() < 1e-3 && (edges[61] / ends[1] - 1.0).abs() < 1e-6, "{edges:?}");
        let mut values = vec![0.0, -0.0, -1.0, f32::from_bits(1), f32::MIN_POSITIVE, 1e-30, 1e30, f32::MAX];
        values.push(f32::INFINITY);
        for pair in edges.windows(2) {
            values.extend([pair[0].next_down(), pair[0], pair[0].next_up(), (pair[0] + pair[1]) / 2.0]);
        }
        values.extend([edges[61].next_down(), edges[61], edges[61].next_up()]);
        for value in values {
            let expected = bin_among(&edges, value);
            assert_eq!(bin(value), expected, "{value:e} on {scale:?}");
            assert_eq!(scale.bin(&scope(1), Some(Value::Number(f64::from(value)))), expected, "{value:e}");
        }
        assert_eq!(scale.bin(&scope(1), Some(Value::Number(1e300))), 63);
        for number in 0..64u8 {
            let edge = usize::from(number).checked_sub(2).map_or(0.0, |at| f64::from(edges[at]));
            assert_eq!(scale.lower_edge(&scope(1), number), Some(edge), "{number} on {scale:?}");
        }
    }
}

#[test]
fn bins_of_the_film_are_64_equal_parts() {
    for size in [1u32, 7, 36, 63, 64, 65, 100, 512, 65_536] {
        let scope = Scope { film: [size, 3], ..scope(1) };
        for place in (0..size).filter(|place| size < 1000 || place % 37 == 0 || size - place < 3) {
            let found = Scale::Film(0).bin(&scope, Some(Value::Number(f64::from(place))));
            // The part that begins at or before the place and ends after it.
            let parts: Vec<u32> =
                (0..64).filter(|part| part * size <= 64 * place && 64 * place < (part + 1) * size).collect();
            assert_eq!(parts, [u32::from(found)], "{place} of {size}");
        }
        let edges: Vec<f64> = (0..64).filter_map(|bin| Scale::Film(0).lower_edge(&scope, bin)).collect();
        assert!((0u32..).zip(&edges).all(|(bin, edge)| edge * 64.0 == f64::from(bin * size)) && edges.len() == 64);
    }
    // Rows are parts of the height.
    let scope = Scope { film: [128, 64], ..scope(1) };
    let bins = [0, 1].map(|axis| Scale::Film(axis).bin(&scope, Some(Value::Number(63.0))));
    assert_eq!(bins, [31, 63]);
}

#[test]
fn bins_of_the_world_are_63_equal_parts_of_its_box() {
    // A part is 1 m, 0.5 m and 4 m wide.
    let scope = Scope { lower: [-10.0, 0.0, -126.0], upper: [53.0, 31.5, 126.0], ..scope(1) };
    for (axis, (low, width)) in [(-10.0, 1.0), (0.0, 0.5), (-126.0, 4.0)].into_iter().enumerate() {
        let bin = |value: f64| Scale::World(axis).bin(&scope, Some(Value::Number(value)));
        for part in 0..63u8 {
            let edge = low + width * f64::from(part);
            let inside = [edge + 1e-9, edge + width / 2.0, edge + width - 1e-9];
            assert_eq!(inside.map(bin), [part + 1; 3], "part {part} of axis {axis}");
            let found = Scale::World(axis).lower_edge(&scope, part + 1).unwrap();
            assert!((found - edge).abs() < 1e-9, "{found}, not {edge}");
        }
        assert_eq!([low, low - 1e-9, low - 1e9, f64::MIN, f64::NEG_INFINITY].map(bin), [1; 5]);
        let high = low + 63.0 * width;
        assert_eq!([high, high - 1e-9, high + 1e-9, 1e9, f64::MAX, f64::INFINITY].map(bin), [63; 6]);
        assert_eq!((Scale::World(axis).bin(&scope, None), Scale::World(axis).lower_edge(&scope, 0)), (0, None));
    }
    let flat = Scope { lower: [2.0; 3], upper: [2.0; 3], ..scope };
    assert_eq!(Scale::World(1).bin(&flat, Some(Value::Number(2.0))), 1);
}

#[test]
fn bins_of_numbers_words_and_names_follow_the_table() {
    for (number, bin) in [(0, 0), (1, 1), (9, 9), (62, 62), (63, 63), (64, 63), (1000, 63), (u32::MAX, 63)] {
        assert_eq!(count_bin(number), bin);
        assert_eq!(Scale::Count.bin(&scope(1), Some(Value::Number(f64::from(number)))), bin);
    }
    for words in [Words::End, Words::Interaction, Words::Technique] {
        let scale = Scale::Class(words);
        let bins: Vec<u8> =
            (0..words.list().len() as u8).map(|it| scale.bin(&scope(1), Some(Value::Word(it)))).collect();
        assert!(bins.iter().copied().eq(1..=bins.len() as u8) && scale.bin(&scope(1), None) == 0);
        assert_eq!(scale.lower_edge(&scope(1), 1), None);
    }
    for (key, bin) in [(0, 0), (1, 2), (62, 63), (63, 1), (64, 2), (125, 63), (126, 1), (u64::MAX, 16)] {
        assert_eq!(name_bin(Name(key)), bin, "{key}");
        assert_eq!(Scale::Name.bin(&scope(1), Some(Value::Name(Name(key)))), bin);
    }
    // Ten runs of the fine bins. Of numbers and words, the first nine bins and the rest.
    let starts = [0, 7, 13, 20, 26, 32, 39, 45, 52, 58];
    for fine in 0..FINE_BINS as u8 {
        let run = starts.iter().filter(|start| **start <= fine).count() as u8 - 1;
        for scale in [Scale::Film(0), Scale::World(2), Scale::Radiance, Scale::Throughput, Scale::Name] {
            assert_eq!(scale.coarse(fine), run, "{fine} on {scale:?}");
        }
        for scale in [Scale::Count, Scale::Class(Words::End)] {
            assert_eq!(scale.coarse(fine), if fine < 9 { fine } else { 9 }, "{fine} on {scale:?}");
        }
    }
}
