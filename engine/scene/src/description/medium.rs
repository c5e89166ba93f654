use super::{Location, MediumId};
use femc_math::{Transform, glam::DVec3};
use serde::{Deserialize, Serialize};

/// Phase function; cosines are between propagation directions (positive parameter: forward).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Phase {
    /// 1 / (4 pi).
    #[default]
    Isotropic,
    /// Henyey-Greenstein with mean cosine g in (-1, 1).
    HenyeyGreenstein {
        /// Mean cosine.
        g: f64,
    },
    /// Schlick's approximation with parameter k in (-1, 1).
    Schlick {
        /// Parameter k.
        k: f64,
    },
    /// 3 / (16 pi) (1 + cos^2).
    Rayleigh,
}

/// Spatial factor on both coefficients.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Density {
    /// 1 everywhere.
    #[default]
    Uniform,
    /// 1 below `z0`, exp(-(z - z0) / scale) above; world z.
    Height {
        /// Height of full density, m.
        z0: f64,
        /// Scale height, m, > 0.
        scale: f64,
    },
}

/// A participating medium.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Medium {
    /// Name.
    pub name: String,
    /// Location of the medium's definition.
    pub location: Location,
    /// Scattering coefficient, 1/m (the amount; selectors set it).
    pub sigma_s: f64,
    /// Color factor on `sigma_s`; (1, 1, 1) unless raw RGB was given.
    pub color: [f64; 3],
    /// Absorption coefficient, 1/m (the amount; selectors set it).
    pub sigma_a: f64,
    /// Color factor on `sigma_a`; (1, 1, 1) unless raw RGB was given between `sigma_s` and `sigma_a`.
    pub absorption_color: [f64; 3],
    /// Phase function.
    pub phase: Phase,
    /// Isotropic emission, lm/m3: the emitted radiance per meter is `glow / (4 pi)`.
    pub glow: f64,
    /// Color of the glow, luminance 1 unless raw RGB.
    pub glow_color: [f64; 3],
    /// Density factor.
    pub density: Density,
}

impl Medium {
    /// Maximum number of nested closed solids whose media a path tracks.
    pub const MAX_NESTED: usize = 8;

    /// Returns the extinction coefficient of each channel at density 1, 1/m.
    pub fn extinction(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| self.sigma_s * self.color[i] + self.sigma_a * self.absorption_color[i])
    }

    /// Returns whether the medium neither scatters nor absorbs nor glows, with its present coefficients.
    pub fn is_vacuum(&self) -> bool {
        let is_black = |color: [f64; 3], amount: f64| color.iter().all(|channel| channel * amount <= 0.0);
        is_black(self.color, self.sigma_s)
            && is_black(self.absorption_color, self.sigma_a)
            && is_black(self.glow_color, self.glow)
    }
}

/// Placement of a medium. Overlapping regions add up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MediumRegion {
    /// The medium.
    pub medium: MediumId,
    /// The volume.
    pub bounds: RegionBounds,
    /// Location in the file.
    pub location: Location,
}

/// The volume of a region.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum RegionBounds {
    /// All space, including the camera.
    Everywhere,
    /// A box in its own frame.
    Box {
        /// Lower corner, local frame, m.
        min: DVec3,
        /// Upper corner, local frame, m.
        max: DVec3,
        /// Local frame to world.
        to_world: Transform,
    },
}
