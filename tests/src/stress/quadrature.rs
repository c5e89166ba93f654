//! Numbers for comparison with cases, from quadrature in f64.

/// Returns nodes and weights of Gauss-Legendre quadrature on [`low`, `high`], from Newton's method on the Legendre polynomial
/// (\[press2007\]).
pub fn gauss(n: usize, low: f64, high: f64) -> Vec<(f64, f64)> {
    let (middle, half) = (0.5 * (high + low), 0.5 * (high - low));
    let node = |k: usize| {
        let mut x = (std::f64::consts::PI * (k as f64 + 0.75) / (n as f64 + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..100 {
            let (mut p, mut before) = (1.0, 0.0);
            for j in 0..n {
                let j = j as f64;
                (p, before) = (((2.0 * j + 1.0) * x * p - j * before) / (j + 1.0), p);
            }
            slope = n as f64 * (x * p - before) / (x * x - 1.0);
            let step = p / slope;
            x -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        (middle - half * x, 2.0 * half / ((1.0 - x * x) * slope * slope))
    };
    (0..n).map(node).collect()
}

/// Integrates `f` on [`low`, `high`] with `pieces` equal pieces of 16 nodes.
pub fn integral(low: f64, high: f64, pieces: usize, f: impl Fn(f64) -> f64) -> f64 {
    let rule = gauss(16, 0.0, 1.0);
    let step = (high - low) / pieces as f64;
    let piece = |k: usize| -> f64 { rule.iter().map(|&(x, w)| w * f(low + step * (k as f64 + x))).sum() };
    step * (0..pieces).map(piece).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::integral;

    #[test]
    fn quadrature_is_exact_for_polynomials_and_good_for_waves() {
        assert!((integral(-1.0, 2.0, 1, |x| x.powi(7)) - 255.0 / 8.0).abs() < 1e-12);
        assert!((integral(0.0, 10.0, 20, f64::sin) - (1.0 - 10f64.cos())).abs() < 1e-13);
    }
}
