//! Radiance field: the light found by the first pass, evaluated by point.
//!
//! A [`Surface`] is one side of a triangle, of a parallelogram or of a curved shape, with two parameters over it. Its [`Cell`]s are
//! a binary tree over the parameters. A leaf has the irradiance from other surfaces and from fog, linear over the leaf, or, if the
//! leaf is too curved for one normal, by direction ([`Harmonics`]). In fog, the leaves of a tree of boxes have the mean radiance
//! from all directions ([`FogTree`]). With the fog's coefficients, they give the light sent along a [`FogLine`]. A
//! [`TargetGuide`] tells paths toward which parts of the scene to sample directions. Direct light from light sources is not in
//! the field: the caller computes it from the sources. [`Field::encode`] converts the field to bytes that a farm can store and
//! send.
#![deny(missing_docs)]

mod cell;
mod codec;
mod field;
mod fog;
mod harmonics;
mod regions;
mod surface;
mod tables;
mod targets;
mod walk;

pub use cell::{Cell, Outline, Split};
pub use codec::{FieldError, SolveStatistics};
pub use field::{Field, Leaf};
pub use fog::{FogCell, FogLeaf, FogLine, FogLinePoint, FogTree};
pub use harmonics::Harmonics;
pub use surface::{Form, Side, Surface, SurfaceSpot};
pub use tables::{DirectionTable, DirectionTables, TABLE_CELLS, TableCells, TableExtent};
pub use targets::{
    Ball, GuidedTargets, PACK_TARGETS, Parallelogram, RegionTargets, Target, TargetDirections, TargetGuide, TargetPack,
};

/// "None" among `u32` indices.
pub const NONE: u32 = u32::MAX;
