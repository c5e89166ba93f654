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

/// Guides of the paths of two passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize)]
pub enum Guide {
    /// Openings, bright patches and a weight window.
    #[serde(rename = "targets", alias = "lobes")]
    #[value(alias = "lobes")]
    Targets,
    /// Tables of directions, as in the first version of the method, of 1998: a baseline for measurements.
    #[value(name = "1998")]
    #[serde(rename = "1998")]
    Tables1998,
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
