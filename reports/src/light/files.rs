//! Files of light statistics: of one frame, or of several merged frames.

use crate::ReportError;
use femc_pipeline::paths::{FrameStatistics, LightStatistics};
use std::path::{Path, PathBuf};

/// Input of a query: one frame, or merged frames.
#[derive(Debug)]
pub struct FrameSet {
    /// Name of the file; for a union, its first and last file.
    pub file: String,
    /// Frames in the order of seed and number; not empty.
    pub frames: Vec<LightStatistics>,
}

/// Reads the statistics in a file.
pub fn read(file: &Path) -> Result<FrameSet, ReportError> {
    let bytes = std::fs::read(file).map_err(ReportError::input(file))?;
    let frames = if FrameStatistics::has_magic(&bytes) {
        FrameStatistics::decode(&bytes).map(FrameStatistics::into_frames)
    } else {
        LightStatistics::decode(&bytes).map(|frame| vec![frame])
    };
    let frames = frames.map_err(|cause| ReportError::Statistics { path: file.to_owned(), cause })?;
    if frames.is_empty() {
        return Err(ReportError::NoFrame(file.to_owned()));
    }
    Ok(FrameSet { file: file.display().to_string(), frames })
}

/// Reads files, and all files in folders, sorted by name.
pub fn read_all(paths: &[PathBuf]) -> Result<Vec<FrameSet>, ReportError> {
    let mut sets = Vec::new();
    for path in paths {
        if !path.is_dir() {
            sets.push(read(path)?);
            continue;
        }
        let entries: Vec<PathBuf> = path
            .read_dir()
            .and_then(|all| all.map(|entry| Ok(entry?.path())).collect())
            .map_err(ReportError::input(path))?;
        let mut files: Vec<PathBuf> =
            entries.into_iter().filter(|file| file.extension().is_some_and(|it| it == "paths")).collect();
        if files.is_empty() {
            return Err(ReportError::NoStatistics(path.clone()));
        }
        files.sort();
        for file in &files {
            sets.push(read(file)?);
        }
    }
    Ok(sets)
}

/// Merges the frames of all files.
pub fn merge(sets: Vec<FrameSet>) -> Result<FrameSet, ReportError> {
    let mut frames = FrameStatistics::default();
    let file = match &sets[..] {
        [one] => one.file.clone(),
        [one, .., last] => format!("{} to {}", one.file, last.file),
        [] => String::new(),
    };
    let all = sets.iter().flat_map(|unit| unit.frames.iter().cloned());
    if frames.merge(all).is_err() {
        // Find the file that does not fit.
        let mut fitting = FrameStatistics::default();
        for set in sets {
            fitting.merge(set.frames).map_err(|cause| ReportError::MergeConflict { file: set.file, cause })?;
        }
    }
    Ok(FrameSet { file, frames: frames.into_frames() })
}

/// Writes a union. Returns the number of recorded paths and the bytes of the file.
pub fn write(out: &Path, set: &FrameSet) -> Result<(usize, usize), ReportError> {
    let frames = FrameStatistics::from_statistics(set.frames.iter().cloned());
    let frames = frames.map_err(|cause| ReportError::MergedFrames { file: set.file.clone(), cause })?;
    let (bytes, paths) = (frames.encode(), frames.frames().map(|all| all.paths.len()).sum::<usize>());
    femc_film::file::write_atomic(out, &bytes)?;
    Ok((paths, bytes.len()))
}
