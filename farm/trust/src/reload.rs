//! Files that are reread when they have changed.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;

use crate::TrustError;

/// Parser of the file's text.
type Parse<T> = fn(&Path, &str) -> Result<T, TrustError>;

/// A parsed file. Clones share the parsed content.
#[derive(Debug, Clone)]
pub(crate) struct ReloadingFile<T> {
    path: Arc<Path>,
    parse: Parse<T>,
    state: Arc<RwLock<State<T>>>,
}

#[derive(Debug, Default)]
struct State<T> {
    /// Modification time and size in bytes; `None`: the file did not exist.
    stamp: Option<(SystemTime, u64)>,
    content: T,
}

impl<T: Default> ReloadingFile<T> {
    /// Reads the file. A missing file counts as empty; a file that cannot be parsed is an error.
    pub(crate) fn open(path: PathBuf, parse: Parse<T>) -> Result<Self, TrustError> {
        let file = Self { path: path.into(), parse, state: Arc::default() };
        file.refresh()?;
        Ok(file)
    }

    /// Calls `look` with the current content. If the file cannot be read any more, its last valid content stays in force.
    pub(crate) fn with_content<R>(&self, look: impl FnOnce(&T) -> R) -> R {
        if let Err(error) = self.refresh() {
            tracing::warn!(%error, "cannot reread the file: its last valid content stays in force");
        }
        look(&self.state.read().unwrap_or_else(PoisonError::into_inner).content)
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
        let content = match stamp {
            Some(_) => {
                let text = std::fs::read_to_string(&self.path).map_err(TrustError::file(&*self.path))?;
                (self.parse)(&self.path, &text)?
            }
            None => T::default(),
        };
        *self.state.write().unwrap_or_else(PoisonError::into_inner) = State { stamp, content };
        Ok(())
    }
}

/// Returns the lines of a list with their numbers, from 1. Empty lines and comments, which begin with `#`, are skipped.
pub(crate) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.lines().enumerate().map(|(at, line)| (at + 1, line.trim()));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}
