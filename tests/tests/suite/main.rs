//! Tests that need the whole engine, one module per topic.

mod analytic;
mod bad_samples;
mod brute;
mod cases;
mod crates;
mod first_pass;
mod fuzz;
mod honesty;
mod layers;
mod materials;
mod modules;
mod pairs;
mod parts;
mod plants;
mod proofs;
mod references;
mod solution_model;
mod stress;
mod techniques;
mod tinted_absorption;
mod two_passes;
mod variants;
