//! Tests of scenes loaded from text: the inputs of the hash, and faults at the lines of the file.

use femc_import::{Bundle, load_scene};
use femc_scene::{FaultKind, Scene, check_scene};
use std::collections::BTreeMap;

fn scene(files: &[(&str, &str)]) -> Scene {
    let files: BTreeMap<String, Vec<u8>> =
        files.iter().map(|(name, text)| (name.to_string(), text.as_bytes().to_vec())).collect();
    load_scene(&Bundle(files), "main.mgf").unwrap_or_else(|error| panic!("{error}")).scene
}

const SCENE: &str = "\
c
m lamp =
    ed 1000
    sides 1
m floor =
    rd .5
medium fog =
    sigma_s .02
mglobal fog
camera main =
    origin 0 -5 1
    target 0 0 0
v a =
    p -2 -2 0
v b =
    p 2 -2 0
v c =
    p 2 2 0
v d =
    p -1 -1 2
v e =
    p 0 1 2
v f =
    p 1 -1 2
f a b c
m lamp
f d e f
time 0 1 10
vary medium.fog.sigma_s = 0 .02 1 .05
";

#[test]
fn comments_blanks_and_includes_keep_the_hash_but_values_do_not() {
    let plain = scene(&[("main.mgf", SCENE)]).digest();
    let commented = SCENE.replace("    rd .5\n", "# a remark\n\n      rd \\\n   0.50\n");
    assert_eq!(scene(&[("main.mgf", &commented)]).digest(), plain);
    let (start, rest) = SCENE.split_at(SCENE.find("medium fog").unwrap());
    let including = format!("i part.mgf\n{rest}");
    assert_eq!(scene(&[("main.mgf", &including), ("part.mgf", start)]).digest(), plain);
    let brighter = SCENE.replace("ed 1000", "ed 1001");
    assert_ne!(scene(&[("main.mgf", &brighter)]).digest(), plain);
}

#[test]
fn a_sound_text_has_no_fault_and_its_selectors_work() {
    let scene = scene(&[("main.mgf", SCENE)]);
    assert_eq!(check_scene(&scene), []);
    assert!((scene.scalars_at(0.5).unwrap().media[0].sigma_s - 0.035).abs() < 1e-15);
    assert_eq!((scene.frame_count(), scene.get("material.floor.rd")), (11, Ok(0.5)));
}

#[test]
fn a_fault_stands_at_its_line_of_its_file() {
    let doubled = format!("{SCENE}m floor\nf a b c\n");
    let faulty = scene(&[("main.mgf", &doubled)]);
    let shown: Vec<String> = check_scene(&faulty).iter().map(|fault| fault.display(&faulty).to_string()).collect();
    assert_eq!(shown.len(), 1, "{shown:#?}");
    assert!(
        shown[0].starts_with("main.mgf:31: warning: the face overlaps the one at main.mgf:25 on 8.00 m2, both"),
        "{}",
        shown[0]
    );
    assert_eq!(check_scene(&faulty)[0].kind, FaultKind::OverlappingFaces);
}
