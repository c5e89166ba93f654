//! HDR-FLIP: the difference that a viewer sees when two images alternate, over all relevant exposures.
//!
//! This is the published algorithm (\[andersson2020\], \[andersson2021\]) with its constants. Both images are shown at a range of
//! exposures through the ACES curve (\[narkowicz2016\]). At one end of the range, the reference's brightest pixel is nearly white;
//! at the other end, its median is. For each exposure LDR-FLIP is computed: contrast-sensitivity filtering in an opponent space,
//! the HyAB distance in Hunt-adjusted L*a*b*, and the difference of edges and points. A pixel's error is its largest over the
//! exposures. The viewer is at 67 pixels per degree: 0.7 m from a 0.7 m wide screen of 3840 pixels.

use super::plane::Plane;
use crate::Image;
use femc_math::elementary::{cbrt, double, pow};
use rayon::prelude::*;

/// Pixels per degree of visual angle: `0.7 * 3840 / 0.7 * pi / 180`.
const PIXELS_PER_DEGREE: f64 = 3840.0 * std::f64::consts::PI / 180.0;
/// White point of the conversion to and from XYZ (D65).
const WHITE: [f32; 3] = [0.950_428_545, 1.0, 1.088_900_371];
const RGB_TO_XYZ: [[f32; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];
const XYZ_TO_RGB: [[f32; 3]; 3] = [
    [3.241_003_275, -1.537_398_934, -0.498_615_861],
    [-0.969_224_334, 1.875_930_071, 0.041_554_224],
    [0.055_639_423, -0.204_011_202, 1.057_148_933],
];
/// ACES curve `(x (a x + b)) / (x (c x + d) + e)`, including its exposure of 0.6.
const ACES: [f32; 5] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];
/// Display value that the brightest and the median pixel reach at the ends of the range.
const NEAR_WHITE: f64 = 0.85;

/// Computes the mean HDR-FLIP of `image` against `reference`, of equal sizes and finite; negative components count as 0.
pub fn hdr_flip(image: &Image, reference: &Image) -> f64 {
    let Some((start, stop)) = exposures(reference) else {
        // A black reference has no exposure range, so a single exposure is used.
        return ldr_flip(&tone_map(image, 0.0), &tone_map(reference, 0.0)).mean();
    };
    let count = (stop - start).ceil().max(2.0);
    let mut worst: Option<Plane> = None;
    for i in 0..count as u32 {
        let exposure = start + f64::from(i) * (stop - start) / (count - 1.0);
        let error = ldr_flip(&tone_map(image, exposure as f32), &tone_map(reference, exposure as f32));
        worst = Some(match worst {
            Some(worst) => worst.zip(&error, f32::max),
            None => error,
        });
    }
    worst.map_or(0.0, |w| w.mean())
}

/// Returns the first and last exposure in stops. `None` for a black reference; a black median counts as a tiny value.
fn exposures(reference: &Image) -> Option<(f64, f64)> {
    const DARKEST: f64 = 1e-4;
    let weigh = |p: &[f32; 3]| 0.2126 * f64::from(p[0]) + 0.7152 * f64::from(p[1]) + 0.0722 * f64::from(p[2]);
    let mut luminances: Vec<f64> = reference.pixels.iter().map(weigh).collect();
    luminances.sort_unstable_by(f64::total_cmp);
    let brightest = *luminances.last().filter(|&&y| y > 0.0)?;
    let half = luminances.len() / 2;
    let median =
        if luminances.len() % 2 == 1 { luminances[half] } else { (luminances[half - 1] + luminances[half]) / 2.0 };
    // The curve's value is NEAR_WHITE at the positive root of a quadratic.
    let [a, b, c, d, e] = ACES.map(f64::from);
    let (p, q) = ((b - d * NEAR_WHITE) / (a - c * NEAR_WHITE), -e * NEAR_WHITE / (a - c * NEAR_WHITE));
    let x = -0.5 * p + (0.25 * p * p - q).sqrt();
    Some((double::log2(x / brightest), double::log2(x / median.max(DARKEST.min(brightest)))))
}

