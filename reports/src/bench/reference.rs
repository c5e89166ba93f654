//! Reference images and their own noise.

use crate::ReportError;
use femc_film::{Image, exr};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// A reference as given on the command line: a file, or two independent halves separated by a comma.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReferenceSpec {
    /// `REF.exr`; `REF_A.exr` and `REF_B.exr` beside it are its halves, if they exist.
    File(PathBuf),
    /// `A.exr,B.exr`.
    Halves([PathBuf; 2]),
}

/// A reference image.
#[derive(Clone, Debug)]
pub struct Reference {
    /// The image.
    pub image: Image,
    /// Noise of the reference; `None`: unknown, because there are no halves.
    pub noise: Option<Noise>,
}

/// Squared error of a reference, estimated from its halves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Noise {
    /// Contribution of the reference to a mse against it, (cd/m2)^2.
    pub mse: f64,
    /// Contribution of the reference to a relmse against it.
    pub relmse: f64,
}

/// Term that keeps the relative error finite where the reference is black, (cd/m2)^2: as in [`femc_film::metrics`].
const RELATIVE_FLOOR: f64 = 0.01;
/// Largest relmse between a reference and the mean of its halves that counts as rounding, as a fraction of the reference's noise.
const ROUNDING: f64 = 1e-3;

impl FromStr for ReferenceSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<&str> = text.split(',').collect();
        match parts[..] {
            [file] if !file.is_empty() => Ok(Self::File(file.into())),
            [a, b] if !a.is_empty() && !b.is_empty() => Ok(Self::Halves([a.into(), b.into()])),
            _ => Err(format!("expected REF.exr, or two independent halves A.exr,B.exr, found `{text}`")),
        }
    }
}

impl std::fmt::Display for ReferenceSpec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File(file) => write!(f, "{}", file.display()),
            Self::Halves([a, b]) => write!(f, "{},{}", a.display(), b.display()),
        }
    }
}

impl ReferenceSpec {
    /// Reads the reference, and its halves if they exist.
    pub fn read(&self) -> Result<Reference, ReportError> {
        match self {
            Self::Halves(halves) => self.read_halves(halves),
            Self::File(file) => {
                let halves = ["A", "B"].map(|half| half_path(file, half));
                let is_there = halves.iter().all(|half| half.is_file());
                match (file.exists(), is_there) {
                    (false, true) => self.read_halves(&halves),
                    (_, false) => Ok(Reference { image: read(file)?, noise: None }),
                    (true, true) => self.with_halves(read(file)?, &halves),
                }
            }
        }
    }

    fn read_halves(&self, halves: &[PathBuf; 2]) -> Result<Reference, ReportError> {
        let [a, b] = [read(&halves[0])?, read(&halves[1])?];
        self.check_equal_sizes(&a, &b)?;
        let image = mean(&a, &b);
        Ok(Reference { noise: Some(Noise::from_halves(&a, &b)), image })
    }

    fn with_halves(&self, image: Image, halves: &[PathBuf; 2]) -> Result<Reference, ReportError> {
        let halves = self.read_halves(halves)?;
        self.check_equal_sizes(&image, &halves.image)?;
        let noise = halves.noise.map_or(0.0, |noise| noise.relmse);
        let off = femc_film::compare_images(&image, &halves.image)?.relmse;
        if off > ROUNDING * noise + 1e-12 {
            return Err(ReportError::NotHalves(self.to_string()));
        }
        Ok(Reference { image, ..halves })
    }

    fn check_equal_sizes(&self, a: &Image, b: &Image) -> Result<(), ReportError> {
        if (a.width, a.height) == (b.width, b.height) {
            return Ok(());
        }
        let [a, b] = [a, b].map(|it| format!("{}x{}", it.width, it.height));
        Err(ReportError::ReferenceSizes { named: self.to_string(), sizes: format!("{a} and {b} pixels") })
    }
}

