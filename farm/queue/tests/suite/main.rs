//! The log and its backends, a module a topic.

mod common;
mod conformance;
mod crash;
mod postgres;
