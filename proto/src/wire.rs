//! Written by `cargo run -p femc-generate` from `femc/v1/femc.proto`, and kept.
#![allow(
    missing_docs,
    unused_qualifications,
    rust_2018_idioms,
    clippy::all,
    clippy::semicolon_if_nothing_returned,
    reason = "generated"
)]

include!("generated/femc.v1.rs");

/// The file's descriptor set, for reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!("generated/descriptors.bin");
