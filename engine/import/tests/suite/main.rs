//! Scenes read from text, a module a topic.

mod broken;
mod common;
mod contexts;
mod geometry;
mod never_panics;
mod photometry;
mod real_scenes;
