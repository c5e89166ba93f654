//! Integrals over a stretch of homogeneous fog: the light sent along the stretch, linear from its start to its end, as it arrives
//! at the start. All values are in units of the stretch's length.

use femc_math::elementary::double::{exp, exp_m1, ln_1p};

/// Optical depth below which a series is used, with an error below 1e-9. The functions cost five times as much, and for small
/// depths their differences have no digits.
const THIN_DEPTH: f64 = 0.5;

/// One over (n + 2)!.
const SERIES: [f64; 9] = [
    0.5,
    1.0 / 6.0,
    1.0 / 24.0,
    1.0 / 120.0,
    1.0 / 720.0,
    1.0 / 5040.0,
    1.0 / 40320.0,
    1.0 / 362_880.0,
    1.0 / 3_628_800.0,
];

/// Light sent by a stretch.
#[derive(Clone, Copy, Debug)]
pub(super) struct SourceTerm {
    /// At its start.
    pub start: f64,
    /// At its end.
    pub end: f64,
}

/// Returns the weights of the light sent at the start and at the end, and the transmittance of the stretch: the integrals over s in
/// [0, 1] of exp(-depth s) (1 - s) and of exp(-depth s) s, and exp(-depth).
/// - `depth`: optical depth of the stretch, >= 0.
#[inline]
pub(super) fn endpoint_weights(depth: f64) -> ([f64; 2], f64) {
    let x = depth;
    if x < THIN_DEPTH {
        // In pairs, which do not depend on each other.
        let s = &SERIES;
        let (x2, pair) = (x * x, |k: usize| s[k] - s[k + 1] * x);
        let x4 = x2 * x2;
        let first = (pair(0) + x2 * pair(2)) + x4 * (pair(4) + x2 * pair(6) + x4 * s[8]);
        let all = 1.0 - x * first;
        return ([first, all - first], 1.0 - x * all);
    }
    let through = exp(-x);
    let all = (1.0 - through) / x;
    let first = (1.0 - all) / x;
    ([first, all - first], through)
}

/// Returns the light that arrives from the first part of the stretch, as a share of its length.
/// - `end`: end of the part, in [0, 1].
pub(super) fn partial_integral(depth: f64, sent: SourceTerm, end: f64) -> f64 {
    let there = sent.start + (sent.end - sent.start) * end;
    let ([first, second], _) = endpoint_weights(depth * end);
    end * (sent.start * first + there * second)
}

/// Returns the light that arrives from a position, per share of the length.
#[inline]
pub(super) fn density(depth: f64, sent: SourceTerm, at: f64) -> f64 {
    exp(-depth * at) * (sent.start + (sent.end - sent.start) * at)
}

/// Maximum number of steps of [`invert_integral`]; bisection alone would need the same number.
const MAX_STEPS: u32 = 60;
/// Maximum last step, relative to the position.
const TOLERANCE: f64 = 1e-9;

/// Returns the position in [0, 1] up to which the channels' [`partial_integral`]s sum to `target`. It uses Newton's steps, and
/// bisection where these lead away.
/// - `whole`: the sum up to 1, > 0.
pub(super) fn invert_integral(channels: &[(f64, SourceTerm)], target: f64, whole: f64) -> f64 {
    let sum = |of: fn(f64, SourceTerm, f64) -> f64, at: f64| {
        channels.iter().map(|&(depth, sent)| of(depth, sent, at)).sum::<f64>()
    };
    let share = (target / whole).clamp(0.0, 1.0);
    let (mut low, mut high) = (0.0f64, 1.0f64);
    let mut at = first_guess(channels, share);
    for _ in 0..MAX_STEPS {
        let error = sum(partial_integral, at) - target;
        if error > 0.0 {
            high = at;
        } else {
            low = at;
        }
        let step = error / sum(density, at);
        let next = at - step;
        let next = if next > low && next < high { next } else { 0.5 * (low + high) };
        // The error after Newton's step is of the order of the squared step.
        if (next - at).abs() <= TOLERANCE.sqrt() * at && next == at - step || (next - at).abs() <= TOLERANCE * at {
            return next;
        }
        at = next;
    }
    at
}

/// Returns the solution for a transmittance of 1, or for a constant light along the stretch.
fn first_guess(channels: &[(f64, SourceTerm)], share: f64) -> f64 {
    let least = channels.iter().map(|(depth, _)| *depth).fold(f64::INFINITY, f64::min);
    if least > THIN_DEPTH {
        return (-ln_1p(share * exp_m1(-least)) / least).clamp(0.0, 1.0);
    }
    let (from, to) = channels.iter().fold((0.0, 0.0), |(from, to), (depth, sent)| {
        // As at the end of a line through the two values, attenuated by the stretch.
        (from + sent.start, to + sent.end * (1.0 - depth + 0.5 * depth * depth))
    });
    let root = (from * from + (to - from) * (to + from) * share).max(0.0).sqrt();
    let guess = (from + to) * share / (from + root);
    if guess.is_finite() { guess.clamp(0.0, 1.0) } else { share }
}
