//! What there is, as JSON: one form for the command line's `--json`, for pages and for other people's programs. Names are in snake
//! case, states and kinds in lower case, times in seconds; what is not there is null.

mod job;
mod log;
mod spec;
mod table;
mod usage;
mod words;
mod worker;

pub use job::{JobJson, above_target, state, unit, wait, waits_for};
pub use log::LogJson;
pub use spec::{SpecJson, error_target};
pub use table::{FrameJson, TaskJson};
pub use usage::usage_columns;
pub use words::count;
pub use worker::{OfflineJson, WorkerJson, intake};
