use super::{Location, PathId};
use femc_math::glam::DVec3;
use serde::{Deserialize, Serialize};

/// A thin-lens camera (pinhole when `lens_radius` is 0).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Name.
    pub name: String,
    /// Location of the camera's definition.
    pub location: Location,
    /// Eye, m.
    pub origin: DVec3,
    /// Point that the camera looks at, m.
    pub target: DVec3,
    /// Up direction; not parallel to the view.
    pub up: DVec3,
    /// Vertical full angle, degrees in (0, 180).
    pub fov: f64,
    /// Film width and height, pixels.
    pub film: [u32; 2],
    /// Lens radius, m; 0 = pinhole.
    pub lens_radius: f64,
    /// Distance of the focal plane from the eye along the view axis, m.
    pub focus: f64,
    /// Shutter opening, fraction of the frame interval.
    pub shutter_open: f64,
    /// Shutter closing, fraction of the frame interval, >= `shutter_open`.
    pub shutter_close: f64,
    /// Path that moves origin and target (and turns `up`).
    pub along: Option<PathId>,
}
