use super::{Location, PathId};
use femc_math::{Transform, glam::DMat4};
use serde::{Deserialize, Serialize};

/// Time span of the clip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Clip {
    /// Start, s.
    pub start: f64,
    /// End, s.
    pub end: f64,
    /// Frames a second, > 0.
    pub fps: f64,
}

/// Interpolation of a path between its keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Interpolation {
    /// Linear translations, slerped rotations.
    Linear,
    /// Centripetal Catmull-Rom translations, slerped rotations.
    Spline,
}

/// A key of a path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// Time, s.
    pub time: f64,
    /// Pose at that time.
    pub pose: Transform,
}

/// A motion path; keys strictly ascending in time, at least one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionPath {
    /// Name.
    pub name: String,
    /// Location of the path's definition.
    pub location: Location,
    /// Interpolation between keys.
    pub interpolation: Interpolation,
    /// The keys.
    pub keys: Vec<Key>,
}

/// A transform that may change over time. The steps are applied to a point from first to last.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Steps, applied to a point in this order; empty = identity.
    pub steps: Vec<MotionStep>,
}

/// A step of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum MotionStep {
    /// A fixed transform.
    Static(Transform),
    /// The pose of a path.
    Along(PathId),
}

impl Motion {
    /// Returns a motion that never changes.
    pub fn fixed(transform: Transform) -> Self {
        if transform == Transform::IDENTITY {
            return Self::default();
        }
        Self { steps: vec![MotionStep::Static(transform)] }
    }

    /// Returns the transform of a motion that does not depend on time.
    pub fn as_static(&self) -> Option<Transform> {
        self.steps.iter().try_fold(Transform::IDENTITY, |done, step| match step {
            MotionStep::Static(t) => Some(*t * done),
            MotionStep::Along(_) => None,
        })
    }

    /// Returns the transform as a homogeneous matrix, for printing.
    pub fn static_matrix(&self) -> Option<DMat4> {
        self.as_static().map(DMat4::from)
    }
}

/// A scalar over time: linear between keys, constant before the first and after the last key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vary {
    /// Selector, such as `medium.fog.sigma_s`.
    pub selector: String,
    /// Location in the file.
    pub location: Location,
    /// (time in s, value), strictly ascending in time, at least one.
    pub keys: Vec<(f64, f64)>,
}
