//! Tests of scenes with files outside the scene's folder.

use crate::common;
use crate::common::TestFolder;

/// Creates a folder with `fog.mgf` in a subfolder and its lamp in another one.
fn divided_scene() -> TestFolder {
    let dir = TestFolder::new();
    for folder in ["models/room", "models/lib"] {
        std::fs::create_dir_all(dir.path(folder)).expect("a folder");
    }
    let (room, lamp) = common::FOG.split_once("m lamp =").expect("a lamp");
    dir.write("models/room/room.mgf", &format!("{room}i ../lib/lamp.mgf\n"));
    dir.write("models/lib/lamp.mgf", &format!("m lamp ={lamp}"));
    dir
}

#[test]
fn a_scene_reads_what_lies_below_its_root_and_says_so() {
    let dir = divided_scene();
    for command in ["render", "plan", "check"] {
        let ran = dir.run(&format!("{command} models/room/room.mgf")).exits(1);
        // Errors of the scene are the result of `check`, so they are on stdout.
        let refused = if command == "check" { ran.stdout() } else { ran.stderr() };
        assert!(refused.contains("models/room/room.mgf:") && refused.contains("--root"), "{command}: {refused}");
    }
    let ran = dir.run("render models/room/room.mgf --root models --frames 1 --spp 1 -o a.exr").exits(0);
    let warning = "models/room/room.mgf:15: `lib/lamp.mgf` is outside the scene's folder";
    assert!(ran.stderr().contains(warning), "{}", ran.stderr());
    dir.run("render fog.mgf --frames 1 --spp 1 -o b.exr").exits(0);
    let same = dir.run("compare a.exr b.exr --json").exits(0).json();
    assert_eq!(same["mse"], 0.0, "{same}");
    dir.run("plan models/room/room.mgf --root . --spp 1 --no-trial").exits(0);
    let report = dir.run("check models/room/room.mgf --root models --json").exits(0).json();
    assert!(report.to_string().contains("lib/lamp.mgf"), "{report}");
}

#[test]
fn job_file_sets_its_root_and_a_wrong_root_is_wrong_usage() {
    let dir = divided_scene();
    dir.write("models/job.toml", "scene = \"room/room.mgf\"\nroot = \".\"\nspp = 1\nframes = \"1\"\n");
    dir.run("render models/job.toml -o a.exr").exits(0);
    for (root, says) in [("models/lib", "not below the root folder"), ("nowhere", "--root nowhere: no such folder")] {
        let refused = dir.run(&format!("plan models/room/room.mgf --root {root}")).exits(2).stderr();
        assert!(refused.contains(says), "{refused}");
    }
}

/// Returns a house of one-sided walls whose fronts face outward, with the lamp outside and the camera inside, and ten plates on top
/// of each other.
fn odd_house() -> String {
    let walls = "camera main =\norigin 0 -1 1\ntarget 0 1 .5\nm wall =\nsides 1\nrd .5\nv a =\np -2 -2 4\nv b =\np 2 -2 4\n\
                 v c =\np 2 2 4\nv d =\np -2 2 4\nprism a b c d 4\nm lamp =\nsides 1\ned 1000\nv l =\np 0 0 9\nsph l .1\n";
    let plates = "v e =\np -1 -1 .1\nv f =\np 1 -1 .1\nv g =\np 1 1 .1\nv h =\np -1 1 .1\nm plate =\nsides 2\nrd .5\n";
    format!("{walls}{plates}{}", "f e f g h\n".repeat(10))
}

