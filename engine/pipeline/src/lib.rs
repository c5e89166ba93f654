//! Facade of the engine: settings, plans, prepared frames, and rendered tiles.
//!
//! A frame is split into tiles and its samples into rounds. A task renders one tile's samples of one round. The samples of a task
//! are a function of only the settings, so the frame does not depend on which worker renders which task, or when.
#![deny(missing_docs)]

mod allocation;
mod budget;
mod first_pass;
mod first_pass_steps;
mod in_process;
mod layers;
pub mod measure;
pub mod method_choice;
mod outputs;
mod path_splitting;
pub mod pilot;
mod plan;
mod preparation;
mod render;
pub mod replay;
mod round;
mod settings;
mod solver;
mod stage;
mod statistics;
pub mod variance_attribution;
pub mod variance_by_decision;

pub use allocation::{AllocationError, SampleAllocation};
pub use femc_field::{Field, FieldError, Form, Side, SolveStatistics as FirstPassStatistics};
pub use femc_gltf as gltf;
pub use femc_guiding::MAX_BYTES as MAX_LEARNING_BYTES;
pub use femc_guiding::document::{TargetDocument, TargetError, TargetKind, TargetRecord, TargetShape};
pub use femc_layers::{Feature, Layer, LayerError, Preset, cryptomatte};
pub use femc_prepared::{PrepareError, Prepared, SceneSource};
pub use femc_radiosity::{self as radiosity, Solution, SolveReport as FirstPassReport, StepDecodeError};
pub use femc_scene::FrameKey;
pub use first_pass::{
    FieldMismatch, FrameLight, attach_first_pass, attach_targets, encode_solution, first_pass_key, first_pass_world,
    learn_targets, solve_first_pass,
};
pub use first_pass_steps::{count_surfaces, first_pass_blocks, planned_first_pass_blocks, split_first_pass};
pub use in_process::{RenderedFrame, RoundEnd, render_frame, render_rounds};
pub use layers::{
    DarkLayer, FeaturePlan, LayerPlan, cryptomatte_collisions, dark_layers, feature_channels, feature_layout,
    feature_mattes, lamp_labels,
};
pub use outputs::Outputs;
pub use plan::{FIRST_PASS_FEATURE, OmittedFeature, Plan, PlanError, plan_job};
pub use preparation::{attach_learned_targets, frame_key, prepare_frame, prepare_pilot, prepare_world};
pub use render::{FilterAdapter, RenderError, RenderTask, RenderedTile};
/// Name of the engine build. Two programs with the same name compute the same bits for the same job (`build.rs` defines the name,
/// `tests/builds` compares).
pub const BUILD: &str = env!("FEMC_ENGINE");

pub use femc_paths as paths;
pub use round::{RoundVerdict, UNLIT_SPP};
pub use settings::{Method, Settings, SettingsError, StopCondition};
pub use solver::{BlockOutput, LinkedState, RayState, Solver, solver};
pub use stage::{
    job_graph, tiles_per_group, with_geometry, with_layers, with_measurement, with_solution, with_statistics,
};
pub use statistics::StatisticsPlan;
