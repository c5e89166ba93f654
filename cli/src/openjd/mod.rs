//! Open Job Description (<https://github.com/OpenJobDescription>): templates to sweeps and back; docs/openjd.md has the table
//! of what maps and what does not.
//!
//! A template becomes a sweep by what its tasks do, not by how it is written: the crate `openjd-model` reads it, checks it and
//! goes through its parameter space, every task's command line is read as `femc render` reads its own, and settings that differ
//! from task to task become axes. So products, associations, expressions and chunks need no rules of their own here. It costs
//! that a template of another program's command lines is refused.

mod export;
mod import;
mod place;
mod spots;
mod template;
#[cfg(test)]
mod tests;
mod written;

pub use export::{FramesOf, export};
pub use import::import;
pub use template::{Template, TemplateError};
