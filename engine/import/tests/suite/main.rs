//! Scenes read from text, a module a topic.

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
