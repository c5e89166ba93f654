//! JSON on stdout: one document a command, with a line end.

use super::{Say, terminal};
use crate::exit::{Failure, failed};
use serde::Serialize;

/// Print `document`.
pub fn print<T: Serialize>(say: Say, document: &T) -> Result<(), Failure> {
    say.document(&terminal::json(&serde_json::to_string_pretty(document).map_err(failed)?));
    Ok(())
}

/// Prints a document on one line: commands that print a stream of documents use a line for each.
pub fn line<T: Serialize>(say: Say, document: &T) -> Result<(), Failure> {
    say.document(&terminal::json(&serde_json::to_string(document).map_err(failed)?));
    Ok(())
}
