//! What operators watch: counters, histograms, the page that Prometheus reads, and the small server that shows it.
//!
//! The page is Prometheus' text format 0.0.4, written by hand: most of what the farm exports is a look at its state at the
//! time of asking, for which a registry of objects would only be a second copy. What is left of a library is the format,
//! which is a page of code; `testing` has a reader of it that takes nothing else.
#![deny(missing_docs)]

mod count;
mod disk;
mod page;
mod process;
mod serve;
#[cfg(feature = "testing")]
pub mod testing;

pub use count::{Counter, Histogram, Seconds, Tally};
pub use disk::free;
pub use page::{Family, Histograms, Page};
pub use process::process;
pub use serve::{Health, Report, serve};
