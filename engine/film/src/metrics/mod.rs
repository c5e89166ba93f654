//! Error metrics of an image against a reference.
//!
//! Sums are over the three channels of all pixels that are finite in both images; the others are counted and left out. The
//! arithmetic uses doubles on the 32-bit pixels, like numpy after a conversion.

pub mod flip;
mod plane;
mod ssim;

use crate::tone::ToneCurve;
use crate::{FilmError, Image};
use femc_math::elementary::double;
use plane::Plane;
use serde::Serialize;

/// Term that keeps the relative error finite where the reference is black, (cd/m2)^2.
const RELATIVE_FLOOR: f64 = 0.01;

/// Error of an image `a` against a reference `r`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Mean of `(a - r)^2`, (cd/m2)^2.
    pub mse: f64,
    /// Mean of `(a - r)^2 / (r^2 + 0.01)`.
    pub relmse: f64,
    /// `10 log10(peak^2 / mse)`, dB, where `peak` is the largest component of the reference; infinite for equal images.
    pub psnr: f64,
    /// Mean structural similarity (\[wang2004\]) of the luminance as displayed. Both images use the tone curve of the reference's
    /// automatic exposure, 11 x 11 Gaussian windows of standard deviation 1.5 (cut and renormalized at the border), K1 = 0.01, K2 =
    /// 0.03, dynamic range 1. 1 for equal images.
    pub ssim: f64,
    /// Mean HDR-FLIP (\[andersson2021\]), 0 for equal images, at most 1; see [`flip`].
    pub flip: f64,
    /// Mean of `a` over mean of `r`; 1 when both are black.
    pub mean_ratio: f64,
    /// The pixel with the largest share of `relmse`.
    pub worst: WorstPixel,
    /// Pixels left out.
    pub excluded: ExcludedPixels,
}

/// The pixel with the largest error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorstPixel {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Its color in the image.
    pub value: [f32; 3],
    /// Its color in the reference.
    pub reference: [f32; 3],
    /// Its mean of `(a - r)^2 / (r^2 + 0.01)` over the channels.
    pub relative: f64,
}

/// Pixels that a comparison left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ExcludedPixels {
    /// Pixels with a NaN or infinite component in the image.
    pub image: u64,
    /// Pixels with a NaN or infinite component in the reference.
    pub reference: u64,
    /// Pixels left out: those that are not finite in at least one image.
    pub pixels: u64,
}

/// Compares `image` with `reference`.
/// - errors: the sizes differ, or no pixel is finite in both.
pub fn compare_images(image: &Image, reference: &Image) -> Result<Comparison, FilmError> {
    if (image.width, image.height) != (reference.width, reference.height) {
        return Err(FilmError::SizesDiffer {
            a_width: image.width,
            a_height: image.height,
            b_width: reference.width,
            b_height: reference.height,
        });
    }
    let (image, reference, excluded) = mask_non_finite(image, reference)?;
    let sums = ErrorSums::from_images(&image, &reference);
    let n = 3.0 * (image.pixels.len() as u64 - excluded.pixels) as f64;
    let mse = sums.square / n;
    let curve = ToneCurve::auto([&reference]);
    Ok(Comparison {
        mse,
        relmse: sums.relative / n,
        psnr: if mse == 0.0 { f64::INFINITY } else { 10.0 * double::log10(sums.peak * sums.peak / mse) },
        ssim: ssim::ssim(&display_luma(&image, curve), &display_luma(&reference, curve)),
        flip: flip::hdr_flip(&image, &reference),
        mean_ratio: if sums.image == sums.reference { 1.0 } else { sums.image / sums.reference },
        worst: sums.worst,
        excluded,
    })
}

/// Returns both images with the pixels that are not finite in either of them set to black in both, where they add nothing to any
/// sum.
fn mask_non_finite(image: &Image, reference: &Image) -> Result<(Image, Image, ExcludedPixels), FilmError> {
    let (mut a, mut r, mut excluded) = (image.clone(), reference.clone(), ExcludedPixels::default());
    for (a, r) in a.pixels.iter_mut().zip(&mut r.pixels) {
        let bad = [&*a, &*r].map(|p| !p.iter().all(|v| v.is_finite()));
        excluded.image += u64::from(bad[0]);
        excluded.reference += u64::from(bad[1]);
        if bad[0] || bad[1] {
            excluded.pixels += 1;
            (*a, *r) = ([0.0; 3], [0.0; 3]);
        }
    }
    if excluded.pixels == a.pixels.len() as u64 {
        return Err(FilmError::NothingToCompare);
    }
    Ok((a, r, excluded))
}

struct ErrorSums {
    square: f64,
    relative: f64,
    image: f64,
    reference: f64,
    peak: f64,
    worst: WorstPixel,
}

impl ErrorSums {
    fn from_images(image: &Image, reference: &Image) -> Self {
        let worst = WorstPixel { x: 0, y: 0, value: [0.0; 3], reference: [0.0; 3], relative: -1.0 };
        let mut sums = Self { square: 0.0, relative: 0.0, image: 0.0, reference: 0.0, peak: 0.0, worst };
        for (at, (value, reference)) in image.pixels.iter().zip(&reference.pixels).enumerate() {
            let mut relative = 0.0;
            for (&a, &r) in value.iter().zip(reference) {
                let (a, r) = (f64::from(a), f64::from(r));
                let square = (a - r) * (a - r);
                relative += square / (r * r + RELATIVE_FLOOR);
                sums.square += square;
                sums.image += a;
                sums.reference += r;
                sums.peak = sums.peak.max(r);
            }
            sums.relative += relative;
            if relative / 3.0 > sums.worst.relative {
                let (x, y) = (at as u32 % image.width, at as u32 / image.width);
                sums.worst = WorstPixel { x, y, value: *value, reference: *reference, relative: relative / 3.0 };
            }
        }
        sums
    }
}

/// Returns the Rec.709 luma of the displayed image, 0..1.
fn display_luma(image: &Image, curve: ToneCurve) -> Plane {
    let luma = |p: &[f32; 3]| {
        let [r, g, b] = curve.display(*p);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    Plane::from_values(image.width, image.pixels.iter().map(luma).collect())
}
