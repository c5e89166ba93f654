//! File with the usage of a run's tasks.

use crate::exit::{Failure, failed, usage};
use femc_reports::attempts::{By, JobRecord, Json, columns, csv, rows, write_parquet};
use femc_reports::pages;
use std::path::{Path, PathBuf};

/// A file for the usage, and its format.
#[derive(Debug)]
pub struct ReportFile {
    path: PathBuf,
    form: Form,
}

#[derive(Debug, Clone, Copy)]
enum Form {
    Page,
    Csv,
    Json,
    Parquet,
}

impl ReportFile {
    /// Chooses the format by the extension of the file name.
    pub fn to(path: &Path) -> Result<Self, Failure> {
        let form = match path.extension().and_then(|extension| extension.to_str()) {
            Some("html") => Form::Page,
            Some("csv") => Form::Csv,
            Some("json") => Form::Json,
            Some("parquet") => Form::Parquet,
            _ => return Err(usage(format!("--report {}: give FILE.html, .csv, .json or .parquet", path.display()))),
        };
        Ok(Self { path: path.to_owned(), form })
    }

    /// Writes the usage. Returns the file's name.
    pub fn write(&self, record: JobRecord) -> Result<String, Failure> {
        let records = vec![record];
        let (columns, rows) = (columns(By::Attempt), rows(&records, By::Attempt));
        let bytes = match self.form {
            Form::Page => pages::Report { title: None, records }.html()?.into_bytes(),
            Form::Csv => (csv(&columns, &rows) + "\n").into_bytes(),
            Form::Json => serde_json::to_vec_pretty(&Json(&columns, &rows)).map_err(failed)?,
            Form::Parquet => {
                write_parquet(&self.path, &columns, &rows)?;
                return Ok(self.path.display().to_string());
            }
        };
        femc_film::file::write_atomic(&self.path, &bytes).map_err(failed)?;
        Ok(self.path.display().to_string())
    }
}
