//! Files of light statistics: of a frame, or of several that are united.

use crate::exit::{Exit, Failure, failed, usage};
use crate::output::Say;
use femc_pipeline::paths::{Frames, PathsError, Statistics};
use std::path::{Path, PathBuf};

/// What is asked as one: a frame, or frames that are united.
#[derive(Debug)]
pub struct Unit {
    /// The file; of a union all of them.
    pub file: String,
    /// In order of seed and number; not empty.
    pub frames: Vec<Statistics>,
}

/// The statistics in a file.
pub fn read(file: &Path) -> Result<Unit, Failure> {
    let bytes = std::fs::read(file).map_err(|error| usage(format!("{}: {error}", file.display())))?;
    let frames = if Frames::is_meant(&bytes) {
        Frames::decode(&bytes).map(Frames::into_frames)
    } else {
        Statistics::decode(&bytes).map(|frame| vec![frame])
    };
    let say = |error: PathsError| failed(format!("{}: {error}", file.display()));
    let frames = frames.map_err(say)?;
    if frames.is_empty() {
        return Err(failed(format!("{}: no frame is in it", file.display())));
    }
    Ok(Unit { file: file.display().to_string(), frames })
}

/// The files, and of folders the files in them by their names.
pub fn units(paths: &[PathBuf]) -> Result<Vec<Unit>, Failure> {
    let mut units = Vec::new();
    for path in paths {
        if !path.is_dir() {
            units.push(read(path)?);
            continue;
        }
        let say = |error: std::io::Error| usage(format!("{}: {error}", path.display()));
        let entries: Vec<PathBuf> =
            path.read_dir().and_then(|all| all.map(|entry| Ok(entry?.path())).collect()).map_err(say)?;
        let mut files: Vec<PathBuf> =
            entries.into_iter().filter(|file| file.extension().is_some_and(|it| it == "paths")).collect();
        if files.is_empty() {
            let path = path.display();
            return Err(usage(format!(
                "{path}: no .paths file is in it; `femc render --stats` writes them beside frames"
            )));
        }
        files.sort();
        for file in &files {
            units.push(read(file)?);
        }
    }
    Ok(units)
}

/// The frames of all files as one.
pub fn united(units: Vec<Unit>) -> Result<Unit, Failure> {
    let mut frames = Frames::default();
    let file = match &units[..] {
        [one] => one.file.clone(),
        [one, .., last] => format!("{} to {}", one.file, last.file),
        [] => String::new(),
    };
    let say = |file: &str, error| {
        usage(format!("{file}: {error}; only frames of one job have a union, and a frame has one content in it"))
    };
    let all = units.iter().flat_map(|unit| unit.frames.iter().cloned());
    if frames.unite(all).is_err() {
        // Which of them does not fit.
        let mut fitting = Frames::default();
        for unit in units {
            fitting.unite(unit.frames).map_err(|error| say(&unit.file, error))?;
        }
    }
    Ok(Unit { file, frames: frames.into_frames() })
}

/// Writes a union.
pub fn write(out: &Path, unit: &Unit, say: Say) -> Result<Exit, Failure> {
    let frames = Frames::of(unit.frames.iter().cloned()).map_err(|error| failed(format!("{}: {error}", unit.file)))?;
    let (bytes, paths) = (frames.encode(), frames.frames().map(|all| all.paths.len()).sum::<usize>());
    femc_film::file::write_atomic(out, &bytes).map_err(failed)?;
    say.note(format!("{}: {} frames, {paths} paths, {} bytes", out.display(), unit.frames.len(), bytes.len()));
    Ok(Exit::Done)
}
