//! Finite-element first pass: hierarchical radiosity with clusters and fog.
//!
//! [`solve`] splits surfaces (and the fog between them) into elements as finely as the light requires. It links elements that
//! exchange light, at the level where one link is exact enough, and iterates until the light no longer changes. The result is a
//! [`Field`](femc_field::Field): irradiance of surfaces and mean radiance in fog, without direct light from light sources, which
//! the solver takes from the sources themselves, not from elements.
//!
//! Units: radiosity and irradiance in lx by channel of linear Rec.709 (lm/m2; a Lambertian surface of radiosity B has luminance B /
//! pi cd/m2), lengths in m, prepared frame. Sources: \[hanrahan1991\] (links between levels), \[smits1994\] (clusters),
//! \[sillion1995\] (fog), \[bekaert1996\] (the error of a link from the values at its receiver's points).
//!
//! Links do not pass through mirrors and clear solids. Rays find the light of elements behind these, and particles bring the light of
//! lamps. Glossy reflection counts as diffuse. Light is passed on with isotropic phase functions; the field has the mean direction of
//! the light in fog.
#![deny(missing_docs)]

mod arena;
pub mod bounds;
mod bytes;
mod caustics;
mod census;
mod element;
mod exits;
mod factor;
mod fog;
mod fog_factor;
mod form_factor;
mod gather;
mod lamps;
mod link;
mod mesh;
mod rays;
mod scene;
mod solve;
mod steps;
mod tables;
#[cfg(test)]
mod tests;
mod tuning;
mod verify;
mod view;
mod visibility;

pub use bytes::StepDecodeError;
pub use census::{Census, KindCounts};
pub use mesh::{Mesh, MeshContent, solution_meshes};
pub use rays::RayHits;
pub use solve::{Cancelled, GuideKind, Solution, SolveOptions, SolveReport, SolverState};
pub use steps::{CastingState, min_solve_bytes, solve};
pub use tuning::{RAY_ROUNDS, TARGET_RESIDUAL};
pub use verify::VerifyError;
pub use view::{Irradiance, LightTotals, SolutionView};
