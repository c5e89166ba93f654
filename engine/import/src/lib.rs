//! Importer of scene files into scene descriptions.
//!
//! [`load_scene`] reads MGFE (MGF 1.1 with cameras, media, textures and animation) and the LM-63 luminaires and images that it
//! names, from a folder ([`DiskFolder`]) or from memory ([`Bundle`]). Errors carry file, line and column. Nothing that the format
//! defines is skipped silently. The result is a pure function of the files: it depends on no clock, no hash table order and no
//! threads.
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
pub use error::{EntityKind, ImportError, ImportErrors, ImportFault, Position};
pub use files::{DiskFolder, FileSource};
pub use scene_path::ScenePath;
pub use warning::{Warning, WarningKind};

use femc_scene::Scene;
use std::path::Path;

/// An imported scene.
#[derive(Clone, Debug)]
pub struct LoadedScene {
    /// Scene description.
    pub scene: Scene,
    /// Warnings in order of discovery; at most 1001.
    pub warnings: Vec<Warning>,
    /// Notes: remarks that are not warnings.
    pub notes: Vec<Warning>,
    /// All files that were read, each once, in order of first use.
    pub files: Vec<String>,
}

/// Maximum number of errors that [`load_scene_or_all_errors`] lists.
pub const MAX_ERRORS: usize = 100;

/// Imports the scene file `entry` of `files`. Other files are found relative to the files that name them. The import stops at the
/// first error.
pub fn load_scene(files: &dyn FileSource, entry: &str) -> Result<LoadedScene, ImportError> {
    format::mgf::load(files, entry, 1).map_err(|mut failed| failed.errors.swap_remove(0))
}

/// Imports like [`load_scene`], but continues after an error and lists up to [`MAX_ERRORS`] errors. Errors that may follow from an
/// earlier one are omitted.
pub fn load_scene_or_all_errors(files: &dyn FileSource, entry: &str) -> Result<LoadedScene, ImportErrors> {
    format::mgf::load(files, entry, MAX_ERRORS)
}

/// Imports the scene file at `path`. Its folder is the root, which no file name may leave.
pub fn load_scene_file(path: &Path) -> Result<LoadedScene, ImportError> {
    ScenePath::new(path)?.load()
}
