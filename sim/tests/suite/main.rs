//! Tests of the simulation, and of the planted bugs that it must find.

mod plants;
mod seeds;
