//! Light statistics: records of paths, and counts over all samples, merged exactly.
//!
//! A renderer reports its samples. [`LightStatistics`] keeps integer counters of all samples and whole [`LightPath`]s of some:
//! those whose hash of (seed, frame, pixel, sample) is least. Which samples these are depends only on the set of all samples. So
//! parts of a frame are united in any order and grouping, and a part that arrives twice counts once. Everything else is a function
//! of the records: [`histogram`]s, exact over the samples that the hash chose, a small [`representative`](represent) set for plots,
//! and the energy of the scene in an [`octree`]. The founding documents are \[simons2016\] and the thesis on which it is based.
//!
//! [`RecordedPaths`] answers questions about the records of several frames. A [`selection`] has the records that fulfill a condition
//! ([`query`]): masks, the share of the light, densities over pixels, histograms and representatives.
//!
//! This crate does not render, does not read files and knows nothing about the farm.
#![deny(missing_docs)]

pub mod attribute;
pub mod bottlenecks;
pub mod codec;
pub mod frames;
pub mod histogram;
pub mod octree;
pub mod pixels;
pub mod query;
pub mod record;
pub mod recorded;
pub mod represent;
pub mod schema;
pub mod selection;
pub mod statistics;
pub mod summary;

pub use codec::PathsError;
pub use frames::FrameStatistics;
pub use record::{
    InteractionKind, Intersection, LightPath, LightRecord, LightTechnique, Name, NameEntry, NameKind, PathEnd, PathKey,
};
pub use recorded::RecordedPaths;
pub use statistics::{LightStatistics, MergeError, PortionKey, SampleCounters, Scope};
