//! Scenes read from text, a module a topic.

mod broken;
mod common;
mod contexts;
mod geometry;
mod never_panics;
mod real_scenes;
