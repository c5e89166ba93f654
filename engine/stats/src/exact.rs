//! Exact sums of non-negative numbers: fixed point in 128 bits, so that addition is integer addition.
//!
//! A floating-point sum depends on the order of its terms; an integer sum does not. Each term is rounded once, to the nearest
//! multiple of `2^-FRACTION` (a function of the term alone), and everything after that is exact: associative, commutative, the same
//! for any number of workers, tiles and restarts.
//!
//! The price is a bounded range, `2^(128 - FRACTION)`. Terms are non-negative, so a saturated sum stays saturated whatever is added
//! before or after. Saturation therefore does not depend on the order either, and needs no counter beside the sum. An addition
//! costs a few integer instructions.

use serde::{Deserialize, Serialize};

/// Sum of radiances (cd/m2): quantum 2^-60 (8.7e-19), range 2^68 (3e20: 2^32 samples of 6.8e10 cd/m2).
pub type RadianceSum = ExactSum<60>;

/// Sum of squared radiances: quantum 2^-40 (9.1e-13), range 2^88 (3e26: 3e6 samples of 1e10 cd/m2).
pub type SquareSum = ExactSum<40>;

/// Reason for refusing a term.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, thiserror::Error)]
pub enum TermError {
    /// The term is not a number.
    #[error("not a number")]
    NotANumber,
    /// The term is infinite.
    #[error("infinite")]
    Infinite,
    /// The term is below zero.
    #[error("negative")]
    Negative,
}

/// Order-free sum of non-negative terms in units of `2^-FRACTION`; `FRACTION` is at most 127.
///
/// Laws (tests `any_order_and_grouping_gives_the_same_bits`, `a_saturated_sum_stays_so_in_any_order`): `merge` is
/// associative and commutative with `default()` as its neutral element, and adding terms one by one equals merging sums of
/// any partition of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ExactSum<const FRACTION: u32>(u128);

impl<const FRACTION: u32> ExactSum<FRACTION> {
    /// Creates the sum from its units of `2^-FRACTION`, as [`units`](Self::units) returned them.
    #[inline]
    pub const fn from_units(units: u128) -> Self {
        Self(units)
    }

    /// Returns the sum in units of `2^-FRACTION`. Returns the sum in units of `2^-FRACTION`.
    #[inline]
    pub const fn units(self) -> u128 {
        self.0
    }

    /// Converts `term` to units of `2^-FRACTION`, halves rounded up; saturates.
    /// - errors: the term is NaN, infinite or negative (negative zero counts as zero).
    #[inline]
    pub fn quantize(term: f64) -> Result<u128, TermError> {
        const MANTISSA: u32 = 52;
        const BIAS: i32 = 1023;
        let bits = term.to_bits();
        let exponent = (bits >> MANTISSA) as i32;
        if !(0..2047).contains(&exponent) {
            // The sign is bit 11 of the shifted value, so negative numbers land here too.
            return match term {
                t if t.is_nan() => Err(TermError::NotANumber),
                t if t.is_infinite() => Err(TermError::Infinite),
                0.0 => Ok(0),
                _ => Err(TermError::Negative),
            };
        }
        if exponent == 0 {
            return Ok(0); // Zero and subnormals lie far below half of any quantum.
        }
        let mantissa = u128::from((bits & ((1 << MANTISSA) - 1)) | (1 << MANTISSA));
        let shift = exponent - BIAS - MANTISSA as i32 + FRACTION as i32;
        Ok(match shift {
            76.. => u128::MAX,
            0..=75 => mantissa << shift,
            -53..=-1 => (mantissa + (1 << (-shift - 1))) >> -shift,
            _ => 0,
        })
    }

    /// Adds `mantissa * 2^exponent`, rounded once, halves up. The hot loop calls this instead of [`quantize`](Self::quantize), with
    /// the same result (test `parts_and_doubles_are_added_alike`).
    #[inline]
    pub fn add_parts(&mut self, mantissa: u64, exponent: i32) {
        let shift = exponent + FRACTION as i32;
        let units = if (0..=64).contains(&shift) {
            u128::from(mantissa) << shift
        } else if shift > 64 {
            let wide = u128::from(mantissa);
            if shift as u32 > wide.leading_zeros() { if mantissa == 0 { 0 } else { u128::MAX } } else { wide << shift }
        } else if shift > -64 {
            u128::from((mantissa + (1 << (-shift - 1))) >> -shift)
        } else {
            0
        };
        self.0 = self.0.saturating_add(units);
    }