#[test]
fn check_summarizes_warnings_by_kind_bounds_and_lamp_flux() {
    let dir = TestFolder::new();
    dir.write("house.mgf", &odd_house());
    let said = dir.run("check house.mgf").exits(0).stdout();
    let line = |of: &str| said.lines().filter(|line| line.contains(of)).map(str::to_owned).collect::<Vec<_>>();
    let overlaps = line("overlapping-faces");
    assert!(overlaps.len() == 1 && overlaps[0].starts_with("house.mgf:"), "{said}");
    assert!(overlaps[0].contains("45 (overlapping-faces)") && overlaps[0].contains("--all lists them"), "{said}");
    assert!(line("light enters through the back")[0].starts_with("house.mgf:15: warning: "), "{said}");
    assert_eq!(line("bounds:"), ["bounds: 4 x 4 x 9.1 m, from -2 -2 0 to 2 2 9.1"]);
    // 1000 lm/m2 from 4 pi 0.01 m2.
    assert_eq!(line("lamps:"), ["lamps: 1, 126 lm in all"]);
    assert_eq!(line("material lamp"), ["1      126      0.1257   material lamp  house.mgf:21"]);
    let all = dir.run("check house.mgf --all").exits(0).stdout();
    assert_eq!(all.lines().filter(|line| line.contains("the face overlaps")).count(), 45, "{all}");
    assert!(dir.run("check house.mgf --quiet").exits(0).stdout().is_empty());
}

#[test]
fn a_checks_kinds_bounds_and_lamps_are_in_its_json() {
    let dir = TestFolder::new();
    let lamp = "IESNA91\nTILT=NONE\n1 1000 2 2 1 1 2 0 0 0 1 1 100\n0 180 0 100 100\n";
    dir.write("lamp.ies", lamp);
    dir.write("house.mgf", &(odd_house() + "ies lamp.ies -m .5 -t 0 0 8\nies lamp.ies -m .5 -t 1 0 8\n"));
    let report = dir.run("check house.mgf --json").exits(0).json();
    let kinds = report["kinds"].as_array().expect("kinds");
    let overlaps = kinds.iter().find(|kind| kind["kind"] == "overlapping-faces").expect("overlaps");
    assert_eq!((overlaps["count"].as_u64(), overlaps["places"][0].as_str()), (Some(45), Some("house.mgf:34")));
    assert_eq!(
        report["faults"].as_array().map(Vec::len),
        kinds.iter().map(|kind| kind["count"].as_u64().map(|n| n as usize)).sum()
    );
    assert_eq!(report["bounds"]["max"], serde_json::json!([2.0, 2.0, 9.1]));
    let [_, ies] = report["lamps"].as_array().expect("lamps").as_slice() else { panic!("two kinds: {report}") };
    assert_eq!(
        (ies["kind"].as_str(), ies["name"].as_str(), ies["count"].as_u64()),
        (Some("ies"), Some("lamp.ies"), Some(2))
    );
    // 200 cd (multiplier 2) in all directions, halved by -m.
    let lumens = ies["lumens"].as_f64().expect("a number");
    assert!((lumens / (4.0 * std::f64::consts::PI * 100.0) - 1.0).abs() < 1e-3, "{lumens}");
}

#[test]
fn the_camera_of_a_scene_without_one_is_a_note_of_its_check() {
    let dir = TestFolder::new();
    dir.write("blind.mgf", "m lamp =\n\ted 1\nv a =\n\tp 0 0 0\nsph a 1\n");
    let said = dir.run("check blind.mgf").exits(0).stdout();
    assert!(
        said.contains("blind.mgf: note: the scene has no camera: `default`") && said.contains("0 warnings"),
        "{said}"
    );
}

#[test]
fn many_scene_warnings_print_the_first_and_point_to_the_rest() {
    let dir = TestFolder::new();
    let odd = "c\ncspec 380 780 1 1 1 1 1 1 1 -1\n".repeat(100);
    dir.write("odd.mgf", &(odd + common::FOG));
    let said = dir.run("plan odd.mgf --spp 1 --no-trial").exits(0).stderr();
    assert_eq!(said.lines().filter(|line| line.contains("has a negative value")).count(), 1, "{said}");
    assert!(said.contains("96 more places; `femc check odd.mgf --all` lists them"), "{said}");
    let check = dir.run("check odd.mgf").exits(0).stdout();
    let lines: Vec<&str> = check.lines().filter(|line| line.contains("has a negative value")).collect();
    assert!(lines.len() == 1 && lines[0].starts_with("odd.mgf:2: warning: 100 (negative-spectrum)"), "{check}");
}
