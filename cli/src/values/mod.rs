//! Values as they are typed, on the command line or in a file: parsed and in range.

mod byte_size;
mod duration;
mod exposure;
mod frames;
mod hours;
mod overrides;
mod size;
mod style;
mod task;
mod text_position;

pub use byte_size::{ByteSize, ByteSizeError};
pub use duration::DurationArg;
pub use exposure::{Exposure, ev};
pub use frames::Frames;
pub use hours::Hours;
pub use overrides::Override;
pub use size::Size;
pub use style::{PaintingStyle, guide_frame};
pub use task::{JobTaskSelector, TaskSelector};
pub use text_position::TextPosition;
