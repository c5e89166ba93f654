//! Scene files to scene descriptions.
//!
//! [`load`] reads MGFE (MGF 1.1 with cameras, media, textures and animation) and the LM-63 luminaires and images that it
//! names, from a folder ([`Disk`]) or from memory ([`Bundle`]). Faults carry file, line and column; nothing that the format
//! defines is skipped silently. Everything is a pure function of the files: no clock, no order of hash tables, no threads.
#![deny(missing_docs)]

mod bundle;
mod error;
mod files;
mod format;
mod image;
mod scene_path;
mod text;
mod warning;

pub use bundle::{Bundle, BundleError};
pub use error::{Fault, ImportError, ImportErrors, Kind, Position};
pub use files::{Disk, Files};
pub use scene_path::ScenePath;
pub use warning::{Oddity, Warning};

use femc_scene::Scene;
use std::path::Path;

/// An imported scene.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The description.
    pub scene: Scene,
    /// What is odd about it, in the order of discovery; at most 1001.
    pub warnings: Vec<Warning>,
    /// What is worth knowing and not odd.
    pub notes: Vec<Warning>,
    /// Every file that was read, each once, in order of first use.
    pub files: Vec<String>,
}

/// Most errors that [`load_or_list`] lists.
pub const MAX_ERRORS: usize = 100;

/// Imports the scene file `entry` of `files`; other files are found relative to the files that name them. The import ends at
/// the first error.
pub fn load(files: &dyn Files, entry: &str) -> Result<Loaded, ImportError> {
    format::mgf::load(files, entry, 1).map_err(|mut failed| failed.errors.swap_remove(0))
}

/// Imports like [`load`], but reads on after an error and lists up to [`MAX_ERRORS`] of them. Errors that may follow from an
/// earlier one are left out.
pub fn load_or_list(files: &dyn Files, entry: &str) -> Result<Loaded, ImportErrors> {
    format::mgf::load(files, entry, MAX_ERRORS)
}

/// Imports the scene file at `path`; its folder is the root that nothing may leave.
pub fn load_path(path: &Path) -> Result<Loaded, ImportError> {
    ScenePath::new(path)?.load()
}
