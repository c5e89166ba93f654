//! Conversion of spectra, black bodies and chromaticities to linear Rec.709.
//!
//! MGF's neutral color is equal-energy light: `rd .4` with the default color reflects 40 % in every channel. The white point E is
//! therefore adapted to Rec.709's white with the Bradford transform (\[lam1985\]) before the primaries are applied, and E becomes
//! exactly (1, 1, 1). The price is that a D65 source appears slightly blue, because colors are relative to equal energy.

use femc_math::{color::LUMINANCE_WEIGHTS, elementary::double as elementary};

/// Matrix from XYZ relative to white E to linear Rec.709: Bradford adaptation from E to D65 (0.3127, 0.3290), then the inverse of
/// the primaries' matrix (\[bt709\]). It was computed in exact rationals; rows sum to 1.
const XYZ_TO_RGB: [[f64; 3]; 3] = [
    [3.1466576541357187, -1.6664637545108374, -0.4801938996248811],
    [-0.9955216057807181, 1.955756733809069, 0.03976487197164932],
    [0.06359480293878869, -0.21456322222468066, 1.150968419285892],
];

/// The CIE 1931 2-degree observer (\[cie2018\]), 380 nm to 780 nm every 10 nm.
const OBSERVER: [[f64; 3]; 41] = [
    [0.001368, 0.000039, 0.006450],
    [0.004243, 0.000120, 0.020050],
    [0.014310, 0.000396, 0.067850],
    [0.043510, 0.001210, 0.207400],
    [0.134380, 0.004000, 0.645600],
    [0.283900, 0.011600, 1.385600],
    [0.348280, 0.023000, 1.747060],
    [0.336200, 0.038000, 1.772110],
    [0.290800, 0.060000, 1.669200],
    [0.195360, 0.090980, 1.287640],
    [0.095640, 0.139020, 0.812950],
    [0.032010, 0.208020, 0.465180],
    [0.004900, 0.323000, 0.272000],
    [0.009300, 0.503000, 0.158200],
    [0.063270, 0.710000, 0.078250],
    [0.165500, 0.862000, 0.042160],
    [0.290400, 0.954000, 0.020300],
    [0.433450, 0.994950, 0.008750],
    [0.594500, 0.995000, 0.003900],
    [0.762100, 0.952000, 0.002100],
    [0.916300, 0.870000, 0.001650],
    [1.026300, 0.757000, 0.001100],
    [1.062200, 0.631000, 0.000800],
    [1.002600, 0.503000, 0.000340],
    [0.854450, 0.381000, 0.000190],
    [0.642400, 0.265000, 0.000050],
    [0.447900, 0.175000, 0.000020],
    [0.283500, 0.107000, 0.0],
    [0.164900, 0.061000, 0.0],
    [0.087400, 0.032000, 0.0],
    [0.046770, 0.017000, 0.0],
    [0.022700, 0.008210, 0.0],
    [0.011359, 0.004102, 0.0],
    [0.005790, 0.002091, 0.0],
    [0.002899, 0.001047, 0.0],
    [0.001440, 0.000520, 0.0],
    [0.000690, 0.000249, 0.0],
    [0.000332, 0.000120, 0.0],
    [0.000166, 0.000060, 0.0],
    [0.000083, 0.000030, 0.0],
    [0.000042, 0.000015, 0.0],
];

const FIRST: f64 = 380.0;
const LAST: f64 = 780.0;
const STEP: f64 = 10.0;

/// A color of luminance 1, and whether it had to be clipped into Rec.709.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ClippedColor {
    /// Color without negative components.
    pub rgb: [f64; 3],
    /// Color before clipping. Equal to `rgb` if it was not clipped, or if it has no positive luminance.
    pub unclipped: [f64; 3],
    pub clipped: bool,
}

impl ClippedColor {
    /// Scales the linear Rec.709 color `raw` to luminance 1 and clips negative components to 0. Returns `None` for black.
    pub fn new(raw: [f64; 3]) -> Option<Self> {
        // Rounding leaves the other components of a primary slightly below 0. That does not count as clipping.
        let clipped = raw.iter().any(|&x| x < -1e-6 * luminance(raw).max(0.0));
        let rgb = with_unit_luminance(raw.map(|x| x.max(0.0)))?;
        // Chromaticities far below the line of purples have no positive luminance after the adaptation to the white point.
        let unclipped = if clipped { with_unit_luminance(raw).unwrap_or(rgb) } else { rgb };
        Some(Self { rgb, unclipped, clipped })
    }
}

