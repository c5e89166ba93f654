//! `femc/v1/femc.proto` as a public interface: documented, by the rules, and compatible with what it was.

mod elements;
mod rules;
mod wire;
