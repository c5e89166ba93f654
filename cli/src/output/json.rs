//! JSON on stdout: one document a command, with a line end.

use super::Say;
use crate::exit::{Failure, failed};
use serde::Serialize;

/// Print `document`.
pub fn print<T: Serialize>(say: Say, document: &T) -> Result<(), Failure> {
    say.result(serde_json::to_string_pretty(document).map_err(failed)?);
    Ok(())
}
