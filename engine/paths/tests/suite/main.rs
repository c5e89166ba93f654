//! Tests of the invariants of light statistics, on synthetic paths that are a function of only their keys, like those of a
//! renderer.

mod bottlenecks;
mod codec;
mod conditions;
mod frames;
mod invariants;
mod plants;
mod queries;
mod recorded_counts;
mod representatives;
mod scales;
mod selection;
mod summary;
mod synthetic;
