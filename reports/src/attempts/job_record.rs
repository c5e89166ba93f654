//! Record that a farm keeps of a job, as a file in a sweep's folder.

use crate::ReportError;
use femc_service::attempts::JobRecord;
use std::fs;
use std::path::Path;

/// Writes a record to `path` atomically.
pub fn write(record: &JobRecord, path: &Path) -> Result<(), ReportError> {
    let text = serde_json::to_vec(record)?;
    Ok(femc_film::file::write_atomic(path, &text)?)
}

/// Reads all records in `folder`, sorted by run, earliest first.
pub fn read_all(folder: &Path) -> Result<Vec<JobRecord>, ReportError> {
    let entries = fs::read_dir(folder).map_err(ReportError::file(folder))?;
    let mut all = Vec::new();
    for entry in entries {
        let path = entry.map_err(ReportError::file(folder))?.path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let text = fs::read(&path).map_err(ReportError::file(&path))?;
            let record = serde_json::from_slice::<JobRecord>(&text);
            all.push(record.map_err(|cause| ReportError::Record { path, cause })?);
        }
    }
    all.sort_by_key(|record| (record.run, record.job));
    Ok(all)
}
