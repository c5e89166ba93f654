//! The limit on triangles: coarser shapes, then boxes.

use super::parse::Parsed;
use super::prepare_file;
use femc_gltf::{GeometryOptions, scene_geometry};
use femc_prepared::Prepared;

fn limited(prepared: &Prepared, max_triangles: u64) -> Parsed {
    let options = GeometryOptions { max_triangles, ..GeometryOptions::default() };
    Parsed::new(&scene_geometry(prepared, &options).unwrap())
}

/// Returns the numbers of triangles and of boxed objects, and the deviation as a share.
fn counts(parsed: &Parsed) -> (usize, u64, f64) {
    let extras = parsed.extras();
    let triangles = parsed.triangles().len();
    assert_eq!(extras["triangles"].as_u64(), Some(triangles as u64));
    (triangles, extras["boxed_objects"].as_u64().unwrap(), extras["deviation_share"].as_f64().unwrap())
}

#[test]
fn shapes_become_coarser_before_objects_become_boxes() {
    let prepared = prepare_file("greenhouse.mgf", 1);
    let (all, boxed, share) = counts(&limited(&prepared, 2_000_000));
    assert_eq!((boxed, share), (0, 0.002));
    let (fewer, boxed, coarser) = counts(&limited(&prepared, all as u64 / 2));
    assert!(fewer <= all / 2 && boxed == 0 && coarser > share, "{fewer} triangles, {coarser}");
}

#[test]
fn largest_objects_become_boxes_and_the_document_names_them() {
    let prepared = prepare_file("greenhouse.mgf", 1);
    for limit in [20_000, 5_000, 1_000, 200, 130, 50, 12, 0] {
        let parsed = limited(&prepared, limit);
        let (triangles, boxed, _) = counts(&parsed);
        assert!(triangles as u64 <= limit, "{triangles} triangles, limit {limit}");
        let list = parsed.extras()["boxed"].as_array().unwrap();
        assert_eq!(list.len() as u64, boxed);
        let had: Vec<u64> = list.iter().map(|it| it["triangles"].as_u64().unwrap()).collect();
        let nodes = parsed.list("nodes").iter().filter(|node| node.get("mesh").is_some());
        let shown = nodes.filter(|node| node["extras"]["boxed"] == false);
        let largest = shown.map(|node| node["extras"]["triangles"].as_u64().unwrap()).max().unwrap_or(0);
        assert!(had.iter().all(|boxed| *boxed >= largest), "limit {limit}: {had:?} are boxed, {largest} is shown");
        assert_eq!(parsed.json, limited(&prepared, limit).json);
    }
}

#[test]
fn smallest_of_too_many_objects_are_left_out() {
    let prepared = prepare_file("greenhouse.mgf", 1);
    let options = GeometryOptions { max_objects: 4, ..GeometryOptions::default() };
    let parsed = Parsed::new(&scene_geometry(&prepared, &options).unwrap());
    let nodes = parsed.list("nodes").iter().filter(|node| node.get("mesh").is_some());
    let shown: Vec<u64> = nodes.map(|node| node["extras"]["triangles"].as_u64().unwrap()).collect();
    let left_out = parsed.extras()["boxed"].as_array().unwrap();
    assert_eq!((shown.len(), shown.len() + left_out.len()), (4, prepared.scene.objects.len()));
    let smallest = shown.iter().min().unwrap();
    assert!(left_out.iter().all(|it| it["left_out"] == true && it["triangles"].as_u64().unwrap() <= *smallest));
}
