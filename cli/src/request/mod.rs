//! The request. Its values are parsed and in range (`values`). Everything that depends on the scene, such as the existing frames
//! and cameras, is resolved here.

mod asked;
mod job_file;
mod lamps;
pub mod picture;
mod stated;

pub use asked::{Asked, Base, FramesChosen, is_job, line_of, load, locate, shown};
#[cfg(feature = "openjd")]
pub use job_file::{Axis, Change, Mode};
pub use job_file::{JobFile, Measures, typed_keys};
pub use lamps::{flux, table_of};
pub use stated::Stated;
