//! Tests of the painter and of its committed pictures.

mod sight;
mod styles;
