//! Tone mapping from luminance in cd/m2 to a display.
//!
//! The global photographic operator (\[reinhard2002\], equation 4), applied to luminance so that hues do not change:
//!
//! ```text
//! x       = exposure * Y                       Y: Rec.709 luminance, cd/m2
//! y       = x (1 + x / w^2) / (1 + x)          w = 8: what is eight times the unit or more is white
//! channel = srgb(clamp(exposure * c * y / x))  srgb: the transfer function of IEC 61966-2-1
//! byte    = round(255 * channel)
//! ```
//!
//! Automatic exposure maps the log-average luminance to 0.18, middle gray. Pixels without light are left out. Pixels below 1e-4 of
//! the mean count as 1e-4 of it, so that a black sky does not decide the exposure.

use crate::{Image, LuminanceLevels, Picture};
use femc_math::elementary::{double, pow};
use femc_math::{Rgb, color};

/// Luminance, in units of 1 / exposure, that is shown as white.
const WHITE: f32 = 8.0;
/// Display value of the log-average luminance, before the curve.
const MIDDLE_GRAY: f64 = 0.18;
/// Smallest luminance in the log-average, relative to the mean.
const DARKEST: f64 = 1e-4;

/// A tone curve for radiances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneCurve {
    /// Factor in front of the curve, 1/(cd/m2).
    pub exposure: f32,
}

impl ToneCurve {
    /// Computes the curve of automatic exposure for all of `images` together, so that a clip does not flicker. Pixels that are not
    /// finite or have no light do not count; if all pixels are black, the exposure is 1.
    pub fn auto<'a>(images: impl IntoIterator<Item = &'a Image>) -> Self {
        let luminances: Vec<f64> = images
            .into_iter()
            .flat_map(|image| (0..image.pixels.len()).map(|i| f64::from(image.luminance(i))))
            .filter(|y| y.is_finite() && *y > 0.0)
            .collect();
        Self::from_luminances(luminances.iter().map(|&y| (y, 1.0)))
    }

    /// Computes the curve of automatic exposure from a luminance histogram of blocks, without keeping all images in memory. Every
    /// block counts as one in the middle of its bin, so the exposure is within half a bin of that of the blocks (test
    /// `level_exposure_is_within_half_a_bin_of_block_exposure`).
    pub fn from_levels(levels: &LuminanceLevels) -> Self {
        Self::from_luminances(levels.lit_bins().map(|(y, count)| (y, count as f64)))
    }

    /// Computes the curve of automatic exposure from weighted luminances.
    /// - `luminances`: positive ones, cd/m2, with their weights, which sum to at least 1.
    pub fn from_luminances(luminances: impl Iterator<Item = (f64, f64)> + Clone) -> Self {
        let n: f64 = luminances.clone().map(|(_, weight)| weight).sum();
        let mean = luminances.clone().map(|(y, weight)| weight * y).sum::<f64>() / n.max(1.0);
        if mean <= 0.0 {
            return Self { exposure: 1.0 };
        }
        let log_mean = luminances.map(|(y, weight)| weight * double::ln(y.max(DARKEST * mean))).sum::<f64>() / n;
        Self { exposure: (MIDDLE_GRAY / double::exp(log_mean)) as f32 }
    }

    /// Returns the display values, 0..1, of a linear color in cd/m2; NaN and negative components are shown as 0.
    pub fn display(self, color: [f32; 3]) -> [f32; 3] {
        let scaled = color.map(|c| if c > 0.0 { (c * self.exposure).min(f32::MAX / 4.0) } else { 0.0 });
        let x = color::luminance(Rgb::from_array(scaled));
        // y / x; for x above 1e18 the square would overflow, and everything is white long before.
        let gain = if x < 1e18 { (1.0 + x / (WHITE * WHITE)) / (1.0 + x) } else { 1.0 };
        scaled.map(|c| srgb((c * gain).min(1.0)))
    }

    /// Converts the image to an 8-bit picture.
    pub fn picture(self, image: &Image) -> Picture {
        let byte = |v: f32| (255.0 * v + 0.5) as u8;
        let pixels = image.pixels.iter().map(|&p| self.display(p).map(byte)).collect();
        Picture { width: image.width, height: image.height, pixels }
    }
}

/// Applies the transfer function of sRGB to `linear` in 0..1 (IEC 61966-2-1).
pub fn srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * pow(linear, 1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_formula_holds_at_hand_computed_points() {
        let curve = ToneCurve { exposure: 0.5 };
        assert_eq!(curve.display([0.0; 3]), [0.0; 3]);
        // Gray of 2 cd/m2: x = 1, y = (1 + 1/64) / 2 = 0.5078125, srgb(y) = 0.7405.
        let gray = curve.display([2.0; 3]);
        assert!((gray[0] - 0.7405).abs() < 1e-4 && (gray[0] - gray[2]).abs() < 1e-6, "{gray:?}");
        // White starts at x = 8.
        let white = curve.display([16.0; 3]);
        assert!(white.iter().all(|&v| (v - 1.0).abs() < 1e-4));
        assert!((srgb(0.001) - 0.01292).abs() < 1e-7 && (srgb(1.0) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_curve_is_monotone_and_total() {
        let curve = ToneCurve { exposure: 1.0 };
        let mut last = -1.0;
        for i in 0..400 {
            let v = curve.display([1e-6 * 1.2f32.powi(i); 3])[1];
            assert!(v >= last && v <= 1.0, "step {i}");
            last = v;
        }
        for odd in [f32::NAN, f32::NEG_INFINITY, -3.0] {
            assert_eq!(curve.display([odd; 3]), [0.0; 3]);
        }
        assert!(curve.display([f32::INFINITY; 3]).iter().all(|v| (v - 1.0).abs() < 1e-6));
    }

    #[test]
    fn auto_exposure_follows_the_light_and_ignores_black_and_nan() {
        let image = Image::filled(8, 8, [3.0; 3]);
        let exposure = ToneCurve::auto([&image]).exposure;
        assert!((exposure - 0.06).abs() < 1e-5);
        let brighter = Image::filled(8, 8, [300.0; 3]);
        assert!((ToneCurve::auto([&brighter]).exposure * 100.0 - exposure).abs() < 1e-5);
        let mut odd = image.clone();
        odd.pixels[0] = [f32::NAN; 3];
        assert_eq!(ToneCurve::auto([&odd]).exposure, exposure);
        assert_eq!(ToneCurve::auto([&Image::filled(2, 2, [0.0; 3])]).exposure, 1.0);
    }
}
