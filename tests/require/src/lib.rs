//! Prerequisites of tests. Decides whether a test may be skipped on a machine that lacks one.
//!
//! Tests with missing prerequisites are skipped with a printed line. `FEMC_REQUIRE` lists mandatory prerequisites, separated by
//! commas (`postgres`, `s3`, `python`, `refs`, `curl`, `python3`, `node`). A test that lacks a mandatory prerequisite fails. An
//! unknown word fails every test that checks any prerequisite.
#![deny(missing_docs)]

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Environment variable that lists the mandatory prerequisites.
pub const VARIABLE: &str = "FEMC_REQUIRE";

/// A prerequisite that some machines lack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prerequisite {
    /// A PostgreSQL server that speaks TLS; `tests/postgres` starts one.
    Postgres,
    /// An S3 server; `tests/s3` starts one.
    S3,
    /// Python with the packages of the example client and of the manual; `tests/python` installs them.
    Python,
    /// The reference scenes and images in `../shared`.
    Refs,
    /// The program `curl` with HTTP/2.
    Curl,
    /// The program `python3`, with its standard library only.
    Python3,
    /// The program `node`, version 18 or later, which has `fetch`.
    Node,
}

/// An unknown word in [`VARIABLE`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{VARIABLE} names `{0}`, which is none of postgres, s3, python, refs, curl, python3, node")]
pub struct UnknownPrerequisite(String);

impl Prerequisite {
    const ALL: [Self; 7] = [Self::Postgres, Self::S3, Self::Python, Self::Refs, Self::Curl, Self::Python3, Self::Node];

    fn name(self) -> &'static str {
        match self {
            Self::Postgres => "postgres",
            Self::S3 => "s3",
            Self::Python => "python",
            Self::Refs => "refs",
            Self::Curl => "curl",
            Self::Python3 => "python3",
            Self::Node => "node",
        }
    }

    /// Returns `found`. Prints a skip if it is `None`.
    /// - `absent`: reason for the skip, for people.
    ///
    /// # Panics
    /// If `found` is `None` and [`VARIABLE`] names the need, or if [`VARIABLE`] contains an unknown word.
    pub fn or_skip<T>(self, found: Option<T>, absent: &str) -> Option<T> {
        let list = std::env::var_os(VARIABLE).unwrap_or_default();
        let required = parse(&list.to_string_lossy()).unwrap_or_else(|unknown| panic!("{unknown}"));
        if found.is_none() {
            assert!(!required.contains(&self), "{VARIABLE} asks for {self}: {absent}");
            println!("skipped: {absent}");
        }
        found
    }

    /// Checks whether the program of this name runs; see [`Prerequisite::or_skip`].
    pub fn has_program(self) -> bool {
        let ran = std::process::Command::new(self.name()).arg("--version").output();
        let found = ran.ok().filter(|ran| ran.status.success());
        self.or_skip(found, &format!("{self} is not installed")).is_some()
    }

    /// Returns the value of a variable that the script `tests/<need>` sets; see [`Prerequisite::or_skip`].
    pub fn variable_or_skip(self, name: &str) -> Option<String> {
        self.or_skip(std::env::var(name).ok(), &format!("{name} is not set (tests/{self} sets it)"))
    }
}

impl fmt::Display for Prerequisite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Prerequisite {
    type Err = UnknownPrerequisite;

    fn from_str(word: &str) -> Result<Self, UnknownPrerequisite> {
        Self::ALL.into_iter().find(|need| need.name() == word).ok_or_else(|| UnknownPrerequisite(word.to_owned()))
    }
}

/// Parses a comma-separated list of needs. The list may be empty.
fn parse(list: &str) -> Result<Vec<Prerequisite>, UnknownPrerequisite> {
    list.split(',').map(str::trim).filter(|word| !word.is_empty()).map(str::parse).collect()
}

/// Returns a folder of `../shared`, beside the checkout; see [`Prerequisite::or_skip`].
pub fn shared_folder(folder: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(folder);
    let absent = format!("{} is not there", path.display());
    Prerequisite::Refs.or_skip(path.is_dir().then_some(path), &absent)
}

#[cfg(test)]
mod tests {
    use super::{Prerequisite, parse};

    #[test]
    fn a_list_is_its_words() {
        assert_eq!(parse("s3,postgres, refs"), Ok(vec![Prerequisite::S3, Prerequisite::Postgres, Prerequisite::Refs]));
        assert_eq!(parse("postgres,s3,python,refs,curl,python3,node"), Ok(Prerequisite::ALL.to_vec()));
        assert_eq!(parse(""), Ok(vec![]));
    }

    #[test]
    fn an_unknown_word_is_named() {
        let error = parse("s3,postgresql").unwrap_err().to_string();
        assert!(error.contains("`postgresql`") && error.contains("FEMC_REQUIRE"), "{error}");
        assert!(parse("S3").is_err());
    }
}
