//! JSON of all objects of the farm. The command line's `--json`, the web page and other programs use the same form. Names are in
//! snake case, states and kinds in lower case, times in seconds; missing values are null.

mod job;
mod log;
mod spec;
mod table;
mod usage;
mod words;
mod worker;

pub use job::{JobJson, above_target, awaited_resource, describe_wait, frame_label, state_text};
pub use log::LogJson;
pub use spec::{SpecJson, error_target};
pub use table::{FrameJson, TaskJson};
pub use usage::usage_columns;
pub use words::counted_noun;
pub use worker::{OfflineJson, WorkerJson, intake_name};
