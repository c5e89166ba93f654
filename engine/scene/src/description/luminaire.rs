use super::Location;
use serde::{Deserialize, Serialize};

/// Photometric coordinate system of LM-63.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PhotometryType {
    /// Type A: automotive; vertical axis of rotation, horizontal angle X, vertical angle Y.
    A,
    /// Type B: floodlights; horizontal axis of rotation.
    B,
    /// Type C: interior and road lighting; vertical angle from nadir, horizontal angle about the vertical axis.
    C,
}

/// Luminous opening, in the luminaire's own frame, meters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Opening {
    /// A point.
    Point,
    /// A box (flat if the height is 0): x along `length` (C0..C180), y along `width`.
    Box {
        /// Extent along y, m.
        width: f64,
        /// Extent along x, m.
        length: f64,
        /// Extent along z, m.
        height: f64,
    },
    /// A vertical cylinder or disc.
    Cylinder {
        /// Diameter, m.
        diameter: f64,
        /// Height, m; may be 0.
        height: f64,
    },
    /// A sphere.
    Sphere {
        /// Diameter, m.
        diameter: f64,
    },
}

/// A luminous intensity distribution. `candela` already includes the multipliers and ballast factors of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Photometry {
    /// Path as given in the scene file.
    pub path: String,
    /// Coordinate system of the angles.
    pub kind: PhotometryType,
    /// Vertical angles, degrees, strictly ascending.
    pub vertical: Vec<f64>,
    /// Horizontal angles, degrees, strictly ascending.
    pub horizontal: Vec<f64>,
    /// Luminous intensity, cd: `candela[h * vertical.len() + v]`.
    pub candela: Vec<f64>,
    /// The luminous opening.
    pub opening: Opening,
    /// Location where the scene first includes the file.
    pub location: Location,
}
