//! Tests of `femc bottlenecks` with scenes that have a known bottleneck.

use crate::common::TestFolder;
use serde_json::Value;
use std::path::Path;

fn scene(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes").join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn real(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key} of {value}"))
}

/// Returns the findings for a frame of a scene.
fn bottlenecks(dir: &TestFolder, name: &str, text: &str, spp: u32) -> Value {
    dir.write(&format!("{name}.mgf"), text);
    dir.run(&format!("render {name}.mgf -o {name}.exr --size 64x48 --spp {spp} --stats")).exits(0);
    dir.run(&format!("bottlenecks {name}.paths --json")).exits(0).json()
}

fn finding<'a>(report: &'a Value, kind: &str) -> Option<&'a Value> {
    report["findings"].as_array().expect("a list").iter().find(|finding| finding["what"] == kind)
}

fn object<'a>(report: &'a Value, name: &str) -> &'a Value {
    let rows = report["objects"].as_array().expect("a list");
    rows.iter().find(|row| row["object"] == name).unwrap_or_else(|| panic!("{name} in {report}"))
}

#[test]
fn firefly_source_is_named_as_chrome_ball_but_not_when_matte() {
    let dir = TestFolder::new();
    let chrome = bottlenecks(&dir, "gallery", &scene("gallery.mgf"), 64);
    let noise = finding(&chrome, "noise").expect("noise");
    assert_eq!((&noise["object"], &noise["material"]), (&"sphere".into(), &"chrome".into()), "{noise}");
    assert_eq!(noise["interaction"], "reflection");
    assert!(real(noise, "noise") > 0.4 && real(noise, "light") < 0.05, "{noise}");
    let firefly = finding(&chrome, "firefly").expect("a firefly");
    assert_eq!(firefly["object"], "sphere", "{firefly}");
    assert!(real(firefly, "luminance") > 10.0 * real(firefly, "others"), "{firefly}");
    for list in ["parts", "objects", "materials"] {
        let rows = chrome[list].as_array().expect("a list");
        for share in ["noise", "light", "work", "deep", "begun"] {
            let sum: f64 = rows.iter().map(|row| real(row, share)).sum();
            assert!((sum - 1.0).abs() < 1e-6, "{share} of {list}: {sum}");
        }
    }
    let text = scene("gallery.mgf");
    let matte = bottlenecks(&dir, "matte", &text.replace("rs 0.9 0\n", "rd 0.7\n"), 64);
    assert_eq!(finding(&matte, "noise").expect("noise")["object"], "room");
    assert!(real(object(&matte, "sphere"), "noise") < 0.05, "{}", object(&matte, "sphere"));
    // In both frames together, the findings of the bright frame are the worst.
    let both = dir.run("bottlenecks matte.paths gallery.paths --json").exits(0).json();
    assert_eq!(both["samples"], 2 * 64 * 48 * 64);
    assert_eq!(finding(&both, "firefly").expect("a firefly")["file"], "gallery.paths");
    let said = dir.run("bottlenecks gallery.paths").exits(0).stdout();
    assert!(said.starts_with("noise:") && said.contains("sphere (chrome, reflection)"), "{said}");
    for (what, rows) in [("parts", "parts"), ("objects", "objects"), ("materials", "materials"), ("lamps", "lamps")] {
        let csv = dir.run(&format!("bottlenecks gallery.paths --of {what} --csv")).exits(0).stdout();
        assert_eq!(csv.lines().count(), 1 + chrome[rows].as_array().expect("a list").len(), "{what}");
    }
    assert!(dir.run("bottlenecks gallery.paths --of fireflies --lines 3").exits(0).stdout().lines().count() == 4);
}

#[test]
fn the_shade_of_glass_that_keeps_paths_long_is_named() {
    let dir = TestFolder::new();
    let report = bottlenecks(&dir, "pendant", &scene("pendant.mgf"), 16);
    let deep = finding(&report, "deep").expect("long paths");
    assert_eq!((&deep["object"], &deep["material"]), (&"pendant.shade".into(), &"glass".into()), "{deep}");
    assert!(real(deep, "left") > 4.0 * real(deep, "left_of_others"), "{deep}");
    assert!(real(deep, "depth") > 1.3 * real(deep, "depth_of_others"), "{deep}");
    assert!(real(deep, "begun") < 0.1, "it is small in the picture: {deep}");
    let others = report["objects"].as_array().expect("a list").iter();
    let others = others.filter(|row| row["object"] != "pendant.shade" && row["left"].is_f64());
    assert!(others.clone().count() >= 2);
    others.for_each(|row| assert!(real(row, "left") < 0.5 * real(deep, "left"), "{row}"));
}

#[test]
fn what_is_no_file_of_statistics_is_refused() {
    let dir = TestFolder::new();
    dir.run("bottlenecks").exits(2);
    assert!(dir.run("bottlenecks nothing.paths").exits(2).stderr().contains("nothing.paths"));
    dir.write("text.paths", "no statistics");
    dir.run("bottlenecks text.paths").exits(1);
}
