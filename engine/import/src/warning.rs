//! Warnings: oddities of a scene file that do not stop its import.

use crate::Position;
use femc_scene::Standpoint;
use std::{borrow::Cow, fmt};

/// An oddity at a position. Displays as `file:line:column: oddity`.
#[derive(Clone, Debug, PartialEq)]
pub struct Warning {
    /// File, line and column of the oddity.
    pub at: Position,
    /// Kind of oddity, with its details.
    pub kind: WarningKind,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.at, self.kind)
    }
}

/// An oddity of a scene file.
#[derive(Clone, Debug, PartialEq)]
pub enum WarningKind {
    /// An entity that is not part of the format; reported once per name.
    UnknownEntity {
        /// Name of the entity.
        name: String,
    },
    /// A face without area.
    NoArea,
    /// A non-planar face.
    NotPlanar {
        /// Largest distance from the best plane, divided by the size of the face.
        deviation: f64,
    },
    /// A face whose triangles do not add up to its area, because it crosses itself.
    CrossesItself,
    /// A hole wound like the contour around it.
    HoleOrientation,
    /// A chromaticity outside Rec.709, which was clipped.
    OutOfGamut,
    /// A color with which a material demands more light of a channel than it receives. The renderer limits it.
    ChannelAboveOne {
        /// Largest share of the light that a channel demands.
        sum: f64,
    },
    /// Negative values in a spectrum.
    NegativeSpectrum {
        /// Number of negative values.
        count: usize,
    },
    /// A chromaticity with y = 0, which no light can have.
    NoLuminance {
        /// CIE x as written.
        x: f64,
        /// CIE x and y that are used instead.
        taken: [f64; 2],
    },
    /// A material that reflects more than it receives; it was scaled down to 1.
    TooBright {
        /// Name of the material.
        material: String,
        /// Sum of the reflectances and transmittances in the file.
        sum: f64,
    },
    /// A file outside the scene's folder but below the root; reported once per file.
    OutsideFolder {
        /// Path below the root.
        path: String,
    },
    /// An object that is opened again in another place; reported once per name.
    ObjectReopened {
        /// Full name.
        name: String,
        /// Position of its first opening.
        first: Position,
    },
    /// An `o` or `xf` that is still open at the end of the file that opened it; it was closed there.
    LeftOpen {
        /// `o` or `xf`.
        entity: &'static str,
    },
    /// A definition that a later one replaced.
    DefinitionReplaced {
        /// Kind and name, such as `camera main`.
        what: String,
    },
    /// A transform around an element that is always in world coordinates.
    NotTransformed {
        /// Kind of element that ignores the transform.
        what: &'static str,
    },
    /// Photometric data that deviates from LM-63 but has a clear meaning.
    Photometry {
        /// The data found, and its interpretation.
        what: Cow<'static, str>,
    },
    /// A textured material on a surface without texture coordinates; reported once per material.
    NoTextureCoordinates {
        /// Name of the material.
        material: String,
    },
    /// A header field of an image file that is not used, or values outside their domain; reported once per file.
    Texture {
        /// Path of the file.
        path: String,
        /// The data found, and its interpretation.
        what: String,
    },
    /// A scene without cameras, which received a default camera.
    DefaultCamera {
        /// Position of the camera: inside or outside.
        standpoint: Standpoint,
        /// Eye, m.
        origin: [f64; 3],
        /// Point that the camera looks at, m.
        target: [f64; 3],
    },
    /// More warnings than are kept.
    TooManyWarnings {
        /// Number of warnings kept.
        kept: usize,
    },
}

impl WarningKind {
    /// Returns the kind of oddity, such as `unknown-entity`.
    pub fn code(&self) -> &'static str {
        match self {
            Self::UnknownEntity { .. } => "unknown-entity",
            Self::NoArea => "degenerate-surface",
            Self::NotPlanar { .. } => "non-planar-face",
            Self::CrossesItself => "crossing-face",
            Self::HoleOrientation => "hole-orientation",
            Self::OutOfGamut => "out-of-gamut",
            Self::ChannelAboveOne { .. } => "energy-gain",
            Self::NegativeSpectrum { .. } => "negative-spectrum",
            Self::NoLuminance { .. } => "no-luminance",
            Self::TooBright { .. } => "scaled-reflectance",
            Self::OutsideFolder { .. } => "outside-folder",
            Self::ObjectReopened { .. } => "object-again",
            Self::LeftOpen { .. } => "left-open",
            Self::DefinitionReplaced { .. } => "duplicate-name",
            Self::NotTransformed { .. } => "not-transformed",
            Self::Photometry { .. } => "photometry",
            Self::NoTextureCoordinates { .. } => "no-texture-coordinates",
            Self::Texture { .. } => "texture",
            Self::DefaultCamera { .. } => "default-camera",
            Self::TooManyWarnings { .. } => "incomplete",
        }
    }
}