/// Linear display colors, 0..1.
struct DisplayImage {
    width: u32,
    pixels: Vec<[f32; 3]>,
}

/// Applies the tone curve to the image at an exposure in stops.
fn tone_map(image: &Image, exposure: f32) -> DisplayImage {
    let gain = pow(2.0, exposure);
    let [a, b, c, d, e] = ACES;
    let curve = |v: f32| {
        let x = (gain * v.max(0.0)).min(1e9);
        ((a * x * x + b * x) / (c * x * x + d * x + e)).clamp(0.0, 1.0)
    };
    DisplayImage { width: image.width, pixels: image.pixels.par_iter().map(|p| p.map(curve)).collect() }
}

/// Computes the error of each pixel, 0..1.
fn ldr_flip(image: &DisplayImage, reference: &DisplayImage) -> Plane {
    let opponent = [image, reference].map(opponent);
    let [color_a, color_b] = [0, 1].map(|i| filter_contrast(&opponent[i]));
    let [features_a, features_b] = [0, 1].map(|i| features(&opponent[i][0]));
    let width = opponent[0][0].width;
    let most = pow(distance(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])), COLOR_EXPONENT);
    let values = (0..color_a.len()).into_par_iter().map(|i| {
        let color = redistribute(pow(distance(color_a[i], color_b[i]), COLOR_EXPONENT), most);
        let off = |k: usize| (features_a[k].values[i] - features_b[k].values[i]).abs();
        let feature = (std::f32::consts::FRAC_1_SQRT_2 * off(0).max(off(1))).sqrt();
        pow(color, 1.0 - feature)
    });
    Plane { width, values: values.collect() }
}

/// Exponent of the color distance.
const COLOR_EXPONENT: f32 = 0.7;

/// Maps `error` in 0..`most` to 0..1 so that the lower 40 % take up 95 % of the range.
fn redistribute(error: f32, most: f32) -> f32 {
    const KNEE: f32 = 0.4;
    const AT_KNEE: f32 = 0.95;
    let knee = KNEE * most;
    if error < knee { AT_KNEE / knee * error } else { AT_KNEE + (error - knee) / (most - knee) * (1.0 - AT_KNEE) }
}

/// Computes the HyAB distance: city block in lightness, Euclidean in chroma.
fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let (da, db) = (a[1] - b[1], a[2] - b[2]);
    (a[0] - b[0]).abs() + (da * da + db * db).sqrt()
}

