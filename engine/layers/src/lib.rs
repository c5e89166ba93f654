//! Light path expressions: which paths of light make a layer of a render; and features, layers of what the camera sees first.
//!
//! An [`Expression`] is a regular expression over the events of a path from the camera to a source, in the grammar of Open Shading
//! Language. All expressions of a frame are compiled to one deterministic, minimal [`Automaton`]: a path carries one state, whatever
//! the number of layers, and where light is found the state says which layers it counts in. The price is a table that may grow with the
//! product of the expressions; what would take more than 65,535 states is refused.
//!
//! The crate knows neither scenes nor rays: objects, media and lamps are sets of labels to it ([`LabelSet`]).
#![deny(missing_docs)]

mod automaton;
pub mod cryptomatte;
mod darkness;
mod dialect;
mod error;
mod event;
mod expression;
mod feature;
mod layer;
mod preset;

pub use automaton::{Automaton, DEAD, Labels, NO_LAYERS, State, Symbol, Takers};
pub use darkness::{Darkness, darkness};
pub use error::{ExpressionError, LayerError};
pub use event::{Event, Kind, LabelSet, Vocabulary, spelled};
pub use expression::{Expression, Node};
pub use feature::Feature;
pub use layer::{Layer, MOST_LAYERS, parse_all};
pub use preset::Preset;
