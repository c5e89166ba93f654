//! List of revoked certificates.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use crate::reload::{ReloadingFile, lines};
use crate::{Fingerprint, TrustError};

/// A file of fingerprints, one per line; the rest of a line is a comment. The file is reread when it has changed.
#[derive(Debug, Clone)]
pub struct RevocationList(ReloadingFile<HashSet<Fingerprint>>);

impl RevocationList {
    /// Reads the file. A missing file revokes nothing; a file that cannot be parsed is an error.
    pub fn open(path: impl Into<PathBuf>) -> Result<Self, TrustError> {
        ReloadingFile::open(path.into(), parse).map(Self)
    }

    /// Checks whether this certificate is revoked. Rereads the file first if its modification time or size has changed. If the file
    /// cannot be read any more, its last valid content stays in force.
    pub fn contains(&self, fingerprint: &Fingerprint) -> bool {
        self.0.with_content(|fingerprints| fingerprints.contains(fingerprint))
    }
}

fn parse(path: &Path, text: &str) -> Result<HashSet<Fingerprint>, TrustError> {
    let fingerprint = |(at, line): (usize, &str)| {
        let fingerprint = line.split_whitespace().next().and_then(Fingerprint::parse);
        let message = || format!("line {at}: expected the fingerprint of a certificate");
        fingerprint.ok_or_else(|| TrustError::Malformed { path: path.into(), message: message() })
    };
    lines(text).map(fingerprint).collect()
}
