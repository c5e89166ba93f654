//! Tests of the path loop through its public interface.

mod analytic;
mod horizons;
mod receivers;
mod weights;
