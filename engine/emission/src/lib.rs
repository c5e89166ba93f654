//! Light sources: sampling, densities, power, photometric files and the choice among many lights.
//!
//! Everything is in one common frame, with f32 in the interfaces and f64 inside wherever far, tiny or grazing lights need it. A
//! reference point may lie on a surface or in a medium, so no normal is needed. The crate does not depend on scenes. The caller
//! checks visibility.
#![deny(missing_docs)]
#![cfg_attr(
    test,
    allow(clippy::disallowed_methods, reason = "tests compute expected values independently of the engine")
)]

pub mod airlight;
pub mod emission;
pub mod light;
pub mod light_sampler;
pub mod photometry;
pub mod solid_angle;
pub mod tree;

pub use airlight::{Airlight, EquiangularSegment, SegmentMedium, SourceProfile};
pub use emission::{AngularProfile, Emission, EmittingSides};
pub use light::{DeltaKind, EmissionCone, Light, LightSample};
pub use light_sampler::{DirectionContext, LightSampleContext, LightSampler, LightWeights};
pub use photometry::{IntensityDistribution, PhotometryError, PhotometryKind};
pub use tree::{BsdfLobes, LightBounds, PointContext, SegmentContext};
