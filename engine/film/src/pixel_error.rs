//! Error estimates of single pixels, from the image's own samples.
//!
//! The estimated variance of a pixel has one degree of freedom ([`crate::image::FrameImage`]), so Student's interval is 12.7
//! standard errors wide to either side. Therefore the estimates of a pixel and its neighbors are pooled, which gives up to nine
//! degrees of freedom. Neighbors differ in brightness and in their numbers of samples. Their common property is the variance of a
//! sample relative to the luminance, as if all light came in samples of one size, which are more frequent where it is brighter. Two
//! other pools are worse. Pooled absolute variances give dark pixels beside bright ones the noise of the bright ones. Pooled
//! variances relative to the squared luminance contain the truth too seldom where bright samples are rare, because a pixel without
//! a bright sample is also the darker one.

/// Channels of an image from which the errors of its pixels are estimated, row by row.
#[derive(Clone, Copy, Debug)]
pub struct PixelChannels<'a> {
    /// Number of columns.
    pub width: usize,
    /// Luminance, cd/m2.
    pub luminance: &'a [f32],
    /// Estimated variance of the luminance, from two halves, cd2/m4.
    pub variance: &'a [f32],
    /// Number of samples in the luminance.
    pub samples: &'a [f32],
}

/// Error of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelError {
    /// Standard error of the luminance, relative to it.
    pub standard_error: f64,
    /// Degrees of freedom of the standard error: the number of pixels in the pool.
    pub freedom: u8,
}

impl PixelError {
    /// Returns the half width of the 95 % interval of the pixel's luminance, relative to it.
    pub fn half_width(&self) -> f64 {
        crate::convergence::student_95(f64::from(self.freedom)) * self.standard_error
    }
}

/// Estimates the errors of all pixels, row by row. `None`: the pixel is unlit, or has fewer than two samples.
pub fn pixel_errors(channels: PixelChannels<'_>) -> Vec<Option<PixelError>> {
    let PixelChannels { width, luminance, variance, samples } = channels;
    let height = luminance.len() / width.max(1);
    let is_known = |at: usize| luminance[at] > 0.0 && samples[at] >= 2.0 && variance[at].is_finite();
    // Variance of a sample, divided by the luminance.
    let dispersion = |at: usize| f64::from(variance[at]) * f64::from(samples[at]) / f64::from(luminance[at]);
    let error = |at: usize| {
        let (x, y) = (at % width, at / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let pool =
            rows.flat_map(|row| (x.saturating_sub(1)..(x + 2).min(width)).map(move |column| row * width + column));
        let (sum, freedom) =
            pool.filter(|&at| is_known(at)).fold((0.0, 0), |(sum, n), at| (sum + dispersion(at), n + 1));
        let square = sum / f64::from(freedom) / (f64::from(samples[at]) * f64::from(luminance[at]));
        PixelError { standard_error: square.sqrt(), freedom }
    };
    (0..luminance.len()).map(|at| is_known(at).then(|| error(at))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn errors(width: usize, luminance: &[f32], variance: &[f32], samples: &[f32]) -> Vec<Option<PixelError>> {
        pixel_errors(PixelChannels { width, luminance, variance, samples })
    }

    #[test]
    fn interior_pixel_has_nine_degrees_of_freedom_and_corner_four() {
        let all = errors(4, &[2.0; 12], &[0.04; 12], &[64.0; 12]);
        let freedom: Vec<u8> = all.iter().flatten().map(|error| error.freedom).collect();
        assert_eq!(freedom, [4, 6, 6, 4, 6, 9, 9, 6, 4, 6, 6, 4]);
        assert!(all.iter().flatten().all(|error| (error.standard_error - 0.1).abs() < 1e-7), "{all:?}");
        let width = all[5].unwrap().half_width();
        assert!((width / 0.2262 - 1.0).abs() < 0.01, "2.262 standard errors: {width}");
    }

    #[test]
    fn the_pool_is_in_units_of_a_sample_and_of_the_luminance() {
        // The right pixel has four times the samples and nine times the light, so the left pixel would have 4/9 of its variance.
        let all = errors(2, &[1.0, 9.0], &[0.01, 0.0225], &[16.0, 64.0]);
        let [left, right] = [all[0].unwrap(), all[1].unwrap()];
        assert_eq!((left.freedom, right.freedom), (2, 2));
        assert!(
            (left.standard_error - 0.1).abs() < 1e-7 && (right.standard_error - 0.15 / 9.0).abs() < 1e-8,
            "{all:?}"
        );
    }

    #[test]
    fn unlit_and_single_sample_pixels_have_and_give_no_error() {
        let all = errors(4, &[1.0, 0.0, 1.0, 1.0], &[0.01, 0.0, 1.0, 0.04], &[8.0, 8.0, 1.0, 8.0]);
        assert_eq!((all[1], all[2]), (None, None));
        assert_eq!(all[0].map(|error| error.freedom), Some(1));
        assert!((all[3].unwrap().standard_error - 0.2).abs() < 1e-7);
        assert!(errors(1, &[], &[], &[]).is_empty());
    }
}
