//! Features: what the camera sees first, as layers that tell of no light.

use serde::{Deserialize, Serialize};

/// Something about the first surface that a camera ray meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Feature {
    /// The shading normal, unit, world frame, toward the camera.
    Normal,
    /// Where it is, world frame, m.
    Position,
    /// Distance along the view axis, m.
    Depth,
    /// Share of the light that it scatters, by color channel.
    Albedo,
    /// From where it is in the picture to where it will be in the next frame, pixels, x to the right and y down.
    Motion,
    /// The innermost object that it is part of, by name.
    Object,
    /// Its material, by name.
    Material,
}

impl Feature {
    /// What they are called, in order.
    pub const NAMES: [&str; 7] = ["normal", "position", "depth", "albedo", "motion", "object", "material"];
    const ALL: [Self; 7] =
        [Self::Normal, Self::Position, Self::Depth, Self::Albedo, Self::Motion, Self::Object, Self::Material];

    /// What it is called.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// The feature of a name, if there is one.
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMES.iter().position(|known| *known == name).map(|at| Self::ALL[at])
    }

    /// Last parts of its channels' names, one for each number that is averaged: `normal.X`.
    pub fn channels(self) -> &'static [&'static str] {
        match self {
            Self::Normal | Self::Position => &["X", "Y", "Z"],
            Self::Depth => &["Z"],
            Self::Albedo => &["R", "G", "B"],
            Self::Motion => &["X", "Y"],
            Self::Object | Self::Material => &[],
        }
    }

    /// Of a feature that is a name, not numbers: the name of its Cryptomatte.
    pub fn matte(self) -> Option<&'static str> {
        match self {
            Self::Object => Some("crypto_object"),
            Self::Material => Some("crypto_material"),
            _ => None,
        }
    }

    /// Whether the channels of some feature begin with this.
    pub(crate) fn has_channels(name: &str) -> bool {
        let is_matte = |feature: &Self| feature.matte().is_some_and(|matte| name.starts_with(matte));
        Self::named(name).is_some() || Self::ALL.iter().any(is_matte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_feature_has_the_name_that_finds_it() {
        for (feature, name) in Feature::ALL.into_iter().zip(Feature::NAMES) {
            assert_eq!((feature.name(), Feature::named(name)), (name, Some(feature)));
        }
        assert_eq!(Feature::named("normals"), None);
    }
}
