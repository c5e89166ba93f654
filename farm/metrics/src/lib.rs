//! Metrics for operators: counters, histograms and the page that Prometheus reads. `femc_proto::serve_metrics` serves it.
//!
//! The page has Prometheus' text format 0.0.4 and is written by hand. Most exported values are read from the farm's state when the
//! page is requested; a registry of metric objects would only hold a second copy of them. Without a registry, a library would
//! contribute only the format, which is one page of code. `testing` has a strict reader of the format.
#![deny(missing_docs)]

mod count;
mod disk;
mod health;
mod page;
mod process;
#[cfg(feature = "testing")]
pub mod testing;

pub use count::{Counter, Histogram, Seconds, Tally};
pub use disk::free_disk_bytes;
pub use health::{Health, ProcessReport};
pub use page::{Family, Histograms, Page};
pub use process::{process_start_time, write_process_metrics};
