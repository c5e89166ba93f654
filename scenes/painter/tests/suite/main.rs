//! Tests of the painter and of its committed pictures.

mod render_view;
mod styles;
