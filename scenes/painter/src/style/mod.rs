//! Styles, one file each.

pub mod cel;
pub mod hatching;
pub mod oil;
pub mod watercolor;
