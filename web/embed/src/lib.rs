//! The page as a part of the program: the files of `web/dist`, which are made from `web/src` and kept with it.
#![deny(missing_docs)]

/// Files by their paths within `web/dist`, like `index.html`; none, where that folder was not there when this was built.
pub const FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/files.rs"));