fn multiply(m: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Converts a linear color to X Y Z relative to the white point.
fn relative_xyz(rgb: [f32; 3]) -> [f32; 3] {
    let xyz = multiply(&RGB_TO_XYZ, rgb);
    [xyz[0] / WHITE[0], xyz[1] / WHITE[1], xyz[2] / WHITE[2]]
}

/// Converts to the linear opponent space Y Cx Cz.
fn opponent(image: &DisplayImage) -> [Plane; 3] {
    let axis = |f: fn([f32; 3]) -> f32| {
        Plane::from_values(image.width, image.pixels.par_iter().map(|&p| f(relative_xyz(p))).collect())
    };
    [axis(|v| 116.0 * v[1] - 16.0), axis(|v| 500.0 * (v[0] - v[1])), axis(|v| 200.0 * (v[1] - v[2]))]
}

/// Converts to L*a*b* with the Hunt effect: chroma grows with lightness.
fn hunt_lab(rgb: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| if t > DELTA * DELTA * DELTA { cbrt(t) } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let [x, y, z] = relative_xyz(rgb).map(f);
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

/// Filters the opponent planes for the viewing distance and returns them in Hunt-adjusted L*a*b*.
fn filter_contrast(planes: &[Plane; 3]) -> Vec<[f32; 3]> {
    /// Sums of Gaussians `a sqrt(pi / b) exp(-pi^2 x^2 / b)`, x in degrees: (a, b) for the three axes.
    const SENSITIVITY: [&[(f64, f64)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];
    let [y, cx, cz] = [0, 1, 2].map(|axis| filter_sum(&planes[axis], SENSITIVITY[axis]));
    (0..y.values.len())
        .into_par_iter()
        .map(|i| {
            let gray = (y.values[i] + 16.0) / 116.0;
            let (x, z) = (gray + cx.values[i] / 500.0, gray - cz.values[i] / 200.0);
            let rgb = multiply(&XYZ_TO_RGB, [x * WHITE[0], gray * WHITE[1], z * WHITE[2]]);
            hunt_lab(rgb.map(|c| c.clamp(0.0, 1.0)))
        })
        .collect()
}

/// Filters with a sum of Gaussians whose weights over the whole window sum to 1. Each Gaussian is separable.
fn filter_sum(plane: &Plane, gaussians: &[(f64, f64)]) -> Plane {
    use std::f64::consts::PI;
    /// Widest Gaussian of all axes; the window spans three of its standard deviations.
    const WIDEST: f64 = 0.04;
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as i32;
    let parts: Vec<(f64, Vec<f64>)> = gaussians
        .iter()
        .map(|&(a, b)| {
            let at = |i: i32| double::exp(-PI * PI * (f64::from(i) / PIXELS_PER_DEGREE).powi(2) / b);
            let kernel: Vec<f64> = (-radius..=radius).map(at).collect();
            let sum: f64 = kernel.iter().sum();
            (a * (PI / b).sqrt() * sum * sum, kernel.iter().map(|k| k / sum).collect())
        })
        .collect();
    let total: f64 = parts.iter().map(|(share, _)| share).sum();
    let filtered = parts.iter().map(|(share, kernel)| {
        let along_x: Vec<f32> = kernel.iter().map(|k| (k * share / total) as f32).collect();
        let along_y: Vec<f32> = kernel.iter().map(|&k| k as f32).collect();
        plane.filter(&along_x, &along_y)
    });
    filtered.reduce(|a, b| a.zip(&b, |x, y| x + y)).unwrap_or_else(|| plane.clone())
}

/// Computes the strength of edges and of points in the achromatic axis.
fn features(y: &Plane) -> [Plane; 2] {
    /// Distance from peak to trough of the eye's edge detector, degrees.
    const EDGE: f64 = 0.082;
    let deviation = 0.5 * EDGE * PIXELS_PER_DEGREE;
    let radius = (3.0 * deviation).ceil() as i32;
    let over = |f: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
        let gauss = |x: f64| double::exp(-x * x / (2.0 * deviation * deviation));
        (-radius..=radius).map(|i| f(f64::from(i), gauss(f64::from(i)))).collect()
    };
    let blur = normalize_kernel(&over(&|_, g| g));
    let derivatives = [over(&|x, g| -x * g), over(&|x, g| (x * x / (deviation * deviation) - 1.0) * g)];
    let normalized = y.zip(y, |v, _| (v + 16.0) / 116.0);
    derivatives.map(|derivative| {
        let derivative = normalize_kernel(&derivative);
        let along_x = normalized.filter(&derivative, &blur);
        let along_y = normalized.filter(&blur, &derivative);
        along_x.zip(&along_y, |a, b| (a * a + b * b).sqrt())
    })
}

/// Scales the positive weights of the kernel to the sum 1 and its negative ones to -1.
fn normalize_kernel(kernel: &[f64]) -> Vec<f32> {
    let positive: f64 = kernel.iter().filter(|k| **k > 0.0).sum();
    let negative: f64 = -kernel.iter().filter(|k| **k < 0.0).sum::<f64>();
    kernel
        .iter()
        .map(|&k| {
            (if k > 0.0 {
                k / positive
            } else if k < 0.0 {
                k / negative
            } else {
                0.0
            }) as f32
        })
        .collect()
}
