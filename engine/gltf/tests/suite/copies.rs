//! Copies of groups: shared meshes, united meshes, and boxes at each place.

use super::parse::Parsed;
use super::prepare_text;
use super::rays::compare;
use femc_gltf::{GeometryOptions, scene_geometry};
use femc_prepared::Prepared;
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// Returns the description of a bent strip of triangles, 2 m long.
fn strip(triangles: u32) -> String {
    let mut text = String::new();
    for k in 0..triangles + 2 {
        let x = 2.0 * f64::from(k) / f64::from(triangles);
        writeln!(text, "v s{k} =\n  p {x} {} {}", k % 2, 0.3 * (5.0 * x).sin()).unwrap();
    }
    for k in 0..triangles {
        writeln!(text, "f s{} s{} s{}", k, k + 1 + k % 2, k + 2 - k % 2).unwrap();
    }
    text
}

/// Prepares copies of a strip in an object. They turn, so that each has another pose.
fn copies(triangles: u32, count: u32, first: &str) -> Prepared {
    let strip = strip(triangles);
    prepare_text(&format!("o strips\nxf {first} -a {count} -t 2.5 0 0.1 -rz 3\n{strip}xf\no\n"))
}

fn parsed(prepared: &Prepared, max_triangles: u64) -> Parsed {
    let options = GeometryOptions { max_triangles, ..GeometryOptions::default() };
    Parsed::new(&scene_geometry(prepared, &options).unwrap())
}

/// Returns, by node of an object: its mesh, the places that it shows, and its triangles.
fn nodes(parsed: &Parsed) -> Vec<(u64, u64, u64)> {
    let nodes = parsed.list("nodes").iter().filter(|node| node.get("mesh").is_some());
    let number = |value: &serde_json::Value| value.as_u64().unwrap();
    nodes
        .map(|node| (number(&node["mesh"]), number(&node["extras"]["places"]), number(&node["extras"]["triangles"])))
        .collect()
}

#[test]
fn copies_of_a_large_mesh_share_it() {
    for first in ["", "-mx"] {
        let prepared = copies(2100, 10, first);
        assert_eq!(prepared.instances.len(), 10, "the copies are instances of one group");
        let parsed = parsed(&prepared, 2_000_000);
        assert_eq!(nodes(&parsed), vec![(0, 1, 2100); 10]);
        let poses: BTreeSet<String> =
            parsed.list("nodes").iter().filter_map(|node| Some(node.get("matrix")?.to_string())).collect();
        assert_eq!(poses.len(), 11, "each copy and the camera has its own pose");
        let tally = compare(&prepared, 2000);
        assert!(tally.hits > 20 && tally.differences() == 0, "{tally:?}");
    }
}

#[test]
fn copies_of_a_small_mesh_are_united() {
    for first in ["", "-mx"] {
        let prepared = copies(100, 210, first);
        assert_eq!(prepared.instances.len(), 210, "the copies are instances of one group");
        assert_eq!(nodes(&parsed(&prepared, 2_000_000)), [(0, 210, 21_000)]);
        let tally = compare(&prepared, 2000);
        assert!(tally.hits > 20 && tally.differences() == 0, "{tally:?}");
    }
}

#[test]
fn copies_beyond_the_limit_are_boxes_at_each_place() {
    let prepared = copies(2100, 10, "");
    let limited = parsed(&prepared, 1000);
    assert_eq!(nodes(&limited), [(0, 10, 120)]);
    let bounds = prepared.world.bounds();
    let corners: Vec<_> =
        limited.triangles().iter().flat_map(|it| it.corners.map(|corner| corner.as_vec3a())).collect();
    let [least, most] = [
        corners.iter().fold(corners[0], |least, corner| least.min(*corner)),
        corners.iter().fold(corners[0], |most, corner| most.max(*corner)),
    ];
    assert!(
        least.cmple(bounds.min + 1e-3).all() && most.cmpge(bounds.max - 1e-3).all(),
        "the boxes contain the strips"
    );
    assert_eq!(limited.extras()["boxed"][0]["triangles"], 21_000);
    // A single box has twelve triangles, too.
    assert_eq!(nodes(&parsed(&prepared, 100)), [(0, 1, 12)]);
}
