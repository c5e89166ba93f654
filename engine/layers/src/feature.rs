//! Features (AOVs): properties of the first hit of camera rays, stored as layers without light.

use serde::{Deserialize, Serialize};

/// A property of the first surface that a camera ray hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// The shading normal, unit, world frame, toward the camera.
    Normal,
    /// Position of the hit, world frame, m.
    Position,
    /// Distance along the view axis, m.
    Depth,
    /// Fraction of the light that the surface scatters, by color channel.
    Albedo,
    /// Motion from the position in the picture to the position in the next frame, pixels, x to the right and y down.
    Motion,
    /// Name of the innermost object that contains the surface.
    Object,
    /// Name of the surface's material.
    Material,
    /// Estimated root mean square error of the light that the first pass has found and that diffuse scattering brings to the camera,
    /// cd/m2; 0 without a first pass.
    FirstPassError,
}

impl Feature {
    /// Names of the features, in order.
    pub const NAMES: [&str; 8] =
        ["normal", "position", "depth", "albedo", "motion", "object", "material", "first_pass_error"];
    const ALL: [Self; 8] = [
        Self::Normal,
        Self::Position,
        Self::Depth,
        Self::Albedo,
        Self::Motion,
        Self::Object,
        Self::Material,
        Self::FirstPassError,
    ];

    /// Returns the name.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// Returns the feature with a name, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().position(|known| *known == name).map(|at| Self::ALL[at])
    }

    /// Returns the last parts of the channel names, one for each averaged number: `normal.X`.
    pub fn channels(self) -> &'static [&'static str] {
        match self {
            Self::Normal | Self::Position => &["X", "Y", "Z"],
            Self::Depth => &["Z"],
            Self::Albedo => &["R", "G", "B"],
            Self::Motion => &["X", "Y"],
            Self::Object | Self::Material => &[],
            Self::FirstPassError => &["Y"],
        }
    }

    /// Returns the name of the Cryptomatte, for a feature that is a name instead of numbers.
    pub fn cryptomatte_name(self) -> Option<&'static str> {
        match self {
            Self::Object => Some("crypto_object"),
            Self::Material => Some("crypto_material"),
            _ => None,
        }
    }

    /// Checks whether the channels of some feature begin with this name.
    pub(crate) fn is_reserved_name(name: &str) -> bool {
        let is_matte = |feature: &Self| feature.cryptomatte_name().is_some_and(|matte| name.starts_with(matte));
        Self::from_name(name).is_some() || Self::ALL.iter().any(is_matte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_feature_has_the_name_that_finds_it() {
        for (feature, name) in Feature::ALL.into_iter().zip(Feature::NAMES) {
            assert_eq!((feature.name(), Feature::from_name(name)), (name, Some(feature)));
        }
        assert_eq!(Feature::from_name("normals"), None);
    }
}
