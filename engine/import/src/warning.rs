//! What is odd about a scene file but does not stop its import.

use crate::Position;
use femc_scene::Standpoint;
use std::{borrow::Cow, fmt};

/// Something odd at some place. Displays as `file:line:column: what`.
#[derive(Clone, Debug, PartialEq)]
pub struct Warning {
    /// File, line and column of the oddity.
    pub at: Position,
    /// What is odd there.
    pub oddity: Oddity,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.at, self.oddity)
    }
}

/// What is odd.
#[derive(Clone, Debug, PartialEq)]
pub enum Oddity {
    /// An entity that the format does not know; said once per name.
    UnknownEntity {
        /// Its name.
        name: String,
    },
    /// A face without area.
    NoArea,
    /// A face that is not planar.
    NotPlanar {
        /// Largest distance from the best plane over the size of the face.
        deviation: f64,
    },
    /// A face whose triangles do not add up to it: it crosses itself.
    CrossesItself,
    /// A hole wound like the contour around it.
    HoleOrientation,
    /// A chromaticity outside Rec.709, clipped.
    OutOfGamut,
    /// A color that makes a material ask for more light of a channel than it receives; the renderer limits it.
    ChannelAboveOne {
        /// Largest share of the light that a channel asks for.
        sum: f64,
    },
    /// Negative values in a spectrum.
    NegativeSpectrum {
        /// How many.
        count: usize,
    },
    /// A chromaticity with y = 0, which no light has.
    NoLuminance {
        /// CIE x as written.
        x: f64,
        /// CIE x and y that are used.
        taken: [f64; 2],
    },
    /// A material that reflects more than it receives, scaled down to 1.
    TooBright {
        /// The material.
        material: String,
        /// The sum of its reflectances and transmittances in the file.
        sum: f64,
    },
    /// A file that is outside the scene's folder, where the root covers it; said once per file.
    OutsideFolder {
        /// Its path below the root.
        path: String,
    },
    /// An object opened again in another place; said once per name.
    ObjectAgain {
        /// Its full name.
        name: String,
        /// Place of its first opening.
        first: Position,
    },
    /// `o` or `xf` still open at the end of the file that opened it; closed there.
    LeftOpen {
        /// `o` or `xf`.
        entity: &'static str,
    },
    /// A definition replaced by a later one.
    Replaced {
        /// What, `camera main`.
        what: String,
    },
    /// A transform around something that is always in world coordinates.
    NotTransformed {
        /// Kind of element that ignores the transform.
        what: &'static str,
    },
    /// Photometric data outside the letter of LM-63 that has a clear meaning.
    Photometry {
        /// What was found and what was made of it.
        what: Cow<'static, str>,
    },
    /// A textured material on a surface without texture coordinates; said once per material.
    NoTextureCoordinates {
        /// The material.
        material: String,
    },
    /// A statement of an image file that is not used, or values outside of their domain; said once per file.
    Texture {
        /// The file.
        path: String,
        /// What was found and what was made of it.
        what: String,
    },
    /// A scene without a camera was given one.
    DefaultCamera {
        /// Where it stands.
        standpoint: Standpoint,
        /// Its eye, m.
        origin: [f64; 3],
        /// The point that it looks at, m.
        target: [f64; 3],
    },
    /// More warnings than are kept.
    More {
        /// How many are kept.
        kept: usize,
    },
}

impl Oddity {
    /// The kind of oddity, `unknown-entity`.
    pub fn kind(&self) -> &'static str {
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
            Self::ObjectAgain { .. } => "object-again",
            Self::LeftOpen { .. } => "left-open",
            Self::Replaced { .. } => "duplicate-name",
            Self::NotTransformed { .. } => "not-transformed",
            Self::Photometry { .. } => "photometry",
            Self::NoTextureCoordinates { .. } => "no-texture-coordinates",
            Self::Texture { .. } => "texture",
            Self::DefaultCamera { .. } => "default-camera",
            Self::More { .. } => "incomplete",
        }
    }
}

impl fmt::Display for Oddity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownEntity { name } => write!(f, "unknown entity `{name}` skipped (said once per name)"),
            Self::NoArea => f.write_str("face without area"),
            Self::NotPlanar { deviation } => {
                write!(f, "face is not planar: vertices are up to {:.2} % of its size off the plane", deviation * 100.0)
            }
            Self::CrossesItself => f.write_str("face crosses itself: its triangles do not add up to its area"),
            Self::HoleOrientation => f.write_str("hole is wound like its outer contour; taken as a hole"),
            Self::OutOfGamut => f.write_str("color is outside Rec.709: negative components clipped, luminance kept"),
            Self::ChannelAboveOne { sum } => {
                write!(
                    f,
                    "color makes the material ask for {sum:.3} times the light of one channel (its luminance is within 1): \
                     limited to what it receives"
                )
            }
            Self::NegativeSpectrum { count: 1 } => f.write_str("spectrum has a negative value: taken as 0"),
            Self::NegativeSpectrum { count } => write!(f, "spectrum has {count} negative values: taken as 0"),
            Self::NoLuminance { x, taken: [a, b] } => {
                write!(f, "chromaticity ({x}, 0) has no luminance: the nearest visible one is taken, ({a:.4}, {b:.4})")
            }
            Self::TooBright { material, sum } => {
                write!(f, "material `{material}` has rd + td + rs + ts = {sum:.3}: all four scaled down to the sum 1")
            }
            Self::NoTextureCoordinates { material } => {
                write!(
                    f,
                    "material `{material}` has a texture, and this surface no coordinates (`uv`; said once per material)"
                )
            }
            Self::OutsideFolder { path } => {
                write!(
                    f,
                    "`{path}` is outside the scene's folder: this scene needs its root (`--root`) wherever it goes"
                )
            }
            Self::ObjectAgain { name, first } => {
                write!(
                    f,
                    "object `{name}` is opened again, first at {first}: both are one object to selectors, layers and Cryptomatte; rename \
                     one if they are two things (said once per name)"
                )
            }
            Self::LeftOpen { entity } => write!(f, "`{entity}` is never closed; closed at the end of its file"),
            Self::Replaced { what } => write!(f, "{what} replaces an earlier one"),
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
                    "the scene has no camera: `default` looks from {from}, `origin {}`, `target {}`; place another with \
                     `camera NAME =`, `origin x y z` and `target x y z` in the scene file",
                    point(origin),
                    point(target)
                )
            }
            Self::More { kept } => write!(f, "more warnings follow; only the first {kept} are kept"),
        }
    }
}

/// How many warnings are kept.
const KEPT: usize = 1000;

/// A bounded list of warnings.
#[derive(Debug, Default)]
pub(crate) struct Warnings(pub Vec<Warning>);

impl Warnings {
    pub fn push(&mut self, at: Position, oddity: Oddity) {
        match self.0.len() {
            n if n < KEPT => self.0.push(Warning { at, oddity }),
            KEPT => self.0.push(Warning { at, oddity: Oddity::More { kept: KEPT } }),
            _ => {}
        }
    }
}
