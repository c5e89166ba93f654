use clap::ValueEnum;
use serde::Deserialize;

/// Method of light transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// A pilot chooses between `pt` and `femc`.
    Auto,
    /// Path tracing alone.
    Pt,
    /// The finite-element solution alone: fast, biased.
    Fem,
    /// Path tracing guided by the finite-element solution: unbiased.
    Femc,
}

/// Pixel filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Filter {
    /// A pixel is the mean luminance over its area.
    Box,
    /// Tent of radius one pixel.
    Triangle,
    /// Gaussian.
    Gaussian,
    /// Blackman-Harris window.
    BlackmanHarris,
}
