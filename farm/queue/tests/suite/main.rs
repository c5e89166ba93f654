//! Tests of the log and its backends, one module per topic.

mod common;
mod conformance;
mod crash;
mod postgres;
