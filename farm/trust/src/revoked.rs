//! Certificates that count no more, although the authority once vouched for them.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use crate::reread::{Reread, lines};
use crate::{Fingerprint, TrustError};

/// A file of fingerprints, one a line; what follows one on its line is for people. It is read again when it has changed.
#[derive(Debug, Clone)]
pub struct Revoked(Reread<HashSet<Fingerprint>>);

impl Revoked {
    /// Reads the file. One that is not there revokes nothing; one that cannot be understood is an error.
    pub fn open(path: impl Into<PathBuf>) -> Result<Self, TrustError> {
        Reread::open(path.into(), read).map(Self)
    }

    /// Whether this certificate counts no more. Looks at the file's time first; where the file has become unreadable, what it
    /// said before holds.
    pub fn holds(&self, fingerprint: &Fingerprint) -> bool {
        self.0.look(|fingerprints| fingerprints.contains(fingerprint))
    }
}

fn read(path: &Path, text: &str) -> Result<HashSet<Fingerprint>, TrustError> {
    let fingerprint = |(at, line): (usize, &str)| {
        let fingerprint = line.split_whitespace().next().and_then(Fingerprint::parse);
        let message = || format!("line {at}: no fingerprint of a certificate");
        fingerprint.ok_or_else(|| TrustError::Malformed { path: path.into(), message: message() })
    };
    lines(text).map(fingerprint).collect()
}
