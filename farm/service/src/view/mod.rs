//! What there is, as JSON: one form for the command line's `--json`, for pages and for other people's programs. Names are in snake
//! case, states and kinds in lower case, times in seconds; what is not there is null.

mod job;
mod spec;
mod words;
mod worker;

pub use job::{JobJson, state, unit, wait};
pub use spec::SpecJson;
pub use words::count;
pub use worker::{WorkerJson, intake};
