//! Tests of light paths: walls that let light in from behind, cameras in the dark, scenes that light never leaves.

use femc_import::{Bundle, load_scene};
use femc_math::glam::DVec3;
use femc_scene::{FaultKind, LampKind, Severity, check_scene, survey_scene};
use std::collections::BTreeMap;
use std::f64::consts::PI;

fn scene(text: &str) -> femc_scene::Scene {
    let files = BTreeMap::from([("t.mgf".to_owned(), text.as_bytes().to_vec())]);
    load_scene(&Bundle(files), "t.mgf").unwrap_or_else(|error| panic!("{error}")).scene
}

/// Returns a scene with a camera in a box of 4 m. The box has this wall material with fronts facing out, and a lamp at `lamp`; a
/// plate stands in the box.
fn house(wall: &str, lamp: &str) -> String {
    format!(
        "camera main =\norigin 0 -1 1\ntarget 0 1 0.5\nm wall =\n{wall}\n\
         v a =\np -2 -2 4\nv b =\np 2 -2 4\nv c =\np 2 2 4\nv d =\np -2 2 4\nprism a b c d 4\n\
         m plate =\nsides 2\nrd .5\nv e =\np -1 -1 .1\nv f =\np 1 -1 .1\nv g =\np 1 1 .1\nv h =\np -1 1 .1\nf e f g h\n\
         m lamp =\nsides 1\ned 1000\nv l =\np {lamp}\nsph l .1\n"
    )
}

fn fault_lines(text: &str) -> Vec<(FaultKind, Severity, u32)> {
    check_scene(&scene(text)).iter().map(|fault| (fault.kind, fault.severity, fault.location.line)).collect()
}

#[test]
fn one_sided_wall_leaking_light_from_behind_is_named_by_line() {
    let found = fault_lines(&house("sides 1\nrd .5", "0 0 9"));
    assert_eq!(found, [(FaultKind::OneSidedWall, Severity::Warning, 15)]);
    assert_eq!(fault_lines(&house("sides 1\nrd .5", "0 0 3")), [], "the lamp is in the house");
}

#[test]
fn looking_into_a_room_through_the_backs_of_its_walls_is_meant() {
    let cut_away =
        house("sides 1\nrd .5", "0 0 3").replace("prism a b c d 4", "prism a b c d -4").replace("2 4\n", "2 0\n");
    let outside = cut_away.replace("origin 0 -1 1", "origin 0 -9 5");
    let found = fault_lines(&outside);
    assert!(found.iter().all(|fault| fault.0 != FaultKind::OneSidedWall), "{found:?}");
}

#[test]
fn a_camera_in_a_solid_that_no_light_gets_into_is_named() {
    let found = fault_lines(&house("sides 2\nrd .5", "0 0 9"));
    assert_eq!(found, [(FaultKind::Camera, Severity::Warning, 1)]);
    assert_eq!(fault_lines(&house("sides 2\nrd .5", "0 0 3")), []);
    assert_eq!(fault_lines(&house("sides 2\nrd .4\ntd .2", "0 0 9")), [], "paper lets light in");
}

#[test]
fn closed_scene_is_reported_only_if_nothing_absorbs() {
    let white = house("sides 2\nrd 1", "0 0 3").replace("sides 2\nrd .5", "sides 2\nrd 1");
    let white = white.replace("ed 1000", "ed 1000\nrd 1");
    assert_eq!(fault_lines(&white), [(FaultKind::EnergyTrap, Severity::Warning, 1)]);
    assert_eq!(fault_lines(&white.replacen("rd 1", "rd .99", 1)), []);
    let fog = white.replace("m wall =", "medium fog =\nsigma_a .01\nmbox fog -1 -1 1 1 1 2\nm wall =");
    assert_eq!(fault_lines(&fog), []);
    let open = white.replace("prism a b c d 4", "f a b c d");
    assert!(fault_lines(&open).iter().all(|fault| fault.0 != FaultKind::EnergyTrap));
}

#[test]
fn equal_lamps_are_one_line_with_the_flux_of_each() {
    let text = "m strip =\nsides 1\ned 1000\nv a =\np 0 0 3\nv b =\np 0 1 3\nv c =\np 2 1 3\nv d =\np 2 0 3\nv e =\np 4 1 3\nv f =\np 4 0 3\n\
                f a b c d\nf d c e f\nxf -t 10 0 0 -a 2 -t 0 5 0\nf a b c d\nxf\n\
                m bulb =\nsides 1\ned 500\nv p =\np 0 0 9\nsph p .5\n\
                m tube =\nsides 2\ned 10\nv q =\np 0 9 0\nv r =\np 0 9 2\ncyl q .1 r\n\
                medium gas =\nglow 3\nmbox gas 20 0 0 22 1 1\n";
    let survey = survey_scene(&scene(text), &|_| 0.0);
    let shown: Vec<_> = survey.lamps.iter().map(|lamp| (lamp.kind.clone(), lamp.count, lamp.location.line)).collect();
    let surface = |material: &str| LampKind::Surface { material: material.into() };
    let gas = LampKind::Medium { medium: "gas".into() };
    let lines = [(surface("strip"), 1, 16), (surface("strip"), 2, 19), (surface("bulb"), 1, 26)];
    assert_eq!(shown[..3], lines, "faces that touch are one lamp");
    assert_eq!(shown[3..], [(surface("tube"), 1, 34), (gas, 1, 37)]);
    let wanted = [4000.0, 2000.0, 500.0 * PI, 2.0 * 10.0 * PI * 0.2 * 2.0, 6.0];
    for (lamp, wanted) in survey.lamps.iter().zip(wanted) {
        assert!((lamp.lumens / wanted - 1.0).abs() < 1e-9, "{lamp:?}");
    }
    let [min, max] = survey.bounds.expect("bounds");
    assert!(min.abs_diff_eq(DVec3::new(-0.5, -0.5, 0.0), 1e-9), "{min}");
    assert!(max.abs_diff_eq(DVec3::new(12.0, 9.1, 9.5), 1e-9), "the medium is not a surface: {max}");
}

#[test]
fn a_free_standing_one_sided_mirror_is_no_wall() {
    let mirror = "m mirror =\nsides 1\nrs .9 0\nv i =\np -1 1.5 1\nv j =\np -1 1.5 2\nv k =\np 1 1.5 2\nv n =\np 1 1.5 1\nf n k j i\n";
    let found = fault_lines(&(house("sides 2\nrd .5", "0 0 3") + mirror));
    assert!(found.iter().all(|fault| fault.0 != FaultKind::OneSidedWall), "{found:?}");
}
