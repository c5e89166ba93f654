//! Tests of painted light on synthetic images.

mod images;
mod painted;
mod search;
