//! Transfer functions from file values in [0, 1] to linear light.

use super::Role;
use femc_math::elementary::double as elementary;

/// Transfer function of a file's values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Transfer {
    /// sRGB (\[iec61966\]).
    Srgb,
    /// A power of the value.
    Power(f64),
    /// The inverse of the curve of ITU-R BT.709.
    Bt709,
}

impl Transfer {
    /// Returns the linear value.
    pub fn linear(self, x: f64) -> f64 {
        /// Scale and end of the linear part of BT.709, with the digits of ITU-T H.273.
        const ALPHA: f64 = 1.099_296_826_809_442;
        const BETA: f64 = 0.018_053_968_510_807;
        match self {
            Self::Srgb if x <= 0.04045 => x / 12.92,
            Self::Srgb => elementary::pow((x + 0.055) / 1.055, 2.4),
            Self::Power(1.0) => x,
            Self::Power(exponent) => elementary::pow(x, exponent),
            Self::Bt709 if x < 4.5 * BETA => x / 4.5,
            Self::Bt709 => elementary::pow((x + (ALPHA - 1.0)) / ALPHA, 1.0 / 0.45),
        }
    }

    /// Returns the value that a file value in [0, 1] stands for in its role.
    pub fn value(self, x: f64, role: Role) -> f32 {
        match role {
            Role::Normals => (2.0 * x - 1.0) as f32,
            Role::Color => self.linear(x) as f32,
        }
    }

    /// Returns the values of all 256 bytes.
    pub fn byte_table(self, role: Role) -> Vec<f32> {
        (0..=u8::MAX).map(|x| self.value(f64::from(x) / 255.0, role)).collect()
    }
}
