//! Temporary files of unfinished uploads in a folder. They are not listed as artifacts.

use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fs, io};

use femc_model::Digest;

/// A file of an upload, with its size in bytes.
pub(crate) type UploadFile = (PathBuf, u64);

/// Returns the upload files below `root` that have not changed for `idle`.
pub(crate) fn upload_files(root: &Path, idle: Duration) -> io::Result<Vec<UploadFile>> {
    let mut all = Vec::new();
    for folder in fs::read_dir(root)? {
        let folder = folder?;
        if !folder.file_type()?.is_dir() {
            continue;
        }
        for file in fs::read_dir(folder.path())? {
            let file = file?;
            if !is_upload_file(&folder.file_name().to_string_lossy(), &file.file_name().to_string_lossy()) {
                continue;
            }
            // A file that has been renamed or removed meanwhile is skipped.
            let Ok(data) = file.metadata() else { continue };
            if data.modified().is_ok_and(|time| time.elapsed().is_ok_and(|age| age >= idle)) {
                all.push((file.path(), data.len()));
            }
        }
    }
    Ok(all)
}

/// Removes a file; a missing file is not an error.
pub(crate) fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        Ok(()) | Err(_) => Ok(()),
    }
}

/// Checks for an upload file: `object_store` writes `ab/cdef...#1` and renames it at the end.
fn is_upload_file(folder: &str, file: &str) -> bool {
    let Some((name, number)) = file.split_once('#') else { return false };
    format!("{folder}{name}").parse::<Digest>().is_ok() && number.parse::<u64>().is_ok()
}
