//! Tests of scene descriptions, one module per topic.

mod animation;
mod check;
mod common;
mod default_camera;
mod digest;
mod frame_key;
mod light_paths;
mod required_features;
mod selector;
mod text;
