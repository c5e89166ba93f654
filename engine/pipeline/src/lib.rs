//! Facade of the engine: settings, plans, prepared frames, and rendered tiles.
//!
//! A frame is split into tiles and its samples into rounds. A task renders one tile's samples of one round. The samples of a task
//! are a function of only the settings, so the frame does not depend on which worker renders which task, or when.
#![deny(missing_docs)]

pub mod account;
mod allocation;
pub mod auto;
mod budget;
mod first_pass;
mod first_pass_steps;
mod in_process;
mod layers;
pub mod pilot;
mod plan;
mod render;
pub mod replay;
mod round;
mod settings;
mod stage;
mod statistics;

pub use allocation::{Allocation, AllocationError};
pub use femc_field::{Field, FieldError, Form, Side, Statistics as FirstPassStatistics};
pub use femc_layers::{Feature, Layer, LayerError, Preset, cryptomatte};
pub use femc_prepared::{PrepareError, Prepared, Source};
pub use femc_radiosity::{
    self as radiosity, Aimed, Damaged, Found, Report as FirstPassReport, Settled, Sights, Solution, Underway,
};
pub use femc_scene::FrameKey;
pub use first_pass::{OtherWorld, brightened, encode_solution, first_pass, first_pass_key, first_pass_world, light};
pub use first_pass_steps::{aim, begin, blocks_of, first_pass_blocks, in_blocks, settle, surfaces};
pub use in_process::{RenderedFrame, RoundEnd, by_rounds, render_frame};
pub use layers::{
    DarkLayer, FeaturePlan, LayerPlan, dark_layers, feature_channels, feature_layout, feature_mattes, lamp_labels,
    merged_names, render_beside, render_with_layers,
};
pub use plan::{FIRST_PASS, LeftOut, Plan, PlanError, plan};
pub use render::{Places, RenderError, RenderedTile, frame_key, prepare, prepare_world, render_tile};
/// Name of the engine build. Two programs with the same name compute the same bits for the same job (`build.rs` defines the name,
/// `tests/builds` compares).
pub const BUILD: &str = env!("FEMC_ENGINE");

pub use femc_paths as paths;
pub use round::{RoundVerdict, UNLIT_SPP};
pub use settings::{Method, Settings, SettingsError, Stop};
pub use stage::{Loop, Need, Reach, Role, Round, Scope, Stage, StageKind, fan, stages, with_layers, with_statistics};
pub use statistics::{StatisticsPlan, render_with_statistics};
