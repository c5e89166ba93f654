//! JSON on stdout: one document a command, with a line end.

use super::{Say, terminal};
use crate::exit::{Failure, failed};
use serde::Serialize;

/// Print `document`.
pub fn print<T: Serialize>(say: Say, document: &T) -> Result<(), Failure> {
    say.document(&terminal::json(&serde_json::to_string_pretty(document).map_err(failed)?));
    Ok(())
}

/// Print a document as one line, of which there may be more.
pub fn line<T: Serialize>(say: Say, document: &T) -> Result<(), Failure> {
    say.document(&terminal::json(&serde_json::to_string(document).map_err(failed)?));
    Ok(())
}
