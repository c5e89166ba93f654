//! Scenes: the format-independent description, its selectors, its animation and its faults.
//!
//! An importer fills a [`Scene`]; nothing in it depends on the file format. Lengths are in meters, times in seconds. Angles are in
//! degrees where a field says so, and in radians elsewhere. All numbers are f64 until a frame is prepared.
#![deny(missing_docs)]

pub mod animation;
mod brightness;
mod caustic_flux;
pub mod check;
mod default_camera;
pub mod description;
pub mod digest;
pub mod frame_key;
pub mod objects;
pub mod required_features;
pub mod selector;
pub mod survey;
mod world;

pub use caustic_flux::{CausticFlux, estimate_caustic_flux};
pub use check::{FaultKind, SceneFault, Severity, check_scene, lamps_without_light};
pub use default_camera::{Standpoint, default_camera};
pub use description::*;
pub use digest::{DigestError, SceneDigest};
pub use frame_key::{FrameKey, StaticDigest};
pub use required_features::{Feature, RequiredFeatures, UnusedFeature};
pub use selector::{Constraint, Scalars, SelectorError};
pub use survey::{LampGroup, LampKind, Survey, survey_scene};
