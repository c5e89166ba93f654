//! Values as they are typed, on the command line or in a file: parsed and in range.

mod duration;
mod exposure;
mod frames;
mod hours;
mod overrides;
mod place;
mod size;
mod style;
mod task;
mod volume;

pub use duration::Budget;
pub use exposure::{Exposure, ev};
pub use frames::Frames;
pub use hours::Hours;
pub use overrides::Override;
pub use place::Place;
pub use size::Size;
pub use style::{Style, guide_frame};
pub use task::{JobTasks, Tasks};
pub use volume::{Volume, VolumeError};
