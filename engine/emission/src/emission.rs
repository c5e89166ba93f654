//! Radiance of an emitter as a function of direction.

use femc_math::color::luminance;
use femc_math::{Rgb, elementary};
use std::f32::consts::{FRAC_1_PI, PI};

/// Sides of a surface that emit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EmittingSides {
    /// The front only; rays from behind pass through the surface.
    One,
    /// Both sides, each with the full emittance.
    #[default]
    Two,
}

/// Angular profile of the emitted radiance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AngularProfile {
    /// `emittance / pi` for every direction.
    #[default]
    Lambertian,
    /// `emittance (n + 2) / (2 pi) cos^n`, which has the same emittance.
    Lobe {
        /// Exponent n >= 0.
        exponent: f32,
    },
}

/// Emission of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emission {
    /// Emittance of one side, lm/m2 (linear Rec.709).
    pub emittance: Rgb,
    /// Angular profile.
    pub profile: AngularProfile,
    /// Emitting sides.
    pub sides: EmittingSides,
}

impl Emission {
    /// Returns the radiance (cd/m2) that leaves at cosine `cos` with the front normal.
    #[inline]
    pub fn radiance(&self, cos: f32) -> Rgb {
        if cos == 0.0 || (cos < 0.0 && self.sides == EmittingSides::One) {
            return Rgb::ZERO;
        }
        match self.profile {
            AngularProfile::Lambertian => self.emittance * FRAC_1_PI,
            AngularProfile::Lobe { exponent } => {
                self.emittance * ((exponent + 2.0) / (2.0 * PI) * elementary::pow(cos.abs().min(1.0), exponent))
            }
        }
    }

    /// Checks whether nothing leaves at cosine `cos` with the front normal.
    #[inline]
    pub fn is_dark(&self, cos: f64) -> bool {
        cos == 0.0 || (cos < 0.0 && self.sides == EmittingSides::One)
    }

    /// Returns the luminous flux (lm) of `area` m2.
    pub fn power(&self, area: f64) -> f32 {
        let sides = match self.sides {
            EmittingSides::One => 1.0,
            EmittingSides::Two => 2.0,
        };
        (f64::from(luminance(self.emittance)) * area * sides) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn emittance_is_the_cosine_integral_of_every_radiance_profile() {
        let exponents = [0.0, 1.0, 7.5, 80.0].map(|exponent| AngularProfile::Lobe { exponent });
        for profile in [AngularProfile::Lambertian].into_iter().chain(exponents) {
            let emission = Emission { emittance: Rgb::new(3.0, 2.0, 1.0), profile, sides: EmittingSides::One };
            let n = 20_000;
            // 2 pi int L c dc
            let sum: f64 = (0..n)
                .map(|i| (f64::from(i) + 0.5) / f64::from(n))
                .map(|c| f64::from(emission.radiance(c as f32).x) * c)
                .sum();
            let emittance = sum / f64::from(n) * std::f64::consts::TAU;
            assert!((emittance - 3.0).abs() < 1e-3, "{profile:?}: {emittance}");
            assert_eq!(emission.radiance(-0.5), Rgb::ZERO, "a one-sided emitter is dark behind");
        }
    }
}
