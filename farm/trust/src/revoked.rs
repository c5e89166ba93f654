//! Certificates that count no more, although the authority once vouched for them.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;

use crate::{Fingerprint, TrustError};

/// A file of fingerprints, one a line; what follows one on its line is for people. It is read again when it has changed.
#[derive(Debug, Clone)]
pub struct Revoked {
    path: PathBuf,
    list: Arc<RwLock<List>>,
}

#[derive(Debug, Default)]
struct List {
    changed: Option<SystemTime>,
    fingerprints: HashSet<Fingerprint>,
}

impl Revoked {
    /// Reads the file. One that is not there revokes nothing; one that cannot be understood is an error.
    pub fn open(path: impl Into<PathBuf>) -> Result<Self, TrustError> {
        let revoked = Self { path: path.into(), list: Arc::default() };
        revoked.refresh()?;
        Ok(revoked)
    }

    /// Whether this certificate counts no more. Looks at the file's time first; where the file has become unreadable, what it
    /// said before holds, and an error is returned beside it by [`Revoked::refresh`].
    pub fn holds(&self, fingerprint: &Fingerprint) -> bool {
        if let Err(error) = self.refresh() {
            tracing::warn!(%error, "the list of revoked certificates");
        }
        self.list.read().unwrap_or_else(PoisonError::into_inner).fingerprints.contains(fingerprint)
    }

    /// Reads the file again, if it has changed.
    pub fn refresh(&self) -> Result<(), TrustError> {
        let changed = match std::fs::metadata(&self.path).and_then(|file| file.modified()) {
            Ok(changed) => Some(changed),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            Err(error) => return Err(TrustError::File { path: self.path.clone(), error }),
        };
        if changed == self.list.read().unwrap_or_else(PoisonError::into_inner).changed {
            return Ok(());
        }
        let fingerprints = if changed.is_some() { read(&self.path)? } else { HashSet::new() };
        *self.list.write().unwrap_or_else(PoisonError::into_inner) = List { changed, fingerprints };
        Ok(())
    }
}

fn read(path: &Path) -> Result<HashSet<Fingerprint>, TrustError> {
    let text = std::fs::read_to_string(path).map_err(TrustError::file(path))?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    lines
        .map(|(at, line)| {
            let fingerprint = line.split_whitespace().next().and_then(Fingerprint::parse);
            let message = || format!("line {}: no fingerprint of a certificate", at + 1);
            fingerprint.ok_or_else(|| TrustError::Malformed { path: path.into(), message: message() })
        })
        .collect()
}
