//! The facade of the engine: settings, what would run, frames made ready, tiles rendered.
//!
//! A frame is cut into tiles and its samples into rounds; a task renders one tile's samples of one round. Which samples a
//! task holds is a function of the settings alone, so the merged frame does not depend on who renders what, or when.
#![deny(missing_docs)]

mod plan;
mod render;
mod settings;

pub use femc_prepared::{PrepareError, Prepared, Source};
pub use femc_scene::Moment;
pub use plan::{LeftOut, Plan, PlanError, plan};
pub use render::{RenderError, RenderedTile, moment, prepare, render_tile};
pub use settings::{Method, RoundVerdict, Settings, SettingsError, Stop};