    /// Adds `term`, rounded once. An error leaves the sum unchanged; the caller counts it.
    #[inline]
    pub fn add(&mut self, term: f64) -> Result<(), TermError> {
        self.0 = self.0.saturating_add(Self::quantize(term)?);
        Ok(())
    }

    /// Adds all terms of `other`.
    #[inline]
    pub fn merge(&mut self, other: Self) {
        self.0 = self.0.saturating_add(other.0);
    }

    /// Returns the sum as the nearest double, in the unit of the terms.
    #[inline]
    pub fn value(self) -> f64 {
        const { assert!(FRACTION < 128) };
        self.0 as f64 / (1u128 << FRACTION) as f64
    }

    /// Returns whether the sum has left its range and is now only a lower bound.
    #[inline]
    pub const fn is_saturated(self) -> bool {
        self.0 == u128::MAX
    }
}

/// Exact sums of `N` numbers that arrive together, such as the channels of a color, for hot loops. Terms are summed in doubles
/// while no bit is lost; the doubles are added to the fixed-point sums at the end. The sums equal those of [`ExactSum`] to the bit
/// (test `buffered_sums_are_the_exact_ones`) and take half of the instructions.
#[derive(Clone, Copy, Debug)]
pub struct BufferedSums<const FRACTION: u32, const N: usize> {
    /// Sums of terms that are multiples of the quantum.
    buffer: [f64; N],
    sums: [ExactSum<FRACTION>; N],
}

impl<const FRACTION: u32, const N: usize> Default for BufferedSums<FRACTION, N> {
    fn default() -> Self {
        Self { buffer: [0.0; N], sums: [ExactSum::default(); N] }
    }
}

impl<const FRACTION: u32, const N: usize> BufferedSums<FRACTION, N> {
    /// Smallest float from which all floats are multiples of the quantum: `2^(23 - FRACTION)`.
    const MIN_EXACT: f32 = f32::from_bits((127 + 23 - FRACTION) << 23);

    /// Adds terms that are finite and not negative; ignores other terms.
    #[inline]
    pub fn add(&mut self, terms: [f32; N]) {
        let (mut sums, mut is_exact) = ([0.0; N], true);
        for (at, term) in terms.into_iter().enumerate() {
            let (wide, had) = (f64::from(term), self.buffer[at]);
            let sum = had + wide;
            // No bit is lost if subtracting either operand gives back the other.
            is_exact &= (sum - had == wide) & (sum - wide == had) & ((term >= Self::MIN_EXACT) | (term == 0.0));
            sums[at] = sum;
        }
        if is_exact {
            self.buffer = sums;
        } else {
            self.add_unbuffered(terms);
        }
    }

    /// Adds terms of which some do not fit the buffer. The buffer keeps the larger of the term and its own value.
    #[cold]
    fn add_unbuffered(&mut self, terms: [f32; N]) {
        for ((term, buffer), sum) in terms.into_iter().zip(&mut self.buffer).zip(&mut self.sums) {
            let mut apart = f64::from(term);
            if term >= Self::MIN_EXACT && term.is_finite() && apart > *buffer {
                std::mem::swap(&mut apart, buffer);
            }
            // Refused terms are those that must be ignored.
            let _ = sum.add(apart);
        }
    }

