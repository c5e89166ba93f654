//! The request: what the user meant. Values are parsed and in range here; what depends on the scene
//! (which frames there are, which cameras) is resolved when the scene is known.

mod asked;
mod duration;
mod exposure;
mod frames;
mod hours;
mod job_file;
mod overrides;
mod size;
mod stated;
mod task;
mod volume;

pub use asked::{Asked, Base, FramesChosen, is_job, load, shown};
pub use duration::Budget;
pub use exposure::{Exposure, ev};
pub use frames::Frames;
pub use hours::Hours;
#[cfg(feature = "openjd")]
pub use job_file::{Axis, Change, Mode};
pub use job_file::{JobFile, Measures, Place, typed_keys};
pub use overrides::Override;
pub use size::Size;
pub use stated::Stated;
pub use task::{JobTasks, Tasks};
pub use volume::{Volume, VolumeError};
