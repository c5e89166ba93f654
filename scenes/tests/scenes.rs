//! Checks the properties of the committed scenes.

use femc_import::{LoadedScene, load_scene_file};
use femc_scene::{GroupId, Scene, Severity};
use femc_scenes::{generate_all, scenes_folder};
use std::fs;

/// Returns the names of the scene files at the top of the folder.
fn scenes() -> Vec<String> {
    let entries = fs::read_dir(scenes_folder()).expect("the scenes' folder");
    let names = entries.map(|e| e.expect("an entry").file_name().into_string().expect("UTF-8"));
    let mut scenes: Vec<String> = names.filter(|n| n.ends_with(".mgf")).collect();
    scenes.sort();
    scenes
}

fn load(name: &str) -> LoadedScene {
    load_scene_file(&scenes_folder().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Sums `count` over everything placed in the world, weighted by its placements.
fn count_placed(scene: &Scene, count: &dyn Fn(&Scene, GroupId) -> usize) -> usize {
    fn below(scene: &Scene, group: GroupId, count: &dyn Fn(&Scene, GroupId) -> usize) -> usize {
        let inner = scene.groups[group.index()].instances.iter().map(|i| below(scene, i.group, count));
        count(scene, group) + inner.sum::<usize>()
    }
    below(scene, GroupId(0), count)
}

fn polygons(scene: &Scene) -> usize {
    count_placed(scene, &|scene, group| scene.groups[group.index()].faces.len())
}

fn faces_of(scene: &Scene, material: &str) -> usize {
    count_placed(scene, &|scene, group| {
        let faces = &scene.groups[group.index()].faces;
        faces.iter().filter(|f| scene.materials[f.material.index()].name == material).count()
    })
}

#[test]
fn the_committed_files_are_what_the_generator_writes() {
    for file in generate_all() {
        let committed = fs::read(scenes_folder().join(&file.path)).unwrap_or_default();
        assert!(
            committed == file.bytes,
            "{} differs: run `cargo run -p femc-scenes -- --write scenes` and look at the change",
            file.path
        );
    }
}

#[test]
fn every_scene_loads_without_a_warning_and_stays_small() {
    let scenes = scenes();
    assert!(scenes.len() >= 7, "{scenes:?}");
    let mut complaints = Vec::new();
    for name in scenes {
        let loaded = match load_scene_file(&scenes_folder().join(&name)) {
            Ok(loaded) => loaded,
            Err(error) => {
                complaints.push(error.to_string());
                continue;
            }
        };
        complaints.extend(loaded.warnings.iter().map(ToString::to_string));
        let bytes: u64 =
            loaded.files.iter().map(|f| fs::metadata(scenes_folder().join(f)).expect("a file").len()).sum();
        assert!(bytes < 100_000, "{name}: {bytes} bytes");
        assert!(!loaded.scene.cameras.is_empty(), "{name} has no camera");
    }
    assert!(complaints.is_empty(), "{complaints:#?}");
}

#[test]
fn no_scene_has_a_fault_beyond_a_note() {
    let mut bad = Vec::new();
    for name in scenes() {
        let Ok(LoadedScene { scene, .. }) = load_scene_file(&scenes_folder().join(&name)) else { continue };
        let faults = femc_scene::check_scene(&scene).into_iter().filter(|f| f.severity != Severity::Note);
        bad.extend(faults.map(|f| format!("{name}: {}", f.display(&scene))));
    }
    assert!(bad.is_empty(), "{bad:#?}");
}

#[test]
fn roundabout_has_120_frames_40_lamps_and_9000_polygons() {
    let scene = load("roundabout.mgf").scene;
    assert_eq!(scene.frame_count(), 120);
    let polygons = polygons(&scene);
    assert!((8500..9500).contains(&polygons), "{polygons} polygons");
    assert_eq!(faces_of(&scene, "lamp"), 40);
    let driver = &scene.cameras[0];
    assert!(driver.along.is_some());
    // The eye moves from south of the ring to west of it.
    let paths = &scene.paths;
    let (first, last) = (driver.at(paths, scene.frame_time(1)), driver.at(paths, scene.frame_time(120)));
    assert!(first.origin.y < -30.0 && last.origin.x < -30.0, "{} {}", first.origin, last.origin);
    assert!((first.origin.z - 1.2).abs() < 1e-9 && (last.origin.z - 1.2).abs() < 1e-9);
}

#[test]
fn street_lamps_shine_down() {
    let scene = load("roundabout.mgf").scene;
    for group in &scene.groups {
        for face in group.faces.iter().filter(|f| scene.materials[f.material.index()].name == "lamp") {
            let first = face.first_triangle as usize;
            for triangle in &group.triangles[first..first + face.triangle_count as usize] {
                let [a, b, c] = triangle.map(|v| group.vertices[v as usize].position);
                let normal = (b - a).cross(c - a);
                assert!(normal.z < -0.999 * normal.length(), "{normal}");
            }
        }
    }
}

#[test]
fn the_measured_variant_has_its_forty_luminaires() {
    let scene = load("roundabout-ies.mgf").scene;
    assert_eq!(count_placed(&scene, &|scene, group| scene.groups[group.index()].luminaires.len()), 40);
    assert_eq!(faces_of(&scene, "lamp"), 0);
}

#[test]
fn fog_is_the_only_difference_between_the_two_boxes() {
    let (clear, foggy) = (load("cornell.mgf").scene, load("cornell-fog.mgf").scene);
    assert_eq!(polygons(&clear), polygons(&foggy));
    assert_eq!((clear.regions.len(), foggy.regions.len()), (0, 1));
}