/// Returns the Rec.709 luminance.
pub(super) fn luminance(rgb: [f64; 3]) -> f64 {
    let weights = LUMINANCE_WEIGHTS.to_array().map(f64::from);
    (rgb[0] * weights[0] + rgb[1] * weights[1] + rgb[2] * weights[2]) / (weights[0] + weights[1] + weights[2])
}

/// Returns `rgb` scaled to luminance 1; `None` for black.
pub(super) fn with_unit_luminance(rgb: [f64; 3]) -> Option<[f64; 3]> {
    let y = luminance(rgb);
    let scaled = rgb.map(|x| x / y);
    (y > 0.0 && scaled.iter().all(|x| x.is_finite())).then_some(scaled)
}

/// Returns the Rec.709 color of a chromaticity, with luminance 1 and negative components clipped to 0. Returns `None` if the
/// chromaticity has no finite color.
pub(super) fn from_xy(x: f64, y: f64) -> Option<ClippedColor> {
    from_xyz([x / y, 1.0, (1.0 - x - y) / y])
}

fn from_xyz(xyz: [f64; 3]) -> Option<ClippedColor> {
    ClippedColor::new(XYZ_TO_RGB.map(|row| row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2]))
}

/// Returns the physically possible chromaticity nearest to `[x, y]`: inside the spectral locus and the line of purples, or on them.
pub(super) fn nearest_visible([x, y]: [f64; 2]) -> [f64; 2] {
    let locus = OBSERVER.map(|[a, b, c]| [a / (a + b + c), b / (a + b + c)]);
    let edges = || (0..locus.len()).map(|i| (locus[i], locus[(i + 1) % locus.len()]));
    let is_above = |p: [f64; 2]| p[1] > y;
    let crossed = |(a, b): &([f64; 2], [f64; 2])| {
        is_above(*a) != is_above(*b) && x < a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1])
    };
    if edges().filter(crossed).count() % 2 == 1 {
        return [x, y];
    }
    let on_edge = |([ax, ay], [bx, by]): ([f64; 2], [f64; 2])| {
        let (dx, dy) = (bx - ax, by - ay);
        let along = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy).max(f64::MIN_POSITIVE);
        let along = along.clamp(0.0, 1.0);
        [ax + along * dx, ay + along * dy]
    };
    let distance = |p: &[f64; 2]| (p[0] - x) * (p[0] - x) + (p[1] - y) * (p[1] - y);
    edges().map(on_edge).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or([x, y])
}

/// Returns the CIE chromaticity of the spectral density `power` (any unit, per nm), integrated every nm. A flat spectrum gives
/// exactly (1/3, 1/3). Returns `None` for a spectrum without visible power.
fn chromaticity(power: impl Fn(f64) -> f64) -> Option<[f64; 2]> {
    let mut xyz = [0.0; 3];
    let mut equal_energy = [0.0; 3];
    for nm in 380..=780 {
        let nm = f64::from(nm);
        let observer = observer(nm);
        let p = power(nm);
        for k in 0..3 {
            xyz[k] += p * observer[k];
            equal_energy[k] += observer[k];
        }
    }
    let [x, y, z] = [xyz[0] / equal_energy[0], xyz[1] / equal_energy[1], xyz[2] / equal_energy[2]];
    let sum = x + y + z;
    let chromaticity = [x / sum, y / sum];
    (y > 0.0 && sum.is_finite()).then_some(chromaticity)
}

/// Returns the color-matching functions at a wavelength in [380, 780] nm.
fn observer(nm: f64) -> [f64; 3] {
    let at = (nm - FIRST) / STEP;
    let i = (at as usize).min(OBSERVER.len() - 2);
    let f = at - i as f64;
    std::array::from_fn(|k| OBSERVER[i][k] * (1.0 - f) + OBSERVER[i + 1][k] * f)
}

/// Returns the color of evenly spaced samples from `first` to `last` nm, linear between them and 0 outside. Returns `None` without
/// visible power.
pub(super) fn from_samples(first: f64, last: f64, samples: &[f64]) -> Option<ClippedColor> {
    let spacing = (last - first) / (samples.len() - 1) as f64;
    let peak = samples.iter().copied().fold(0.0, f64::max);
    let power = |nm: f64| {
        if nm < first || nm > last {
            return 0.0;
        }
        let at = (nm - first) / spacing;
        let i = (at as usize).min(samples.len() - 2);
        let f = at - i as f64;
        (samples[i] / peak) * (1.0 - f) + (samples[i + 1] / peak) * f
    };
    let [x, y] = chromaticity(power)?;
    from_xy(x, y)
}

