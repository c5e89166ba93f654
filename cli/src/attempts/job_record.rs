//! What a farm recorded of a job, as a sweep keeps it in its folder.

use crate::exit::{Failure, failed};
use femc_service::attempts::JobRecord;
use std::fs;
use std::path::Path;

/// As `path`, whole or not at all.
pub fn write(record: &JobRecord, path: &Path) -> Result<(), Failure> {
    let text = serde_json::to_vec(record).map_err(failed)?;
    femc_film::file::write_atomic(path, &text).map_err(failed)
}

/// All that were written into `folder`, the earliest run first.
pub fn read_all(folder: &Path) -> Result<Vec<JobRecord>, Failure> {
    let at = |path: &Path, error: &dyn std::fmt::Display| failed(format!("{}: {error}", path.display()));
    let entries = fs::read_dir(folder).map_err(|e| at(folder, &e))?;
    let mut all = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| at(folder, &e))?.path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let text = fs::read(&path).map_err(|e| at(&path, &e))?;
            all.push(serde_json::from_slice::<JobRecord>(&text).map_err(|e| at(&path, &e))?);
        }
    }
    all.sort_by_key(|record| (record.run, record.job));
    Ok(all)
}