/// Returns the path `REF_A.exr` for `REF.exr`.
fn half_path(file: &Path, half: &str) -> PathBuf {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!("{stem}_{half}.exr"))
}

fn read(path: &Path) -> Result<Image, ReportError> {
    if !path.exists() {
        return Err(ReportError::NoReference(path.to_owned()));
    }
    Ok(exr::read(path)?.image)
}

fn mean(a: &Image, b: &Image) -> Image {
    let half = |(a, b): (&[f32; 3], &[f32; 3])| std::array::from_fn(|c| 0.5 * (a[c] + b[c]));
    Image { pixels: a.pixels.iter().zip(&b.pixels).map(half).collect(), ..*a }
}

impl Noise {
    /// Estimates the noise of the mean of two independent halves: a squared half difference is an unbiased estimate of the mean's
    /// variance. Pixels that are not finite are left out, as in comparisons.
    fn from_halves(a: &Image, b: &Image) -> Self {
        let (mut mse, mut relmse, mut count) = (0.0, 0.0, 0_u64);
        for (a, b) in a.pixels.iter().zip(&b.pixels) {
            if !a.iter().chain(b).all(|value| value.is_finite()) {
                continue;
            }
            for (a, b) in a.iter().zip(b) {
                let (mean, half) = (0.5 * (f64::from(*a) + f64::from(*b)), 0.5 * (f64::from(*a) - f64::from(*b)));
                mse += half * half;
                relmse += half * half / (mean * mean + RELATIVE_FLOOR);
                count += 1;
            }
        }
        let count = count.max(1) as f64;
        Self { mse: mse / count, relmse: relmse / count }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a congruential generator of numbers from -0.5 to 0.5, with mean 0 and variance 1/12.
    fn random(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        }
    }

    /// Returns an image with true value 2 and noise of this variance.
    fn noisy(seed: u64, variance: f64) -> Image {
        let mut random = random(seed);
        let mut image = Image::filled(128, 128, [0.0; 3]);
        for value in image.pixels.iter_mut().flatten() {
            *value = (2.0 + random() * (12.0 * variance).sqrt()) as f32;
        }
        image
    }

    #[test]
    fn error_without_references_noise_is_images_own_error() {
        let [a, b] = [noisy(1, 0.02), noisy(2, 0.02)];
        let (reference, noise) = (mean(&a, &b), Noise::from_halves(&a, &b));
        assert!((noise.mse / 0.01 - 1.0).abs() < 0.03, "halves of 0.02 have a mean of 0.01: {noise:?}");
        let found = femc_film::compare_images(&noisy(3, 0.005), &reference).expect("one size");
        assert!((found.mse / 0.015 - 1.0).abs() < 0.03, "with the reference's noise: {}", found.mse);
        assert!(((found.mse - noise.mse) / 0.005 - 1.0).abs() < 0.05, "without: {}", found.mse - noise.mse);
        let (relmse, truth) = (found.relmse - noise.relmse, 0.005 / 4.01);
        assert!((relmse / truth - 1.0).abs() < 0.06, "{relmse} for {truth}");
    }

    #[test]
    fn pixels_that_are_no_numbers_tell_nothing_of_the_noise() {
        let [mut a, b] = [Image::filled(2, 1, [1.0; 3]), Image::filled(2, 1, [3.0; 3])];
        a.pixels[0][1] = f32::NAN;
        assert_eq!(Noise::from_halves(&a, &b).mse, 1.0);
    }

    #[test]
    fn a_reference_is_a_file_or_two_halves() {
        assert_eq!("a.exr".parse(), Ok(ReferenceSpec::File("a.exr".into())));
        assert_eq!("a.exr,b.exr".parse(), Ok(ReferenceSpec::Halves(["a.exr".into(), "b.exr".into()])));
        assert!(["", "a.exr,", "a,b,c"].iter().all(|text| text.parse::<ReferenceSpec>().is_err()));
        assert_eq!(half_path(Path::new("x/box.exr"), "A"), Path::new("x/box_A.exr"));
    }
}
