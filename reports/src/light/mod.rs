//! Light statistics of frames, as `femc render --stats` writes them: files, bottlenecks, tables of paths.

pub mod bottleneck_table;
mod bottlenecks;
mod files;
pub mod path_table;
pub mod summary;

pub use bottlenecks::{BottleneckReport, Finding, FireflyRow, LampRow, PartRow, SortKey};
pub use files::{FrameSet, merge, read, read_all, write};
