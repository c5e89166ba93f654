//! Tests of workers beside a coordinator in one process, one module per topic.

mod availability;
mod cancel;
mod common;
mod earlier;
mod farm;
mod fence;
mod plans;
mod scene;