/// Returns the color of a black body of `kelvin`.
pub(super) fn from_temperature(kelvin: f64) -> Option<ClippedColor> {
    let [x, y] = chromaticity(|nm| planck(nm, kelvin))?;
    from_xy(x, y)
}

/// Returns Planck's law relative to its value at the red end, where it is largest for the coolest bodies. c2 = h c / k.
fn planck(nm: f64, kelvin: f64) -> f64 {
    const C2: f64 = 1.438_776_877e7;
    let exponent = |nm: f64| C2 / (nm * kelvin);
    let ratio = LAST / nm;
    // (e^b - 1) / (e^a - 1) = e^(b - a) (1 - e^-b) / (1 - e^-a), which does not overflow for cool bodies.
    let (a, b) = (exponent(nm), exponent(LAST));
    ratio * ratio * ratio * ratio * ratio * elementary::exp(b - a) * elementary::exp_m1(-b) / elementary::exp_m1(-a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &[f64], b: &[f64], tolerance: f64) {
        assert_eq!(a.len(), b.len());
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance), "{a:?} is not {b:?}");
    }

    #[test]
    fn equal_energy_is_white_and_keeps_its_chromaticity() {
        close(&from_xy(1.0 / 3.0, 1.0 / 3.0).unwrap().rgb, &[1.0; 3], 1e-12);
        close(&chromaticity(|_| 7.0).unwrap(), &[1.0 / 3.0; 2], 1e-12);
        close(&from_samples(300.0, 900.0, &[2.0, 2.0]).unwrap().rgb, &[1.0; 3], 1e-12);
    }

    #[test]
    fn the_table_integrates_to_equal_sums_as_the_cie_made_it() {
        let sum = |k: usize| OBSERVER.iter().map(|row| row[k]).sum::<f64>();
        // The sums are equal at the CIE's 1 nm; with every tenth value, a small step error remains.
        close(&[sum(0) / sum(1), sum(2) / sum(1)], &[1.0, 1.0], 1e-3);
    }

    #[test]
    fn black_bodies_lie_on_the_planckian_locus() {
        // Chromaticities of the locus: 2856 K is illuminant A, the others are textbook values.
        for (kelvin, xy) in [(2856.0, [0.4476, 0.4074]), (4000.0, [0.3805, 0.3768]), (6504.0, [0.3135, 0.3237])] {
            close(&chromaticity(|nm| planck(nm, kelvin)).unwrap(), &xy, 3e-4);
        }
    }

    #[test]
    fn every_colour_has_luminance_one_and_no_negative_component() {
        let mut samples = vec![0.0; 41];
        for i in 0..41 {
            samples[i] = 1.0;
            let spike = from_samples(380.0, 780.0, &samples).unwrap();
            close(&[luminance(spike.rgb)], &[1.0], 1e-12);
            assert!(spike.rgb.iter().all(|&x| x >= 0.0));
            samples[i] = 0.0;
        }
        for kelvin in [500.0, 1500.0, 1e4, 1e9] {
            close(&[luminance(from_temperature(kelvin).unwrap().rgb)], &[1.0], 1e-12);
        }
    }

    #[test]
    fn saturated_chromaticities_are_clipped_and_say_so() {
        assert!(from_xy(0.08, 0.84).unwrap().clipped);
        assert!(!from_xy(0.4, 0.35).unwrap().clipped);
    }

    #[test]
    fn nearest_visible_chromaticity_is_on_the_locus_or_unchanged() {
        for inside in [[1.0 / 3.0, 1.0 / 3.0], [0.64, 0.33], [0.2, 0.7]] {
            assert_eq!(nearest_visible(inside), inside);
        }
        // Below the line of purples from 380 nm (0.1741, 0.0050) to 700 nm and beyond (0.7347, 0.2653).
        close(&nearest_visible([0.17, 0.0]), &[0.1741, 0.0050], 3e-3);
        close(&nearest_visible([1.0, 0.0]), &[0.7347, 0.2653], 4e-3);
        let [x, y] = nearest_visible([0.4, 0.0]);
        close(&[(y - 0.0050) / (x - 0.1741)], &[0.2603 / 0.5606], 1e-2);
        assert!(from_xy(x, y).is_some_and(|color| color.rgb.iter().all(|c| c.is_finite())));
    }

    #[test]
    fn invisible_spectra_have_no_colour() {
        assert_eq!(from_samples(100.0, 200.0, &[1.0, 1.0]), None);
        assert_eq!(from_samples(400.0, 700.0, &[0.0, 0.0]), None);
        assert_eq!(with_unit_luminance([0.0; 3]), None);
    }
}
