//! Tests that the import of any bytes ends with a scene or an error.

#[path = "../../examples/corpus/mod.rs"]
mod corpus;

use corpus::{Rng, mutate, random_words};
use femc_import::{Bundle, LoadedScene, load_scene, load_scene_or_all_errors};
use femc_scene::{Scene, Shape};
use proptest::prelude::*;

/// Checks the invariants of an imported scene that a renderer relies on.
fn check(scene: &Scene) {
    for (g, group) in scene.groups.iter().enumerate() {
        let vertices = group.vertices.len() as u32;
        assert!(group.triangles.iter().flatten().all(|&i| i < vertices));
        assert!(group.vertices.iter().all(|v| v.position.is_finite()));
        assert!(group.vertices.iter().filter_map(|v| v.normal).all(|n| (n.length() - 1.0).abs() < 1e-9));
        assert!(group.faces.iter().all(|f| f.material.index() < scene.materials.len()));
        for quadric in &group.quadrics {
            assert!(quadric.material.index() < scene.materials.len());
            if let Shape::Torus { major, minor, .. } = quadric.shape {
                assert!(minor > 0.0 && minor <= major * (1.0 + 1e-12));
            }
        }
        for instance in &group.instances {
            assert!(instance.group.index() < scene.groups.len() && instance.group.index() != g);
            let mirrors = instance.motion.as_static().is_some_and(|t| t.matrix3.determinant() < 0.0);
            assert!(!mirrors, "no instance mirrors");
        }
    }
    assert!(scene.paths.iter().all(|path| !path.keys.is_empty()));
    let places = scene.cameras.iter().flat_map(|camera| [camera.origin, camera.target]);
    assert!(places.into_iter().all(|place| place.is_finite()), "{:?}", scene.cameras);
}

fn import(bundle: &Bundle) {
    match load_scene_or_all_errors(bundle, "t.mgf") {
        Ok(LoadedScene { scene, .. }) => check(&scene),
        Err(listed) => {
            let error = load_scene(bundle, "t.mgf").expect_err("the first error");
            assert!(listed.errors.contains(&error) || !listed.complete, "{error}\n{listed:#?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mutated_scenes_and_lamps_end_in_a_scene_or_an_error(seed: u64) {
        import(&Bundle(mutate(&mut Rng::new(seed))));
    }

    #[test]
    fn soups_of_words_end_in_a_scene_or_an_error(seed: u64) {
        import(&Bundle([("t.mgf".to_owned(), random_words(&mut Rng::new(seed)).into_bytes())].into()));
    }

    #[test]
    fn any_bytes_end_in_a_scene_or_an_error(bytes: Vec<u8>) {
        import(&Bundle([("t.mgf".to_owned(), bytes.clone())].into()));
        let files = [("t.mgf".to_owned(), b"ies lamp.ies\n".to_vec()), ("lamp.ies".to_owned(), [b"TILT=NONE\n", &bytes[..]].concat())];
        import(&Bundle(files.into()));
    }

    #[test]
    fn a_bundle_of_any_bytes_is_refused_or_read(bytes: Vec<u8>) {
        let _ = Bundle::decode(&bytes, 1 << 20);
    }
}
