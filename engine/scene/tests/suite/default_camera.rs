//! Tests of the default camera.

use femc_import::{Bundle, LoadedScene, load_scene};
use femc_math::glam::DVec3;
use femc_scene::{Camera, check_scene};
use std::collections::BTreeMap;

/// Returns a box from -1 to 1 in x and y and from 0 to 2 in z, as a prism. With `length` > 0 its fronts face out.
fn walls(material: &str, length: f64) -> String {
    let z = length.max(0.0);
    let corners = [("a", "-1 -1"), ("b", "1 -1"), ("c", "1 1"), ("d", "-1 1")];
    let vertices: String = corners.iter().map(|(name, place)| format!("v {name} =\n p {place} {z}\n")).collect();
    format!("{material}\n{vertices}prism a b c d {length}\n")
}

fn lamp(place: &str) -> String {
    format!("m lamp =\n sides 1\n ed 100\nv l =\n p {place}\nsph l .05\n")
}

fn load_text(text: &str) -> LoadedScene {
    let files = BTreeMap::from([("t.mgf".to_owned(), text.as_bytes().to_vec())]);
    load_scene(&Bundle(files), "t.mgf").unwrap_or_else(|error| panic!("{error}"))
}

fn camera(text: &str) -> (Camera, String) {
    let LoadedScene { scene, notes, .. } = load_text(text);
    let [camera] = &scene.cameras[..] else { panic!("one camera") };
    let [note] = &notes[..] else { panic!("one note: {notes:?}") };
    assert_eq!((camera.name.as_str(), camera.fov, camera.film), ("default", 60.0, [640, 480]));
    (camera.clone(), note.to_string())
}

fn is_in_the_box(p: DVec3) -> bool {
    p.cmpgt(DVec3::new(-1.0, -1.0, 0.0)).all() && p.cmplt(DVec3::new(1.0, 1.0, 2.0)).all()
}

#[test]
fn a_closed_room_with_a_lamp_in_it_is_seen_from_inside() {
    for length in [2.0, -2.0] {
        let room = walls("m wall =\nsides 2\nrd .5", length) + &lamp("0 0 1.8");
        let (camera, note) = camera(&room);
        assert!(is_in_the_box(camera.origin), "{}", camera.origin);
        assert!(camera.target.abs_diff_eq(DVec3::Z, 1e-9), "the middle of what is not a lamp: {}", camera.target);
        assert!(note.starts_with("t.mgf: the scene has no camera: `default`"), "{note}");
        assert!(note.contains("inside the closed room") && note.contains("camera NAME ="), "{note}");
    }
}

#[test]
fn externally_lit_solid_and_open_box_are_viewed_from_outside() {
    let solid = walls("m wall =\nsides 2\nrd .5", 2.0) + &lamp("4 0 4");
    let (of_solid, note) = camera(&solid);
    assert!(!is_in_the_box(of_solid.origin) && note.contains("from outside"), "{} {note}", of_solid.origin);
    assert!(of_solid.target.abs_diff_eq(DVec3::Z, 1e-9), "the lamp does not count: {}", of_solid.target);
    // The whole box is in view: its corners lie within the cone of 60 degrees.
    let (view, half) = (of_solid.target - of_solid.origin, 3.0f64.sqrt());
    assert!(half <= view.length() * 0.5 * 1.000001);
    let faces = "m wall =\nsides 2\nrd .5\nv a =\np -1 -1 0\nv b =\np 1 -1 0\nv c =\np 1 1 0\nv d =\np -1 1 0\n\
                 v e =\np -1 -1 2\nv f =\np 1 -1 2\nv g =\np 1 1 2\nv h =\np -1 1 2\n\
                 f a b c d\nf e f g h\nf a d h e\nf b c g f\nf d c g h\n";
    let (of_open, _) = camera(&(faces.to_owned() + &lamp("0 0 1.8")));
    assert!(of_open.origin.y < -1.0 && of_open.origin.z > 1.0, "looks in through the open side: {}", of_open.origin);
}

#[test]
fn without_a_lamp_walls_that_face_the_middle_make_a_room() {
    let is_inside = |length| is_in_the_box(camera(&walls("m wall =\nsides 2\nrd .5", length)).0.origin);
    assert!(is_inside(-2.0), "fronts face in");
    assert!(!is_inside(2.0), "fronts face out");
}

#[test]
fn a_scene_with_a_camera_keeps_it_and_an_empty_one_gets_none() {
    let own = load_text(&format!("camera main =\norigin 0 -5 1\ntarget 0 0 1\n{}", lamp("0 0 0")));
    assert!(own.scene.cameras.len() == 1 && own.scene.cameras[0].name == "main" && own.notes.is_empty());
    let empty = load_text("m wall =\nrd .5\n");
    assert!(empty.scene.cameras.is_empty() && empty.notes.is_empty());
    let point = load_text("medium gas =\nglow 1\nmbox gas 3 4 5 3.1 4.1 5.1\n").scene;
    assert!(point.cameras[0].target.abs_diff_eq(DVec3::new(3.05, 4.05, 5.05), 1e-9), "of media alone their boxes");
    let huge = load_text("m wall =\nrd .5\nv a =\np 1e300 0 0\nsph a 1e300\n");
    assert!(huge.scene.cameras.is_empty(), "beyond all measure: {:?}", huge.scene.cameras);
    let lamps = load_text(&lamp("3 4 5"));
    assert!(lamps.scene.cameras[0].target.abs_diff_eq(DVec3::new(3.0, 4.0, 5.0), 1e-9), "of lamps alone the lamps");
}

#[test]
fn what_the_default_camera_sees_is_no_fault() {
    let scene = load_text(&(walls("m wall =\nsides 2\nrd .5", 2.0) + &lamp("0 0 1.8"))).scene;
    assert_eq!(check_scene(&scene), []);
}
