//! File with the usage of a run's tasks.

use crate::exit::{Failure, failed, usage};
use femc_reports::attempts::{GroupBy, JobRecord, RowsAsJson, columns, csv, rows, write_parquet};
use femc_reports::pages;
use std::path::{Path, PathBuf};

/// A file for the usage, and its format.
#[derive(Debug)]
pub struct ReportFile {
    path: PathBuf,
    format: Format,
}

#[derive(Debug, Clone, Copy)]
enum Format {
    Page,
    Csv,
    Json,
    Parquet,
}

impl ReportFile {
    /// Chooses the format by the extension of the file name.
    pub fn from_path(path: &Path) -> Result<Self, Failure> {
        let format = match path.extension().and_then(|extension| extension.to_str()) {
            Some("html") => Format::Page,
            Some("csv") => Format::Csv,
            Some("json") => Format::Json,
            Some("parquet") => Format::Parquet,
            _ => return Err(usage(format!("--report {}: give FILE.html, .csv, .json or .parquet", path.display()))),
        };
        Ok(Self { path: path.to_owned(), format })
    }

    /// Writes the usage. Returns the file's name.
    pub fn write(&self, record: JobRecord) -> Result<String, Failure> {
        let records = vec![record];
        let (columns, rows) = (columns(GroupBy::Attempt), rows(&records, GroupBy::Attempt));
        let bytes = match self.format {
            Format::Page => pages::JobsReport { title: None, records }.html()?.into_bytes(),
            Format::Csv => (csv(&columns, &rows) + "\n").into_bytes(),
            Format::Json => serde_json::to_vec_pretty(&RowsAsJson(&columns, &rows)).map_err(failed)?,
            Format::Parquet => {
                write_parquet(&self.path, &columns, &rows)?;
                return Ok(self.path.display().to_string());
            }
        };
        femc_film::file::write_atomic(&self.path, &bytes).map_err(failed)?;
        Ok(self.path.display().to_string())
    }
}
