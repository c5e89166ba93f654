//! Floating-point images.

use femc_math::{Rgb, color};

/// Linear Rec.709 image, luminance in cd/m2; row by row from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: Vec<[f32; 3]>,
}

impl Image {
    /// Creates an image of one color.
    pub fn filled(width: u32, height: u32, color: [f32; 3]) -> Self {
        Self { width, height, pixels: vec![color; width as usize * height as usize] }
    }

    /// Returns the Rec.709 luminance of pixel number `at`, cd/m2.
    pub fn luminance(&self, at: usize) -> f32 {
        color::luminance(Rgb::from_array(self.pixels[at]))
    }
}

/// A resolved frame: the image and other properties of each pixel, all row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameImage {
    /// Mean of the good samples.
    pub color: Image,
    /// Estimated variance of that mean, by channel. It is estimated from the difference of two independent halves of the samples:
    /// unbiased, with one degree of freedom. For a single sample it is the squared mean.
    pub variance: Vec<[f32; 3]>,
    /// Estimated variance of the mean luminance, cd2/m4.
    pub luminance_variance: Vec<f32>,
    /// Mean albedo of the first surface (zero if there is none), 0..1.
    pub albedo: Vec<[f32; 3]>,
    /// Mean distance of the first surface over the samples that hit one, meters; 0 if none did.
    pub depth: Vec<f32>,
    /// Number of good samples that count in the mean.
    pub samples: Vec<u32>,
}

/// Computes the BLAKE3 digest of size and pixels, which depends on nothing else in the files: images with the same bits have equal
/// digests.
pub fn pixel_digest(image: &Image) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&image.width.to_le_bytes());
    hasher.update(&image.height.to_le_bytes());
    for row in image.pixels.chunks(image.width.max(1) as usize) {
        let bytes: Vec<u8> = row.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        hasher.update(&bytes);
    }
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_sees_one_bit_and_the_shape() {
        let image = Image::filled(4, 2, [0.25, 0.5, 1.0]);
        let mut other = image.clone();
        assert_eq!(pixel_digest(&image), pixel_digest(&other));
        other.pixels[7][2] = f32::from_bits(1.0f32.to_bits() + 1);
        assert_ne!(pixel_digest(&image), pixel_digest(&other));
        assert_ne!(pixel_digest(&image), pixel_digest(&Image { width: 2, height: 4, ..image.clone() }));
    }
}
