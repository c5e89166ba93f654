//! Tests with files from users of other renderers, with the correct values. The inputs are in `cli/tests/real_files`.

mod energy;
mod files;
mod lamps;
mod photometry;
mod words;

use crate::common::{CommandOutput, TestFolder};
use std::path::Path;

/// Creates a temporary folder with all inputs.
fn test_folder() -> TestFolder {
    let dir = TestFolder::new();
    let inputs = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/real_files");
    for entry in std::fs::read_dir(inputs).expect("the folder of inputs") {
        let entry = entry.expect("an input");
        std::fs::copy(entry.path(), dir.path(&entry.file_name().to_string_lossy())).expect("the input is copied");
    }
    dir
}

/// Returns standard output and standard error together.
fn all_output(ran: &CommandOutput) -> String {
    format!("{}{}", ran.stdout(), ran.stderr())
}
