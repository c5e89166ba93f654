//! Workers beside a coordinator in one process, a module a topic.

mod availability;
mod cancel;
mod common;
mod farm;
mod fence;
mod scene;
