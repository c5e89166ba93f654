//! Tests of `femc/v1/femc.proto` as a public interface: it is documented, follows the rules, and stays compatible.

mod elements;
mod rules;
mod wire;
