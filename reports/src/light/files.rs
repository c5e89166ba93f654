//! Files of light statistics: of one frame, or of several merged frames.

use crate::ReportError;
use femc_pipeline::paths::{Frames, Statistics};
use std::path::{Path, PathBuf};

/// Input of a query: one frame, or merged frames.
#[derive(Debug)]
pub struct Unit {
    /// Name of the file; for a union, its first and last file.
    pub file: String,
    /// Frames in the order of seed and number; not empty.
    pub frames: Vec<Statistics>,
}

/// Reads the statistics in a file.
pub fn read(file: &Path) -> Result<Unit, ReportError> {
    let bytes = std::fs::read(file).map_err(ReportError::named(file))?;
    let frames = if Frames::is_meant(&bytes) {
        Frames::decode(&bytes).map(Frames::into_frames)
    } else {
        Statistics::decode(&bytes).map(|frame| vec![frame])
    };
    let frames = frames.map_err(|cause| ReportError::Statistics { path: file.to_owned(), cause })?;
    if frames.is_empty() {
        return Err(ReportError::NoFrame(file.to_owned()));
    }
    Ok(Unit { file: file.display().to_string(), frames })
}

/// Reads files, and all files in folders, sorted by name.
pub fn units(paths: &[PathBuf]) -> Result<Vec<Unit>, ReportError> {
    let mut units = Vec::new();
    for path in paths {
        if !path.is_dir() {
            units.push(read(path)?);
            continue;
        }
        let entries: Vec<PathBuf> = path
            .read_dir()
            .and_then(|all| all.map(|entry| Ok(entry?.path())).collect())
            .map_err(ReportError::named(path))?;
        let mut files: Vec<PathBuf> =
            entries.into_iter().filter(|file| file.extension().is_some_and(|it| it == "paths")).collect();
        if files.is_empty() {
            return Err(ReportError::NoStatistics(path.clone()));
        }
        files.sort();
        for file in &files {
            units.push(read(file)?);
        }
    }
    Ok(units)
}

/// Merges the frames of all files.
pub fn united(units: Vec<Unit>) -> Result<Unit, ReportError> {
    let mut frames = Frames::default();
    let file = match &units[..] {
        [one] => one.file.clone(),
        [one, .., last] => format!("{} to {}", one.file, last.file),
        [] => String::new(),
    };
    let all = units.iter().flat_map(|unit| unit.frames.iter().cloned());
    if frames.unite(all).is_err() {
        // Find the file that does not fit.
        let mut fitting = Frames::default();
        for unit in units {
            fitting.unite(unit.frames).map_err(|cause| ReportError::Union { file: unit.file, cause })?;
        }
    }
    Ok(Unit { file, frames: frames.into_frames() })
}

/// Writes a union. Returns the number of recorded paths and the bytes of the file.
pub fn write(out: &Path, unit: &Unit) -> Result<(usize, usize), ReportError> {
    let frames = Frames::of(unit.frames.iter().cloned());
    let frames = frames.map_err(|cause| ReportError::NoUnion { file: unit.file.clone(), cause })?;
    let (bytes, paths) = (frames.encode(), frames.frames().map(|all| all.paths.len()).sum::<usize>());
    femc_film::file::write_atomic(out, &bytes)?;
    Ok((paths, bytes.len()))
}
