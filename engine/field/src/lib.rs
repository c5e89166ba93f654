//! The radiance field: what the first pass knows of the light, asked by point.
//!
//! A [`Surface`] is one side of a triangle, of a parallelogram or of a curved shape, with two parameters over it. Its [`Cell`]s are a
//! binary tree over the parameters; a leaf has the irradiance that comes from other surfaces and from fog, linear over the leaf, or,
//! where a leaf is too curved for one normal, by direction ([`Harmonics`]). In fog the leaves of a tree of boxes have the same of
//! light from all around ([`FogTree`]), and with the fog's coefficients what it sends along a [`Line`]. [`Guide`]s say where a leaf's light comes from, for those who draw directions. What comes straight from light sources is not in the field: who asks knows the sources.
//! [`Field::encode`] makes bytes of it that a farm can keep and send.
#![deny(missing_docs)]

mod cell;
mod codec;
mod field;
mod fog;
mod guide;
mod harmonics;
mod surface;
mod walk;

pub use cell::{Cell, Outline, Split};
pub use codec::{FieldError, Statistics};
pub use field::{Field, Leaf};
pub use fog::{FogCell, FogLeaf, FogTree, Line, LinePoint};
pub use guide::{Block, Directions, Guide, Guided, Guides, HALF, LOBES, Lobe};
pub use harmonics::Harmonics;
pub use surface::{Form, Side, Surface, SurfaceSpot};

/// "None" among `u32` indices.
pub const NONE: u32 = u32::MAX;
