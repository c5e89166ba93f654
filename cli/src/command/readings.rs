//! Readings of frames from a farm: documents and tables beside the frames.

use crate::exit::{Failure, failed};
use femc_pipeline::measure::FrameReadings;
use femc_reports::attempts::csv;
use femc_reports::measure::reading_columns;
use std::path::{Path, PathBuf};

/// End of the name of a document.
const DOCUMENT: &str = ".readings.json";

/// Returns the path of the document with a frame's readings.
/// - `path`: the frame's image, or the document itself.
pub fn readings_path(path: &Path) -> PathBuf {
    if is_document(path) { path.to_owned() } else { path.with_extension(&DOCUMENT[1..]) }
}

/// Returns the path of the table with a frame's readings.
/// - `path`: the frame's image, or its document.
pub fn table_path(path: &Path) -> PathBuf {
    readings_path(path).with_extension("csv")
}

/// Returns whether a path is that of a document with readings.
pub fn is_document(path: &Path) -> bool {
    path.to_string_lossy().ends_with(DOCUMENT)
}

/// Reads and checks the document of a frame.
/// - `path`: the frame's image, or the document itself.
pub fn read(path: &Path) -> Result<FrameReadings, Failure> {
    let file = readings_path(path);
    let name = file.display().to_string();
    let bytes = std::fs::read(&file).map_err(|error| failed(format!("{name}: {error}")))?;
    parse(&name, &bytes)
}

/// Parses and checks a document of readings.
/// - `name`: name of the document, for messages.
pub fn parse(name: &str, bytes: &[u8]) -> Result<FrameReadings, Failure> {
    let document: FrameReadings =
        serde_json::from_slice(bytes).map_err(|error| failed(format!("{name}: damaged readings: {error}")))?;
    document.check().map_err(|error| failed(format!("{name}: {error}")))?;
    Ok(document)
}

/// Writes the document and the table of a frame's readings beside the frame, the document last.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let file = readings_path(path);
    let document = parse(&file.display().to_string(), bytes)?;
    let table = csv(&reading_columns(), &document.readings);
    femc_film::file::write_atomic(&table_path(path), format!("{table}\n").as_bytes()).map_err(failed)?;
    femc_film::file::write_atomic(&file, bytes).map_err(failed)
}
