//! Structural similarity (\[wang2004\]).

use super::plane::Plane;
use femc_math::elementary::double;

const RADIUS: i32 = 5;
const DEVIATION: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Computes the mean structural similarity of two planes of range 1; windows are cut and renormalized at the border.
pub(super) fn ssim(a: &Plane, b: &Plane) -> f64 {
    let kernel = kernel();
    // The planes are extended by zeros and divided by the weight inside, which is a plane of ones filtered in the same way. Padding
    // with the nearest pixel would count border pixels several times.
    let blur = |p: &Plane| pad_with_zeros(p).filter(&kernel, &kernel);
    let ones = Plane { width: a.width, values: vec![1.0; a.values.len()] };
    let weight = blur(&ones);
    let means = [blur(a), blur(b)];
    let products = [blur(&a.zip(a, |x, y| x * y)), blur(&b.zip(b, |x, y| x * y)), blur(&a.zip(b, |x, y| x * y))];
    let (wide, radius) = (weight.width, RADIUS as usize);
    let mut sum = 0.0;
    for y in 0..a.height() {
        for x in 0..a.width {
            let at = (y + radius) * wide + x + radius;
            let value = |p: &Plane| f64::from(p.values[at]) / f64::from(weight.values[at]);
            let (ma, mb) = (value(&means[0]), value(&means[1]));
            // Rounding may make a variance slightly negative, far less than C2. Without clipping, equal planes give exactly 1.
            let (va, vb) = (value(&products[0]) - ma * ma, value(&products[1]) - mb * mb);
            let covariance = value(&products[2]) - ma * mb;
            sum += (2.0 * ma * mb + C1) * (2.0 * covariance + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2));
        }
    }
    sum / a.values.len() as f64
}

/// Surrounds the plane with a frame of zeros as wide as the window's radius.
fn pad_with_zeros(plane: &Plane) -> Plane {
    let radius = RADIUS as usize;
    let width = plane.width + 2 * radius;
    let mut values = vec![0.0; width * (plane.height() + 2 * radius)];
    for (y, row) in plane.values.chunks(plane.width).enumerate() {
        let start = (y + radius) * width + radius;
        values[start..start + row.len()].copy_from_slice(row);
    }
    Plane { width, values }
}

fn kernel() -> Vec<f32> {
    let weights: Vec<f64> =
        (-RADIUS..=RADIUS).map(|i| double::exp(-f64::from(i * i) / (2.0 * DEVIATION * DEVIATION))).collect();
    let total: f64 = weights.iter().sum();
    weights.iter().map(|w| (w / total) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_planes_give_the_luminance_term_alone() {
        // (2 a b + C1) / (a^2 + b^2 + C1) with a = 0.5, b = 0.25: 0.2501 / 0.3126.
        let plane = |v: f32| Plane { width: 20, values: vec![v; 20 * 17] };
        assert!((ssim(&plane(0.5), &plane(0.25)) - 0.2501 / 0.3126).abs() < 1e-4);
        assert!((ssim(&plane(0.5), &plane(0.5)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn inverted_structure_is_negative_and_tiny_planes_work() {
        let wave = |sign: f32| Plane {
            width: 32,
            values: (0..1024).map(|i| 0.5 + sign * 0.4 * ((i % 2) as f32 - 0.5)).collect(),
        };
        assert!(ssim(&wave(1.0), &wave(-1.0)) < -0.9);
        assert!((ssim(&wave(1.0), &wave(1.0)) - 1.0).abs() < 1e-6);
        let dot = Plane { width: 1, values: vec![0.3] };
        assert!((ssim(&dot, &dot) - 1.0).abs() < 1e-12);
    }
}
