//! Light statistics of frames, as `femc render --stats` writes them: files, bottlenecks, tables of paths.

pub mod bottleneck_table;
mod bottlenecks;
mod files;
pub mod path_table;

pub use bottlenecks::{Finding, FireflyRow, LampRow, Order, Report, Row};
pub use files::{Unit, read, united, units, write};
