//! Paths in templates and job files: relative to the folder of the file.

use std::path::{Component, Path, PathBuf};

/// Returns `path` as an absolute path without `.` and `..`; `from`: folder that it is relative to.
pub fn absolute(from: &Path, path: &Path) -> PathBuf {
    let joined = Path::new(".").join(from).join(path);
    let joined = std::path::absolute(&joined).unwrap_or(joined);
    let mut out = PathBuf::new();
    for part in joined.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => drop(out.pop()),
            other => out.push(other),
        }
    }
    out
}

/// Returns `path` relative to `folder`, with `/` between its parts; absolute if they share only the root.
pub fn relative(folder: &Path, path: &Path) -> String {
    let (folder, path) = (absolute(Path::new(""), folder), absolute(Path::new(""), path));
    let common = folder.components().zip(path.components()).take_while(|(a, b)| a == b).count();
    if common < 2 {
        return path.to_string_lossy().into_owned();
    }
    let up = folder.components().skip(common).map(|_| "..".to_owned());
    let down = path.components().skip(common).map(|part| part.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_told_from_where_its_reader_stands() {
        for (folder, path, shown) in [
            ("/a/b", "/a/b/c.mgf", "c.mgf"),
            ("/a/b", "/a/c/d.mgf", "../c/d.mgf"),
            ("/a/b/c", "/a/b/./x/../d.mgf", "../d.mgf"),
            ("/a", "/b/c.mgf", "/b/c.mgf"),
        ] {
            assert_eq!(relative(Path::new(folder), Path::new(path)), shown);
        }
        assert_eq!(absolute(Path::new("/a/b"), Path::new("../c")), Path::new("/a/c"));
    }
}
