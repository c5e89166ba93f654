//! Reference images in two independent halves, and comparisons of images with them.

use femc_film::exr::read;
use femc_film::{FrameImage, Image};
use femc_scene::Scene;
use femc_stats::testing::{sidak, z_test};
use std::path::{Path, PathBuf};

/// Term that limits the weight of black pixels: relmse is the mean of (x - r)^2 / (r^2 + 0.01).
const RELMSE_EPSILON: f64 = 0.01;

/// Rooms with brute-force references.
pub const ROOMS: [&str; 3] = ["box", "glossy", "fog"];

/// Returns the folder of [`ROOMS`].
pub fn rooms_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("references")
}

/// Computes the BLAKE3 digest of a scene's concatenated files.
/// - `folder`: of the scene.
///
/// # Panics
/// If they cannot be read.
pub fn scene_digest(folder: &Path, scene: &Scene) -> blake3::Hash {
    let text = |file: &String| std::fs::read(folder.join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
    blake3::hash(&scene.files.iter().flat_map(text).collect::<Vec<u8>>())
}

/// Two independent images of one scene. Their difference gives their noise.
pub struct Reference {
    halves: [Image; 2],
}

/// Difference between a number of an image and of its reference, with its variance.
#[derive(Clone, Copy, Default)]
struct Difference {
    difference: f64,
    variance: f64,
}

/// Comparison of an image with a reference.
#[derive(Debug)]
pub struct Comparison {
    /// Sum of all channels, over that of the reference.
    pub mean_ratio: f64,
    /// Relmse of the image, including the noise of the reference.
    pub relmse: f64,
    /// Relmse of the reference alone.
    pub reference_noise: f64,
    /// Largest distance between block means of image and reference, over all channels, in standard errors of both.
    pub worst_z: f64,
    /// Top left pixel of the block with the largest distance.
    pub worst_block: (usize, usize),
    /// Distance between the mean luminances of image and reference, in standard errors of both.
    pub luminance_z: f64,
    /// Number of compared values: block means and mean luminance.
    tests: usize,
}

impl Reference {
    /// Returns width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.halves[0].width, self.halves[0].height]
    }

    /// Creates a reference from two independent images of one size.
    pub fn new(halves: [Image; 2]) -> Self {
        Self { halves }
    }

    /// Reads `<name>_A.exr` and `<name>_B.exr` from a folder.
    ///
    /// # Panics
    /// If they cannot be read.
    pub fn read(folder: &Path, name: &str) -> Self {
        let half =
            |half| read(&folder.join(format!("{name}_{half}.exr"))).unwrap_or_else(|error| panic!("{error}")).image;
        Self::new(["A", "B"].map(half))
    }

    /// Returns the luminance of pixel number `at`, cd/m2.
    pub fn pixel_luminance(&self, at: usize) -> f64 {
        self.estimate(|image| f64::from(image.luminance(at))).0
    }

    /// Returns the mean of the halves and its variance.
    fn estimate(&self, value: impl Fn(&Image) -> f64) -> (f64, f64) {
        let [a, b] = [0, 1].map(|half| value(&self.halves[half]));
        (0.5 * (a + b), 0.25 * (a - b) * (a - b))
    }

    /// Returns the relmse of the mean of the halves.
    pub fn noise_relmse(&self) -> f64 {
        self.mean_of_channels(|mean, variance, _, _| variance / (mean * mean + RELMSE_EPSILON))
    }

    /// Returns the mean over all pixels and channels of the mean of the halves.
    pub fn mean(&self) -> f64 {
        self.mean_of_channels(|mean, _, _, _| mean)
    }

    /// Averages a function of the reference's mean and variance over all pixels and channels.
    fn mean_of_channels(&self, value: impl Fn(f64, f64, usize, usize) -> f64) -> f64 {
        let pixels = self.halves[0].pixels.len();
        let all = (0..3 * pixels).map(|index| {
            let (at, c) = (index / 3, index % 3);
            let (mean, variance) = self.estimate(|half| f64::from(half.pixels[at][c]));
            value(mean, variance, at, c)
        });
        all.sum::<f64>() / (3 * pixels) as f64
    }

    /// Compares whole images, and their means over blocks of `block` x `block` pixels.
    pub fn compare(&self, image: &FrameImage, block: usize) -> Comparison {
        let value = |at: usize, c: usize| f64::from(image.color.pixels[at][c]);
        let blocks = self.blocks(image, block);
        let zs = blocks.iter().enumerate().flat_map(|(index, channels)| channels.map(|sum| (sum.z(), index)));
        let (worst_z, worst) = zs.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default();
        let columns = (image.color.width as usize).div_ceil(block);
        Comparison {
            mean_ratio: self.mean_of_channels(|_, _, at, c| value(at, c)) / self.mean(),
            relmse: self
                .mean_of_channels(|mean, _, at, c| (value(at, c) - mean).powi(2) / (mean * mean + RELMSE_EPSILON)),
            reference_noise: self.noise_relmse(),
            worst_z,
            worst_block: (worst % columns * block, worst / columns * block),
            luminance_z: self.luminance(image).z(),
            tests: 3 * blocks.len() + 1,
        }
    }

    /// Sums the differences over each block's pixels, for each channel.
    fn blocks(&self, image: &FrameImage, block: usize) -> Vec<[Difference; 3]> {
        let (width, height) = (image.color.width as usize, image.color.height as usize);
        let columns = width.div_ceil(block);
        let mut blocks = vec![[Difference::default(); 3]; columns * height.div_ceil(block)];
        for at in 0..width * height {
            let sums = &mut blocks[at / width / block * columns + at % width / block];
            for (c, sum) in sums.iter_mut().enumerate() {
                let expected = self.estimate(|half| f64::from(half.pixels[at][c]));
                sum.add((f64::from(image.color.pixels[at][c]), f64::from(image.variance[at][c])), expected);
            }
        }
        blocks
    }

    /// Sums the differences of all pixels' luminances.
    fn luminance(&self, image: &FrameImage) -> Difference {
        let mut sum = Difference::default();
        for at in 0..image.color.pixels.len() {
            let found = (f64::from(image.color.luminance(at)), f64::from(image.luminance_variance[at]));
            sum.add(found, self.estimate(|half| f64::from(half.luminance(at))));
        }
        sum
    }

    /// Returns the mean luminance of all pixels, cd/m2, and its variance.
    pub fn mean_luminance(&self) -> (f64, f64) {
        self.block_luminance(0..self.halves[0].pixels.len())
    }

    /// Returns the mean luminance of these pixels, cd/m2, and its variance.
    pub fn block_luminance(&self, pixels: impl Iterator<Item = usize>) -> (f64, f64) {
        let (mut sum, mut variance, mut count) = (0.0, 0.0, 0.0);
        for at in pixels {
            let one = self.estimate(|half| f64::from(half.luminance(at)));
            (sum, variance, count) = (sum + one.0, variance + one.1, count + 1.0);
        }
        (sum / count, variance / (count * count))
    }

    /// Returns the relmse that an image claims, with the reference in the denominator.
    pub fn claimed_relmse(&self, image: &FrameImage) -> f64 {
        self.mean_of_channels(|mean, _, at, c| f64::from(image.variance[at][c]) / (mean * mean + RELMSE_EPSILON))
    }
}

impl Difference {
    /// Adds a value and an independent expected value, each with its variance.
    fn add(&mut self, found: (f64, f64), expected: (f64, f64)) {
        self.difference += found.0 - expected.0;
        self.variance += found.1 + expected.1;
    }

    /// Returns the difference in standard errors: 0 if there is no difference, NaN if a value is not a number.
    fn z(&self) -> f64 {
        if self.difference == 0.0 { 0.0 } else { self.difference.abs() / self.variance.sqrt() }
    }
}

impl Comparison {
    /// Checks that all block means and the mean luminance agree with the reference, with a two-sided z test of each. `level` is the
    /// probability of a false alarm over all of them.
    pub fn agrees(&self, level: f64) -> bool {
        let p = [self.worst_z, self.luminance_z].map(|z| z_test(z, 1.0, 0.0));
        p.iter().all(|p| *p >= sidak(level, self.tests))
    }
}
