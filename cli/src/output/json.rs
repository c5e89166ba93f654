//! JSON on stdout: one document per command, ending with a newline.

use super::{Printer, terminal};
use crate::exit::{Failure, failed};
use serde::Serialize;

/// Prints `document`.
pub fn print<T: Serialize>(printer: Printer, document: &T) -> Result<(), Failure> {
    printer.document(&terminal::escape_json(&serde_json::to_string_pretty(document).map_err(failed)?));
    Ok(())
}

/// Prints a document on one line, for commands that print a stream of documents.
pub fn print_line<T: Serialize>(printer: Printer, document: &T) -> Result<(), Failure> {
    printer.document(&terminal::escape_json(&serde_json::to_string(document).map_err(failed)?));
    Ok(())
}
