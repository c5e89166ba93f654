//! Location of a scene on disk: a root folder, which no file name may leave, and the scene file below it.
//!
//! Files of the scene are named relative to the root. So a scene that shares files with its neighbors is packed and found under the
//! same names on every machine.

use crate::{
    DiskFolder, ImportError, ImportErrors, ImportFault, LoadedScene, Position, load_scene, load_scene_or_all_errors,
};
use std::path::{Component, Path, PathBuf};

/// A scene file and its root.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenePath {
    root: PathBuf,
    entry: String,
}

impl ScenePath {
    /// Uses the scene file `scene` with its own folder as root.
    pub fn new(scene: &Path) -> Result<Self, ImportError> {
        let name = scene.file_name().ok_or_else(|| unreadable(scene, "the path has no file name"))?;
        let entry = name.to_str().ok_or_else(|| unreadable(scene, "the file name is not UTF-8"))?.to_owned();
        Ok(Self { root: folder(scene).to_owned(), entry })
    }

    /// Uses the scene file `scene` with the folder `root` around it. Includes, textures and lamps may lie anywhere below `root`.
    pub fn with_root(root: &Path, scene: &Path) -> Result<Self, ImportError> {
        let name = scene.file_name().ok_or_else(|| unreadable(scene, "the path has no file name"))?;
        let real = |path: &Path| path.canonicalize().map_err(|e| unreadable(path, &e.to_string()));
        let (real_root, real_folder) = (real(root)?, real(folder(scene))?);
        let full = real_folder.join(name);
        let Ok(inner) = full.strip_prefix(&real_root) else {
            let fault = ImportFault::SceneOutsideRoot { root: root.display().to_string() };
            return Err(ImportError::new(position_of_file(scene), fault));
        };
        let parts = inner.components().map(|part| match part {
            Component::Normal(part) => part.to_str(),
            _ => None,
        });
        let parts = parts.collect::<Option<Vec<_>>>().ok_or_else(|| unreadable(scene, "the path is not UTF-8"))?;
        Ok(Self { root: root.to_owned(), entry: parts.join("/") })
    }

    /// Returns the root folder, as given.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns the scene file's path below the root, `/`-separated.
    pub fn entry(&self) -> &str {
        &self.entry
    }

    /// Returns the files below the root.
    pub fn disk(&self) -> DiskFolder {
        DiskFolder::new(&self.root)
    }

    /// Imports the scene.
    pub fn load(&self) -> Result<LoadedScene, ImportError> {
        load_scene(&self.disk(), &self.entry)
    }

    /// Imports the scene, or lists its errors.
    pub fn load_or_all_errors(&self) -> Result<LoadedScene, ImportErrors> {
        load_scene_or_all_errors(&self.disk(), &self.entry)
    }
}

fn folder(scene: &Path) -> &Path {
    match scene.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

fn position_of_file(path: &Path) -> Position {
    Position { file: path.display().to_string(), line: 0, column: 0 }
}

fn unreadable(path: &Path, reason: &str) -> ImportError {
    let fault = ImportFault::Unreadable { path: path.display().to_string(), reason: reason.to_owned(), near: None };
    ImportError::new(position_of_file(path), fault)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene_tree() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = folder.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        write("houses/a/room.mgf", "i ../../lib/lamp.mgf\ni ../../lib/lamp.mgf\ni near.mgf\n");
        write("houses/a/near.mgf", "v x =\n");
        write("lib/lamp.mgf", "i part.mgf\n");
        write("lib/part.mgf", "v y =\nsph y 1\n");
        folder
    }

    #[test]
    fn files_outside_the_scene_folder_are_each_read_with_a_warning() {
        let folder = scene_tree();
        let path = ScenePath::with_root(folder.path(), &folder.path().join("houses/a/room.mgf")).unwrap();
        assert_eq!(path.entry(), "houses/a/room.mgf");
        let loaded = path.load().unwrap();
        assert_eq!(loaded.files, ["houses/a/room.mgf", "lib/lamp.mgf", "lib/part.mgf", "houses/a/near.mgf"]);
        let said: Vec<String> = loaded.warnings.iter().map(ToString::to_string).collect();
        assert_eq!(said.len(), 2, "{said:?}");
        assert!(said[0].starts_with("houses/a/room.mgf:1:3: `lib/lamp.mgf` is outside"), "{said:?}");
        assert!(said[1].starts_with("lib/lamp.mgf:1:3: `lib/part.mgf` is outside"), "{said:?}");
        assert_eq!(loaded.scene.name, "room");
    }

    #[test]
    fn scene_folder_is_the_default_root_and_no_path_leaves_a_root() {
        let folder = scene_tree();
        let scene = folder.path().join("houses/a/room.mgf");
        let error = ScenePath::new(&scene).unwrap().load().unwrap_err().to_string();
        assert!(error.starts_with("room.mgf:1:3: ") && error.contains("--root"), "{error}");
        let error =
            ScenePath::with_root(&folder.path().join("houses"), &scene).unwrap().load().unwrap_err().to_string();
        assert!(error.starts_with("a/room.mgf:1:3: "), "{error}");
    }

    #[test]
    fn a_scene_that_is_not_below_its_root_is_refused() {
        let folder = scene_tree();
        let error =
            ScenePath::with_root(&folder.path().join("lib"), &folder.path().join("houses/a/room.mgf")).unwrap_err();
        assert!(matches!(*error.fault, ImportFault::SceneOutsideRoot { .. }), "{error}");
        assert!(ScenePath::with_root(&folder.path().join("none"), &folder.path().join("houses/a/room.mgf")).is_err());
    }
}
