//! The pipeline on small scenes.

mod statistics;
