//! Real roots of polynomials by recursion on the derivative. Between neighboring critical points a polynomial is monotone, so a
//! sign change there brackets exactly one root. This is slower than closed forms, but has no cancellation.

/// At most three ascending numbers.
#[derive(Clone, Copy, Default)]
pub(super) struct CubicRoots {
    values: [f64; 3],
    count: usize,
}

impl CubicRoots {
    fn push(&mut self, x: f64) {
        self.values[self.count] = x;
        self.count += 1;
    }

    pub fn iter(&self) -> std::slice::Iter<'_, f64> {
        self.values[..self.count].iter()
    }
}

/// Returns the roots with a change of sign of c0 + c1 x + c2 x^2 + c3 x^3 in (`lo`, `hi`), ascending.
pub(super) fn cubic_roots_between(c: &[f64; 4], lo: f64, hi: f64) -> CubicRoots {
    let f = |x: f64| ((c[3] * x + c[2]) * x + c[1]) * x + c[0];
    let mut roots = CubicRoots::default();
    let mut from = lo;
    for to in quadratic_roots(c[1], c[2], 3.0 * c[3]).into_iter().chain([hi]) {
        let to = to.clamp(lo, hi);
        if to > from {
            if (f(from) < 0.0) != (f(to) < 0.0) {
                roots.push(bracketed_root(&f, from, to));
            }
            from = to;
        }
    }
    roots
}

/// Returns the roots of c0 + 2 c1 x + c2 x^2, ascending; none if they are not real.
fn quadratic_roots(c0: f64, c1: f64, c2: f64) -> impl IntoIterator<Item = f64> {
    let discriminant = c1 * c1 - c0 * c2;
    let q = -(c1 + discriminant.sqrt().copysign(c1));
    let (a, b) = (q / c2, c0 / q);
    let pair = if a <= b { [a, b] } else { [b, a] };
    pair.into_iter().filter(move |x| discriminant > 0.0 && x.is_finite())
}

/// Returns the root of `f` between `lo` and `hi`, where `f` has opposite signs. Uses false position (Illinois) safeguarded by
/// bisection, to the last bits.
pub(super) fn bracketed_root(f: &impl Fn(f64) -> f64, mut lo: f64, mut hi: f64) -> f64 {
    let (mut f_lo, mut f_hi) = (f(lo), f(hi));
    let negative_low = f_lo < 0.0;
    for step in 0..120 {
        let middle = 0.5 * (lo + hi);
        if hi - lo <= 4.0 * f64::EPSILON * lo.abs().max(hi.abs()) {
            break;
        }
        let secant = (lo * f_hi - hi * f_lo) / (f_hi - f_lo);
        let x = if step % 3 == 2 || !(secant > lo && secant < hi) { middle } else { secant };
        let f_x = f(x);
        if f_x == 0.0 {
            return x;
        }
        if (f_x < 0.0) == negative_low {
            (lo, f_lo) = (x, f_x);
            f_hi *= 0.5;
        } else {
            (hi, f_hi) = (x, f_x);
            f_lo *= 0.5;
        }
    }
    0.5 * (lo + hi)
}
