//! Tests of LM-63 files whose flux depends on the edition, on separators or on the encoding.

use super::{all_output, test_folder};
use crate::common::TestFolder;
use serde_json::Value;

/// Returns the lumens of the only lamp of a scene, and the whole output of `check`.
fn lumens(dir: &TestFolder, scene: &str) -> (f64, Value) {
    let report = dir.run(&format!("check {scene} --json")).exits(0).json();
    let [lamp] = report["lamps"].as_array().expect("lamps").as_slice() else { panic!("one lamp: {report}") };
    (lamp["lumens"].as_f64().expect("a number"), report)
}

fn assert_lumens(dir: &TestFolder, scene: &str, expected: f64) {
    let (lumens, report) = lumens(dir, scene);
    assert!((lumens - expected).abs() < 0.01, "{scene}: {lumens} lm, not {expected} lm");
    assert_eq!((&report["warnings"], &report["notes"]), (&Value::from(0), &Value::from(0)), "{scene}: {report}");
}

#[test]
fn field_after_ballast_factor_scales_in_1991_but_not_in_2019() {
    let dir = test_folder();
    assert_lumens(&dir, "flux-2019.mgf", 2285.84);
    assert_lumens(&dir, "flux-1991.mgf", 2514.43);
}

#[test]
fn a_reserved_field_that_is_not_1_is_a_warning_and_no_factor() {
    let dir = test_folder();
    let file = std::fs::read_to_string(dir.path("lamp-1991.ies")).expect("a file");
    for line in ["IESNA:LM-63-1995", "IESNA:LM-63-2002"] {
        dir.write("lamp-1991.ies", &file.replace("IESNA91", line));
        let (lumens, report) = lumens(&dir, "flux-1991.mgf");
        assert!((lumens - 2285.84).abs() < 0.01, "{line}: {lumens} lm");
        let [fault] = report["faults"].as_array().expect("faults").as_slice() else { panic!("one fault: {report}") };
        let year = &line[line.len() - 4..];
        let message = fault["message"].as_str().expect("a message");
        assert!(message.contains(&format!("is 1.1: the edition of {year} reserves it")), "{message}");
        assert_eq!((&fault["severity"], &fault["line"]), (&Value::from("warning"), &Value::from(5)), "{fault}");
    }
}

#[test]
fn decimal_commas_are_named_and_commas_that_separate_work() {
    let dir = test_folder();
    assert_lumens(&dir, "flux-points.mgf", 2547.94);
    assert_lumens(&dir, "flux-separators.mgf", 2547.94);
    let said = all_output(&dir.run("check flux-commas.mgf").exits(1));
    assert!(said.contains("lamp-commas.ies:8:1: error: `1200,5`: decimal commas are not supported"), "{said}");
    assert!(said.contains("write decimal points"), "{said}");
}

#[test]
fn old_line_ends_utf_16_and_boms_are_read_in_lamps_and_scenes() {
    let dir = test_folder();
    for scene in ["flux-cr.mgf", "flux-utf16.mgf", "flux-bom.mgf", "scene-cr.mgf", "scene-utf16.mgf"] {
        assert_lumens(&dir, scene, 2547.94);
    }
    let bounds = |scene: &str| dir.run(&format!("check {scene} --json")).exits(0).json()["bounds"].clone();
    let expected = bounds("flux-points.mgf");
    assert!(expected["min"][0] == -2.0, "{expected}");
    assert_eq!([bounds("scene-cr.mgf"), bounds("scene-utf16.mgf")], [expected.clone(), expected]);
}

#[test]
fn what_follows_the_last_intensity_is_an_error() {
    let dir = test_folder();
    let file = std::fs::read_to_string(dir.path("lamp-points.ies")).expect("a file");
    dir.write("lamp-points.ies", &format!("{file}END\n"));
    assert_lumens(&dir, "flux-points.mgf", 2547.94);
    dir.write("lamp-points.ies", &format!("{file}0.5\n"));
    let said = all_output(&dir.run("check flux-points.mgf").exits(1));
    assert!(said.contains("lamp-points.ies:9:1: error: 1 number follows the last intensity"), "{said}");
}

#[test]
fn a_file_of_exactly_1000_lumens_has_a_hint_unless_it_is_scaled() {
    let dir = test_folder();
    let file = std::fs::read_to_string(dir.path("lamp-point.ies")).expect("a file");
    dir.write("lamp-point.ies", &file.replace("100 100", "79.577 79.577"));
    let scene = "ies lamp-point.ies -t 0 0 2\n";
    dir.write("hint.mgf", scene);
    let checked = all_output(&dir.run("check hint.mgf").exits(0));
    assert!(checked.contains("lamp-point.ies:4: note: the flux of this file is exactly 1000 lm"), "{checked}");
    assert!(checked.contains("as in `ies FILE -m 2.5` for 2500 lm"), "{checked}");
    let rendered = all_output(&dir.run("render hint.mgf -o hint.exr --size 4x4 --spp 1").exits(0));
    assert!(rendered.contains("note: lamp-point.ies:4: the flux of this file is exactly 1000 lm"), "{rendered}");
    dir.write("hint.mgf", &scene.replace(".ies", ".ies -m 2.5"));
    let (lumens, report) = lumens(&dir, "hint.mgf");
    assert!((lumens - 2500.0).abs() < 1.0 && !report.to_string().contains("1000 lm"), "{report}");
}
