//! A file that is read again when it has changed.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;

use crate::TrustError;

/// How the file's text becomes what it means.
type Parse<T> = fn(&Path, &str) -> Result<T, TrustError>;

/// What a file said when it was last read; clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Reread<T> {
    path: Arc<Path>,
    parse: Parse<T>,
    state: Arc<RwLock<State<T>>>,
}

#[derive(Debug, Default)]
struct State<T> {
    /// When it was written, and its bytes; `None`: it was not there.
    stamp: Option<(SystemTime, u64)>,
    said: T,
}

impl<T: Default> Reread<T> {
    /// Reads the file. One that is not there says nothing; one that cannot be understood is an error.
    pub(crate) fn open(path: PathBuf, parse: Parse<T>) -> Result<Self, TrustError> {
        let file = Self { path: path.into(), parse, state: Arc::default() };
        file.refresh()?;
        Ok(file)
    }

    /// What it says now. Where it has become unreadable, what it said before holds.
    pub(crate) fn look<R>(&self, look: impl FnOnce(&T) -> R) -> R {
        if let Err(error) = self.refresh() {
            tracing::warn!(%error, "what the file said before holds");
        }
        look(&self.state.read().unwrap_or_else(PoisonError::into_inner).said)
    }

    fn refresh(&self) -> Result<(), TrustError> {
        let stamp = match std::fs::metadata(&self.path).and_then(|file| Ok((file.modified()?, file.len()))) {
            Ok(stamp) => Some(stamp),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            Err(error) => return Err(TrustError::File { path: self.path.to_path_buf(), error }),
        };
        if stamp == self.state.read().unwrap_or_else(PoisonError::into_inner).stamp {
            return Ok(());
        }
        let said = match stamp {
            Some(_) => {
                let text = std::fs::read_to_string(&self.path).map_err(TrustError::file(&*self.path))?;
                (self.parse)(&self.path, &text)?
            }
            None => T::default(),
        };
        *self.state.write().unwrap_or_else(PoisonError::into_inner) = State { stamp, said };
        Ok(())
    }
}

/// The lines of a list, with their numbers from 1; empty ones and those that begin with `#` are for people.
pub(crate) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.lines().enumerate().map(|(at, line)| (at + 1, line.trim()));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}
