//! Images to compare.

use crate::exit::{Failure, failed, usage};
use femc_film::{FilmError, Image, exr};
use std::path::Path;

/// Reads the image in a file.
pub fn read(path: &Path) -> Result<Image, Failure> {
    match exr::read(path) {
        Ok(file) => Ok(file.image),
        Err(FilmError::File { path, cause }) if cause.kind() == std::io::ErrorKind::NotFound => {
            Err(usage(format!("{}: no such file; give two EXR images", path.display())))
        }
        Err(e) => Err(failed(e)),
    }
}
