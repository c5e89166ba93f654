//! Tests of scenes that are not part of the project, in `../shared`; skipped if that folder is missing.

use femc_import::{Bundle, DiskFolder, LoadedScene, load_scene, load_scene_file};
use femc_require::shared_folder;
use femc_scene::Opening;
use std::path::{Path, PathBuf};

fn scenes(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(scenes(&path));
        } else if path.extension().is_some_and(|extension| extension == "mgf") {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn load_and_print(path: &Path) -> LoadedScene {
    let loaded = load_scene_file(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let scene = &loaded.scene;
    let faces: usize = scene.groups.iter().map(|group| group.faces.len()).sum();
    let quadrics: usize = scene.groups.iter().map(|group| group.quadrics.len()).sum();
    println!(
        "{}: {faces} faces, {quadrics} quadrics, {} materials, {} objects, {} warnings",
        scene.name,
        scene.materials.len(),
        scene.objects.len(),
        loaded.warnings.len()
    );
    for warning in loaded.warnings.iter().take(6) {
        println!("    {warning}");
    }
    loaded
}

#[test]
fn reference_scenes_load_whole() {
    let Some(folder) = shared_folder("refs") else { return };
    for path in scenes(&folder) {
        let LoadedScene { scene, warnings, .. } = load_and_print(&path);
        assert!(warnings.is_empty(), "{warnings:?}");
        assert_eq!(scene.cameras.len(), 1);
        let faces = std::fs::read_to_string(&path).unwrap().lines().filter(|line| line.starts_with("f ")).count();
        assert_eq!(scene.groups[0].faces.len(), faces);
        assert!(scene.groups[0].faces.iter().all(|face| face.triangle_count > 0));
    }
}

#[test]
fn real_scenes_load_without_an_error() {
    let Some(folder) = shared_folder("scenes-real") else { return };
    for path in scenes(&folder) {
        let LoadedScene { scene, .. } = load_and_print(&path);
        assert!(scene.groups.iter().any(|group| !group.faces.is_empty()));
    }
}

#[test]
fn a_real_photometric_file_reads_without_a_remark() {
    let Some(folder) = shared_folder("scenes-real") else { return };
    let mut bundle = Bundle::from_files(&DiskFolder::new(&folder), &["examp1.ies".into()]).unwrap();
    bundle.0.insert("t.mgf".into(), b"ies examp1.ies\n".to_vec());
    let LoadedScene { scene, warnings, .. } = load_scene(&bundle, "t.mgf").unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    let photometry = &scene.photometry[0];
    assert_eq!((photometry.vertical.len(), photometry.horizontal.len()), (73, 5));
    assert_eq!((photometry.candela[0], photometry.candela[364]), (778.4, 801.4));
    assert!(matches!(photometry.opening, Opening::Box { length, .. } if (length - 4.04 * 0.3048).abs() < 1e-12));
}
