//! Generated from `femc/v1/femc.proto`.
#![allow(
    missing_docs,
    unused_qualifications,
    rust_2018_idioms,
    clippy::all,
    clippy::semicolon_if_nothing_returned,
    reason = "generated"
)]

tonic::include_proto!("femc.v1");

/// The file's descriptor set, for reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
