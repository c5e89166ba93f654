//! Tests of scenes read from text, one module per topic.

mod all_errors;
mod broken;
mod common;
mod contexts;
mod file_names;
mod geometry;
mod mixtures;
mod never_panics;
mod photometry;
mod real_scenes;