    /// Returns the sums of all terms.
    pub fn finish(self) -> [ExactSum<FRACTION>; N] {
        let mut sums = self.sums;
        sums.iter_mut()
            .zip(self.buffer)
            .for_each(|(sum, rest)| sum.merge(ExactSum(ExactSum::<FRACTION>::quantize(rest).unwrap_or_default())));
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Sum = ExactSum<60>;

    fn sum(terms: &[f64]) -> Sum {
        let mut s = Sum::default();
        for &t in terms {
            s.add(t).unwrap();
        }
        s
    }

    #[test]
    fn float_terms_below_2_to_the_15_are_added_exactly() {
        let x = f64::from(0.1f32);
        assert_eq!(sum(&[x; 8]).value(), 8.0 * x);
        assert_eq!(sum(&[1e10, 1e-10, 1e10]).value(), 2e10 + 1e-10);
        assert_eq!(ExactSum::<0>::quantize(7.0), Ok(7));
    }

    #[test]
    fn a_small_term_is_not_lost_beside_a_large_one() {
        let mut s = sum(&[1e10]);
        for _ in 0..1_000_000 {
            s.add(1e-9).unwrap();
        }
        assert!((s.value() - (1e10 + 1e-3)).abs() < 1e-6);
    }

    #[test]
    fn halves_of_the_quantum_round_up_and_less_rounds_down() {
        type Whole = ExactSum<0>;
        for (x, units) in
            [(0.5, 1), (0.49999, 0), (1.5, 2), (2.5, 3), (2.4999, 2), (0.25, 0), (4503599627370497.5, 4503599627370498)]
        {
            assert_eq!(Whole::quantize(x), Ok(units), "{x}");
        }
        assert_eq!(Whole::quantize(f64::MIN_POSITIVE), Ok(0));
        assert_eq!(Whole::quantize(f64::from_bits(1)), Ok(0));
    }

    #[test]
    fn bad_terms_are_refused_by_kind_and_change_nothing() {
        let mut s = sum(&[1.25]);
        let before = s;
        assert_eq!(s.add(f64::NAN), Err(TermError::NotANumber));
        assert_eq!(s.add(-f64::NAN), Err(TermError::NotANumber));
        assert_eq!(s.add(f64::INFINITY), Err(TermError::Infinite));
        assert_eq!(s.add(f64::NEG_INFINITY), Err(TermError::Infinite));
        assert_eq!(s.add(-1e-30), Err(TermError::Negative));
        assert_eq!(s.add(-0.0), Ok(()));
        assert_eq!(s, before);
    }

    #[test]
    fn a_saturated_sum_stays_so_in_any_order() {
        let big = 2f64.powi(67);
        for order in [[big, big, 1.0], [1.0, big, big], [big, 1.0, big]] {
            assert!(sum(&order).is_saturated());
        }
        assert!(sum(&[f64::MAX]).is_saturated());
        assert!(!sum(&[big, 1e20]).is_saturated());
        let mut merged = sum(&[big]);
        merged.merge(sum(&[big, 3.0]));
        assert_eq!(merged, sum(&[3.0, big, big]));
    }

    #[test]
    fn terms_out_of_the_domain_are_in_no_buffered_sum() {
        let mut sums = BufferedSums::<60, 1>::default();
        for term in [1.5, f32::NAN, -1.0, f32::INFINITY, f32::NEG_INFINITY, -0.0, 0.25, f32::from_bits(1)] {
            sums.add([term]);
        }
        assert_eq!(sums.finish(), [sum(&[1.75])]);
    }

    proptest! {
        #[test]
        fn quantizing_agrees_with_scaling_and_rounding(x in 0.0f64..1e9, e in -60i32..20) {
            let x = x * 2f64.powi(e);
            let scaled = x * 2f64.powi(40);
            let expected = if scaled < 2f64.powi(52) { (scaled + 0.5).floor() as u128 } else { scaled as u128 };
            // (scaled + 0.5) is exact below 2^52, except for terms within 2^-53 of a half: allow the one unit there.
            prop_assert!(ExactSum::<40>::quantize(x).unwrap().abs_diff(expected) <= u128::from(scaled < 0.5));
        }

        #[test]
        fn parts_and_doubles_are_added_alike(mantissa in 0u64..1 << 53, exponent in -150i32..90) {
            let (mut parts, mut double) = (ExactSum::<40>::default(), ExactSum::<40>::default());
            parts.add_parts(mantissa, exponent);
            double.add(mantissa as f64 * 2f64.powi(exponent)).unwrap();
            prop_assert_eq!(parts, double);
        }

        #[test]
        fn buffered_sums_are_the_exact_ones(
            terms in prop::collection::vec([(0u32..1 << 24, -90i32..60), (0u32..1 << 24, -40i32..0), (0u32..2, -60i32..-50)], 0..60),
        ) {
            let (mut buffered, mut exact) = (BufferedSums::<60, 3>::default(), [Sum::default(); 3]);
            for term in terms {
                let term = term.map(|(mantissa, exponent)| (f64::from(mantissa) * 2f64.powi(exponent)) as f32);
                buffered.add(term);
                exact.iter_mut().zip(term).for_each(|(sum, term)| sum.add(f64::from(term)).unwrap());
            }
            prop_assert_eq!(buffered.finish(), exact);
        }

        #[test]
        fn any_order_and_grouping_gives_the_same_bits(
            terms in prop::collection::vec((0.0f64..1.0, -80i32..60).prop_map(|(m, e)| m * 2f64.powi(e)), 1..60),
            cut in 0usize..60,
            turn in 0usize..60,
        ) {
            let whole = sum(&terms);
            let mut turned = terms.clone();
            turned.rotate_left(turn % terms.len());
            turned.reverse();
            let cut = cut.min(terms.len());
            let mut grouped = sum(&turned[cut..]);
            grouped.merge(sum(&turned[..cut]));
            prop_assert_eq!(whole, grouped);
        }
    }
}
