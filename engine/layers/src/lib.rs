//! Light path expressions, which select the light paths of a layer of a render, and features, which are layers of first-hit
//! properties.
//!
//! An [`Expression`] is a regular expression over the events of a path from the camera to a source, in the grammar of Open Shading
//! Language. All expressions of a frame are compiled to one deterministic, minimal [`Automaton`]. A path carries a single state,
//! whatever the number of layers. When the path finds light, the state determines the layers that receive it. The price is a table
//! that may grow with the product of the expressions; layers that need more than 65,535 states are refused.
//!
//! The crate does not depend on scenes or rays: objects, media and lamps are sets of labels here ([`LabelSet`]).
#![deny(missing_docs)]

mod automaton;
pub mod cryptomatte;
mod dialect;
mod error;
mod event;
mod expression;
mod feature;
mod layer;
mod preset;
mod unlit;

pub use automaton::{Automaton, DEAD_STATE, LabelOffset, LayerSetIndex, NO_LAYERS, State, Symbol};
pub use error::{ExpressionError, LayerError};
pub use event::{EventKind, EventPattern, LabelSet, Vocabulary, format_kinds};
pub use expression::{Expression, Node};
pub use feature::Feature;
pub use layer::{Layer, MAX_LAYERS, parse_layers};
pub use preset::Preset;
pub use unlit::{UnlitReason, unlit_reason};
