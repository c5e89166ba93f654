//! Anderson acceleration of a fixed-point iteration (\[walker2011\]).
//!
//! The plain iteration loses as much of its error per step as the surfaces absorb: a room that reflects 99.9 % of the light needs
//! thousands. The next light is a combination of the latest results instead, which makes the sum of their changes small. A linear
//! iteration takes about as many steps as GMRES.

use crate::tuning::ACCELERATION_DEPTH;

/// Latest iterations of a sequence.
pub struct Acceleration {
    /// Weights of the numbers in a sum of squares.
    weights: Vec<f32>,
    /// Results of the latest iterations, and their changes.
    history: Vec<(Vec<f32>, Vec<f32>)>,
}

impl Acceleration {
    /// Creates an acceleration without history.
    /// - `weights`: weights of the numbers in a sum of squares; not negative.
    pub fn new(weights: Vec<f32>) -> Self {
        Self { weights, history: Vec::new() }
    }

    /// Returns the input of the next iteration.
    /// - `input`, `output`: numbers before and after the latest iteration.
    pub fn next_input(&mut self, input: &[f32], output: Vec<f32>) -> Vec<f32> {
        let change: Vec<f32> = output.iter().zip(input).map(|(output, input)| output - input).collect();
        if self.history.len() == ACCELERATION_DEPTH {
            self.history.remove(0);
        }
        let mut next = output.clone();
        let differences: Vec<Vec<f32>> = self
            .history
            .iter()
            .map(|(_, earlier)| change.iter().zip(earlier).map(|(now, earlier)| now - earlier).collect())
            .collect();
        let shares = self.fit(&differences, &change);
        for ((earlier, _), share) in self.history.iter().zip(shares) {
            for ((next, output), earlier) in next.iter_mut().zip(&output).zip(earlier) {
                *next -= share * (output - earlier);
            }
        }
        self.history.push((output, change));
        next
    }

    /// Returns the shares with which the differences sum to the change, by least squares.
    fn fit(&self, differences: &[Vec<f32>], change: &[f32]) -> Vec<f32> {
        let n = differences.len();
        let product = |a: &[f32], b: &[f32]| -> f64 {
            self.weights
                .iter()
                .zip(a.iter().zip(b))
                .map(|(w, (a, b))| f64::from(*w) * f64::from(*a) * f64::from(*b))
                .sum()
        };
        // Normal equations, scaled to a unit diagonal.
        let norms: Vec<f64> = differences.iter().map(|it| product(it, it).sqrt()).collect();
        if norms.iter().any(|norm| !norm.is_normal()) {
            return vec![0.0; n];
        }
        let mut rows: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                let row = (0..n).map(|j| {
                    let cosine = product(&differences[i], &differences[j]) / (norms[i] * norms[j]);
                    if i == j { 1.0 + RIDGE } else { cosine }
                });
                row.chain([product(&differences[i], change) / norms[i]]).collect()
            })
            .collect();
        // Elimination; the matrix is positive definite.
        for column in 0..n {
            let (above, below) = rows.split_at_mut(column + 1);
            let pivot = &above[column];
            for row in below {
                let factor = row[column] / pivot[column];
                row.iter_mut().zip(pivot).skip(column).for_each(|(value, pivot)| *value -= factor * pivot);
            }
        }
        let mut shares = vec![0.0; n];
        for row in (0..n).rev() {
            let known: f64 = (row + 1..n).map(|k| rows[row][k] * shares[k]).sum();
            shares[row] = (rows[row][n] - known) / rows[row][row];
        }
        let scaled: Vec<f32> = shares.iter().zip(&norms).map(|(share, norm)| (share / norm) as f32).collect();
        if scaled.iter().all(|share| share.is_finite()) { scaled } else { vec![0.0; n] }
    }
}

/// Relative increase of the diagonal of the normal equations, which keeps nearly dependent differences from canceling each other.
const RIDGE: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;

    /// Light that flows back and forth among eight places that absorb 0.1 % of it, and two that absorb half.
    #[test]
    fn slow_iteration_takes_few_steps() {
        let albedo = [0.999, 0.999, 0.999, 0.999, 0.999, 0.999, 0.999, 0.999, 0.5, 0.5f32];
        let share =
            |i: usize, j: usize| (1.0 + ((3 * i + 5 * j) % 7) as f32) * if (i < 8) == (j < 8) { 1.0 } else { 1e-3 };
        let iterate = |x: &[f32]| -> Vec<f32> {
            (0..10)
                .map(|i| {
                    let whole: f32 = (0..10).map(|j| share(i, j)).sum();
                    let arriving: f32 = (0..10).map(|j| share(i, j) / whole * x[j]).sum();
                    albedo[i] * arriving + if i == 0 { 1.0 } else { 0.0 }
                })
                .collect()
        };
        let change = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| (x - y).abs()).sum::<f32>();
        let mut acceleration = Acceleration::new(vec![1.0; 10]);
        let (mut x, mut steps) = (vec![0.0f32; 10], 0);
        loop {
            let y = iterate(&x);
            steps += 1;
            if change(&x, &y) < 1e-4 {
                break;
            }
            assert!(steps < 40, "{}", change(&x, &y));
            x = acceleration.next_input(&x, y);
        }
        let mut plain = vec![0.0f32; 10];
        (0..40_000).for_each(|_| plain = iterate(&plain));
        let error = change(&x, &plain) / plain.iter().sum::<f32>();
        assert!(error < 1e-3, "{steps} steps, error {error}");
    }

    #[test]
    fn sequence_without_change_stays() {
        let mut acceleration = Acceleration::new(vec![1.0; 2]);
        for _ in 0..10 {
            assert_eq!(acceleration.next_input(&[2.0, 3.0], vec![2.0, 3.0]), [2.0, 3.0]);
        }
    }
}
