//! Sources of a scene's files: a folder on disk, or a bundle in memory.

use crate::{error::ImportFault, text::excerpt};
use std::{
    fs::File,
    io::{self, Read},
    path::{Path, PathBuf},
};

/// Maximum length of a path inside a scene, bytes.
pub(crate) const MAX_PATH: usize = 1024;
/// Maximum length of a path as written in a file, bytes. It may contain parts that normalization removes.
const MAX_NAMED: usize = 4096;
const TOO_LONG: &str = "it is longer than 1024 bytes";
/// Maximum number of names in a folder that are compared with a missing name.
const MAX_NAMES: usize = 10_000;

/// Source of a scene's files. Paths are relative to the scene's root, `/`-separated and normalized: no `.`, no `..`, no empty part.
pub trait FileSource {
    /// Returns the size in bytes, without reading the file.
    fn size(&self, path: &str) -> io::Result<u64>;
    /// Reads the whole file.
    fn read(&self, path: &str) -> io::Result<Vec<u8>>;
    /// Returns the names of the files in a folder, in any order; empty if they are unknown. The root is the folder `""`.
    fn names(&self, folder: &str) -> Vec<String> {
        let _ = folder;
        Vec::new()
    }
}

/// A folder on disk. Links that lead out of it are rejected.
#[derive(Clone, Debug)]
pub struct DiskFolder {
    root: PathBuf,
}

impl DiskFolder {
    /// Uses the folder `root`.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }

    fn open(&self, path: &str) -> io::Result<(File, u64)> {
        let root = self.root.canonicalize()?;
        let full = root.join(path).canonicalize()?;
        if !full.starts_with(&root) {
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, "a link leads out of the scene's root folder"));
        }
        // Checked before opening, because opening a pipe would block.
        if !full.metadata()?.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file"));
        }
        let file = File::open(&full)?;
        let size = file.metadata()?.len();
        Ok((file, size))
    }
}

impl FileSource for DiskFolder {
    fn size(&self, path: &str) -> io::Result<u64> {
        self.open(path).map(|(_, size)| size)
    }

    fn read(&self, path: &str) -> io::Result<Vec<u8>> {
        let (file, size) = self.open(path)?;
        let mut bytes = Vec::with_capacity(usize::try_from(size).unwrap_or(0));
        // A file that grows while it is read must not use more memory.
        file.take(size).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn names(&self, folder: &str) -> Vec<String> {
        let listed = self.root.canonicalize().and_then(|root| {
            let full = root.join(folder).canonicalize()?;
            if full.starts_with(&root) { full.read_dir() } else { Err(io::ErrorKind::PermissionDenied.into()) }
        });
        let names = listed.into_iter().flatten().flatten().take(MAX_NAMES);
        names.filter_map(|entry| entry.file_name().into_string().ok()).collect()
    }
}

/// Returns the name of a similar file in the folder of `path`. It may differ in upper and lower case, in blanks at the ends, or in
/// blanks written as `%20`, `_` or `+`.
pub(crate) fn similar_name(files: &dyn FileSource, path: &str) -> Option<String> {
    let plain = |name: &str| name.replace("%20", " ").replace(['_', '+'], " ").trim().to_lowercase();
    let (folder, name) = path.rsplit_once('/').unwrap_or(("", path));
    let wanted = plain(name);
    files.names(folder).into_iter().filter(|other| other != name && plain(other) == wanted).min()
}

/// Resolves the path `named`, written in the file `naming_file`, to a normalized path relative to the root.
pub(crate) fn resolve(naming_file: &str, named: &str) -> Result<String, ImportFault> {
    let unportable = |reason| ImportFault::UnportablePath { path: named.to_owned(), reason };
    if named.len() > MAX_NAMED {
        return Err(ImportFault::UnportablePath { path: excerpt(named.as_bytes()), reason: TOO_LONG });
    }
    let drive = named.as_bytes().get(1) == Some(&b':');
    if named.starts_with('/') || drive || Path::new(named).is_absolute() {
        return Err(ImportFault::AbsolutePath { path: named.to_owned() });
    }
    if named.contains('\\') {
        return Err(unportable("it has a backslash"));
    }
    if named.contains(['\0', '\u{fffd}']) {
        return Err(unportable("it has bytes that are not UTF-8"));
    }
    let folder = naming_file.rsplit_once('/').map_or("", |(folder, _)| folder);
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in named.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                if parts.pop().is_none() {
                    return Err(ImportFault::OutsideRoot { path: named.to_owned() });
                }
            }
            part => parts.push(part),
        }
    }
    if parts.is_empty() || named.ends_with('/') {
        return Err(unportable("it names a folder"));
    }
    let path = parts.join("/");
    if path.len() > MAX_PATH {
        return Err(unportable(TOO_LONG));
    }
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_resolve_from_the_naming_file_and_stay_below_the_root() {
        assert_eq!(resolve("a/b/main.mgf", "../lamp.mgf"), Ok("a/lamp.mgf".into()));
        assert_eq!(resolve("main.mgf", "./x//y.mgf"), Ok("x/y.mgf".into()));
        assert!(matches!(resolve("a/main.mgf", "../../x"), Err(ImportFault::OutsideRoot { .. })));
        assert!(matches!(resolve("main.mgf", "/etc/passwd"), Err(ImportFault::AbsolutePath { .. })));
        assert!(matches!(resolve("main.mgf", "C:/x"), Err(ImportFault::AbsolutePath { .. })));
        assert!(matches!(resolve("main.mgf", "a\\b"), Err(ImportFault::UnportablePath { .. })));
        assert!(matches!(resolve("main.mgf", "a/.."), Err(ImportFault::UnportablePath { .. })));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_out_of_the_root_is_refused_and_one_within_is_followed() {
        let outside = tempfile::NamedTempFile::new().unwrap();
        let root = tempfile::tempdir().unwrap();
        std::fs::write(root.path().join("in.mgf"), "# in\n").unwrap();
        std::os::unix::fs::symlink(outside.path(), root.path().join("out.mgf")).unwrap();
        std::os::unix::fs::symlink("in.mgf", root.path().join("also.mgf")).unwrap();
        let disk = DiskFolder::new(root.path());
        assert_eq!(disk.read("out.mgf").unwrap_err().kind(), io::ErrorKind::PermissionDenied);
        assert_eq!(disk.read("also.mgf").unwrap(), b"# in\n");
        assert_eq!(disk.size("in.mgf").unwrap(), 5);
        assert!(disk.read("").is_err());
    }

    #[cfg(unix)]
    #[test]
    fn linked_folders_loops_and_pipes_are_refused_not_hard_links() {
        let (outside, root) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        std::fs::write(outside.path().join("secret"), "x").unwrap();
        let at = |name: &str| root.path().join(name);
        std::os::unix::fs::symlink(outside.path(), at("folder")).unwrap();
        std::os::unix::fs::symlink("loop", at("loop")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", at("zero")).unwrap();
        std::fs::hard_link(outside.path().join("secret"), at("hard")).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
        let disk = DiskFolder::new(root.path());
        for path in ["folder/secret", "folder", "loop", "zero", "socket", "hard/x"] {
            assert!(disk.read(path).is_err() && disk.size(path).is_err(), "{path}");
        }
        // A hard link cannot be distinguished from any other file, and a user who packs it could read it anyway.
        assert_eq!(disk.read("hard").unwrap(), b"x");
    }
}
