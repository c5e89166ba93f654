//! Structure of the document, names, cameras and materials.

use super::parse::Parsed;
use super::{prepare_file, prepare_text};
use femc_gltf::{GeometryOptions, scene_geometry};
use femc_math::glam::DVec3;
use femc_prepared::Prepared;
use serde_json::{Value, json};
use std::collections::BTreeSet;

fn parsed(prepared: &Prepared) -> Parsed {
    Parsed::new(&scene_geometry(prepared, &GeometryOptions::default()).unwrap())
}

/// A ball of radius 1.
const BALL: &str = "v center =\n  p 0 0 0\nsph center 1\n";

#[test]
fn all_scenes_of_the_repository_give_well_formed_documents() {
    let scenes = ["zoo.mgf", "gallery.mgf", "roundabout.mgf", "greenhouse.mgf", "cornell-fog.mgf", "pendant.mgf"];
    for name in scenes {
        let prepared = prepare_file(name, 1);
        let bytes = scene_geometry(&prepared, &GeometryOptions::default()).unwrap();
        assert_eq!(bytes, scene_geometry(&prepare_file(name, 1), &GeometryOptions::default()).unwrap(), "{name}");
        let parsed = Parsed::new(&bytes);
        let views = parsed.list("bufferViews");
        let used: u64 = views.iter().map(|view| view["byteLength"].as_u64().unwrap()).sum();
        assert_eq!(used, parsed.binary.len() as u64, "{name}");
        let triangles = parsed.triangles();
        assert_eq!(Some(triangles.len() as u64), parsed.extras()["triangles"].as_u64(), "{name}");
        let nodes = parsed.list("nodes");
        let (root, others) = nodes.split_last().unwrap();
        assert_eq!((root["name"].as_str(), root["children"].as_array().unwrap().len()), (Some("scene"), others.len()));
        // All objects with surfaces are there, under their names.
        let mut expected = BTreeSet::new();
        for (number, instance) in (0u32..).zip(prepared.instances.iter()) {
            for primitive in 0..instance.compiled.primitives.len() as u32 {
                expected.insert(prepared.object_name(prepared.object_of(number, primitive)).to_owned());
            }
        }
        let named: BTreeSet<String> =
            triangles.iter().map(|triangle| parsed.object(triangle.node).0.to_owned()).collect();
        assert_eq!(named, expected, "{name}");
        let bounds = prepared.world.bounds();
        let slack = bounds.size().length() * 1e-5;
        for corner in triangles.iter().flat_map(|triangle| triangle.corners) {
            let corner = corner.as_vec3a();
            let is_inside = corner.cmpge(bounds.min - slack).all() && corner.cmple(bounds.max + slack).all();
            assert!(is_inside, "{name}: {corner} is outside the scene");
        }
    }
}

#[test]
fn nodes_have_the_dotted_names_of_their_objects() {
    let text = format!("o ball\n{BALL}o inner\nxf -t 3 0 0\n{BALL}xf\no\no\n{BALL}o ball\n{BALL}o\n");
    let parsed = parsed(&prepare_text(&text));
    let objects: BTreeSet<_> = parsed.triangles().iter().map(|it| parsed.object(it.node)).collect();
    assert_eq!(objects, BTreeSet::from([("", None), ("ball", Some(0)), ("ball.inner", Some(1))]));
    let names: Vec<&str> = parsed.list("nodes").iter().filter_map(|node| node["name"].as_str()).collect();
    assert_eq!(names, ["", "ball", "ball.inner", "main", "scene"]);
}

#[test]
fn positions_are_those_of_the_scene_minus_the_origin() {
    let prepared = prepare_text(&format!("xf -t 1000.25 -8 1\n{BALL}xf\n"));
    let parsed = parsed(&prepared);
    let origin: Vec<f64> = serde_json::from_value(parsed.extras()["origin"].clone()).unwrap();
    let center = DVec3::new(1000.25, -8.0, 1.0) - DVec3::from_slice(&origin);
    for corner in parsed.triangles().iter().flat_map(|triangle| triangle.corners) {
        assert!((corner.distance(center) - 1.0).abs() < 1e-4, "{corner}");
    }
    // The root node leads from z up to y up, with the origin: (x, y, z) to (x, z, -y).
    let root = parsed.list("nodes").last().unwrap();
    assert_eq!(root["translation"], json!([origin[0], origin[2], -origin[1]]));
}

#[test]
fn cameras_are_named_and_look_where_the_scene_says() {
    let prepared = prepare_file("greenhouse.mgf", 1);
    let options = GeometryOptions { camera: Some("outside".into()), ..GeometryOptions::default() };
    let parsed = Parsed::new(&scene_geometry(&prepared, &options).unwrap());
    let with_camera = |node: &&Value| node.get("camera").is_some();
    let cameras: Vec<&Value> = parsed.list("nodes").iter().filter(with_camera).collect();
    assert_eq!(cameras.len(), prepared.scene.cameras.len());
    for (node, described) in cameras.iter().zip(&prepared.scene.cameras) {
        assert_eq!(node["name"], described.name.as_str());
        assert_eq!(node["extras"]["rendered"], described.name == "outside");
        let pose = parsed.matrix(node);
        let eye = pose.transform_point3(DVec3::ZERO);
        assert!(eye.distance(described.origin - prepared.origin) < 1e-9);
        let forward = pose.transform_vector3(-DVec3::Z);
        assert!(forward.distance((described.target - described.origin).normalize()) < 1e-9);
        assert!(pose.transform_vector3(DVec3::Y).dot(described.up) > 0.0);
        let lens = &parsed.list("cameras")[node["camera"].as_u64().unwrap() as usize];
        let angle = lens["perspective"]["yfov"].as_f64().unwrap();
        assert!((angle.to_degrees() - described.fov).abs() < 1e-9);
    }
}

#[test]
fn materials_are_named_and_show_light_and_clearness() {
    let text = format!(
        "m red =\n  sides 1\n  c\n  crgb 0.5 0.1 0.1\n  rd 1\nm red\n{BALL}\
         m glow =\n  sides 1\n  c\n  ed 500\nm glow\nxf -t 3 0 0\n{BALL}xf\n\
         m glass =\n  sides 1\n  ir 1.5 0\n  c\n  ts 0.9 0\nm glass\nxf -t 6 0 0\n{BALL}xf\n"
    );
    let parsed = parsed(&prepare_text(&text));
    let by_name = |name: &str| parsed.list("materials").iter().find(|it| it["name"] == name).unwrap();
    let base = by_name("red")["pbrMetallicRoughness"]["baseColorFactor"].clone();
    let base: Vec<f64> = serde_json::from_value(base).unwrap();
    assert!(base[0] > 3.0 * base[1] && (base[3] - 1.0).abs() < 1e-9, "{base:?}");
    assert_eq!((&by_name("red")["doubleSided"], &by_name("glass")["doubleSided"]), (&json!(false), &json!(true)));
    assert!(by_name("red").get("emissiveFactor").is_none() && by_name("glow").get("emissiveFactor").is_some());
    let glass = by_name("glass");
    assert_eq!(glass["alphaMode"], "BLEND");
    assert!(glass["pbrMetallicRoughness"]["baseColorFactor"][3].as_f64().unwrap() < 0.5);
}
