//! The request. Its values are parsed and in range (`values`). Everything that depends on the scene, such as the existing frames
//! and cameras, is resolved here.

mod job_file;
mod lamps;
mod metadata;
pub mod picture;
pub mod points_file;
mod resolved;

#[cfg(feature = "openjd")]
pub use job_file::{Axis, Change, SweepMode};
pub use job_file::{JobFile, Measures, typed_keys};
pub use lamps::{intensity_distribution, luminous_flux};
pub use metadata::FrameMetadata;
pub use resolved::{
    FramesChosen, ImportedScene, ResolvedRequest, is_job_file, load_scene, locate_scene, warning_line, with_root_prefix,
};