impl fmt::Display for WarningKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownEntity { name } => write!(f, "unknown entity `{name}` skipped (reported once per name)"),
            Self::NoArea => f.write_str("face without area"),
            Self::NotPlanar { deviation } => {
                write!(f, "face is not planar: vertices are up to {:.2} % of its size off the plane", deviation * 100.0)
            }
            Self::CrossesItself => f.write_str("face crosses itself: its triangles do not add up to its area"),
            Self::HoleOrientation => f.write_str("hole is wound like its outer contour; treated as a hole"),
            Self::OutOfGamut => f.write_str("color is outside Rec.709: negative components clipped, luminance kept"),
            Self::ChannelAboveOne { sum } => {
                write!(
                    f,
                    "color makes the material return {sum:.3} times the light that it receives in one channel (its luminance is at most 1): \
                     limited to the received light"
                )
            }
            Self::NegativeSpectrum { count: 1 } => f.write_str("spectrum has a negative value: treated as 0"),
            Self::NegativeSpectrum { count } => write!(f, "spectrum has {count} negative values: treated as 0"),
            Self::NoLuminance { x, taken: [a, b] } => {
                write!(
                    f,
                    "chromaticity ({x}, 0) has no luminance: replaced by the nearest visible one, ({a:.4}, {b:.4})"
                )
            }
            Self::TooBright { material, sum } => {
                write!(
                    f,
                    "material `{material}` has rd + td + rs + ts = {sum:.3}: all four are scaled down to the sum 1"
                )
            }
            Self::NoTextureCoordinates { material } => {
                write!(
                    f,
                    "material `{material}` has a texture, but this surface has no texture coordinates (`uv`; reported once per material)"
                )
            }
            Self::OutsideFolder { path } => {
                write!(f, "`{path}` is outside the scene's folder: loading this scene always needs its root (`--root`)")
            }
            Self::ObjectReopened { name, first } => {
                write!(
                    f,
                    "object `{name}` is opened again, first at {first}: selectors, layers and Cryptomatte treat both as one object; rename one if \
                     they are different objects (reported once per name)"
                )
            }
            Self::LeftOpen { entity } => write!(f, "`{entity}` is never closed; it is closed at the end of its file"),
            Self::DefinitionReplaced { what } => write!(f, "{what} replaces an earlier one"),
            Self::NotTransformed { what } => write!(f, "{what} inside `xf`: it stays in world coordinates"),
            Self::Photometry { what } => f.write_str(what),
            Self::Texture { path, what } => write!(f, "`{path}`: {what}"),
            Self::DefaultCamera { standpoint, origin, target } => {
                let from = match standpoint {
                    Standpoint::Inside => "inside the closed room",
                    Standpoint::Outside => "outside",
                };
                let point = |[x, y, z]: &[f64; 3]| format!("{x:.3} {y:.3} {z:.3}");
                write!(
                    f,
                    "the scene has no camera: `default` looks from {from}, `origin {}`, `target {}`; define your own camera with \
                     `camera NAME =`, `origin x y z` and `target x y z` in the scene file",
                    point(origin),
                    point(target)
                )
            }
            Self::TooManyWarnings { kept } => write!(f, "more warnings follow; only the first {kept} are kept"),
        }
    }
}

/// Maximum number of warnings kept.
const MAX_WARNINGS: usize = 1000;

/// A bounded list of warnings.
#[derive(Debug, Default)]
pub(crate) struct Warnings(pub Vec<Warning>);

impl Warnings {
    pub fn push(&mut self, at: Position, kind: WarningKind) {
        match self.0.len() {
            n if n < MAX_WARNINGS => self.0.push(Warning { at, kind }),
            MAX_WARNINGS => self.0.push(Warning { at, kind: WarningKind::TooManyWarnings { kept: MAX_WARNINGS } }),
            _ => {}
        }
    }
}
