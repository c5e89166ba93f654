//! Tests of file names, images, and errors that list all missing names.

use super::{all_output, test_folder};
use crate::common::{TestFolder, file_names, film, pixels, start_coordinator};

/// Returns the faults of a scene from `check --json`, as `line: message`.
fn faults(dir: &TestFolder, scene: &str) -> Vec<String> {
    let report = dir.run(&format!("check {scene} --json")).exits(1).json();
    let faults = report["faults"].as_array().expect("a list");
    assert_eq!(report["errors"].as_u64(), Some(faults.len() as u64));
    let text = |fault: &serde_json::Value| format!("{}: {}", fault["line"], fault["message"].as_str().expect("text"));
    faults.iter().map(text).collect()
}

/// Returns the mean red, green and blue of a rendered scene.
fn means(dir: &TestFolder, scene: &str) -> [f64; 3] {
    let out = scene.replace(".mgf", ".exr");
    dir.run(&format!("render {scene} -o out-{out} --spp 4")).exits(0);
    let values = film(&dir.path(&format!("out-{out}"))).rgb;
    let sum = |k: usize| values.iter().skip(k).step_by(3).map(|&value| f64::from(value)).sum::<f64>();
    [0, 1, 2].map(|k| sum(k) / (values.len() / 3) as f64)
}

/// Returns whether the means of a picture equal the expected ones up to sampling noise.
fn are_near(means: [f64; 3], wanted: [f64; 3], tolerance: f64) -> bool {
    means.iter().zip(wanted).all(|(mean, wanted)| (mean - wanted).abs() < tolerance)
}

#[test]
fn undefined_materials_are_all_listed_with_their_definition() {
    let dir = test_folder();
    let names = [(8, "oak"), (10, "slate"), (12, "chalk"), (14, "brass"), (16, "wool")];
    let listed = faults(&dir, "undefined.mgf");
    assert_eq!(listed.len(), 5, "{listed:?}");
    let ran = dir.run("check undefined.mgf").exits(1);
    for ((line, name), fault) in names.into_iter().zip(&listed) {
        assert!(
            fault.starts_with(&format!("{line}: undefined material `{name}`; define it before this line")),
            "{fault}"
        );
        assert!(fault.contains(&format!("`m {name} =` and `rd r`")), "{fault}");
        let shown = format!("undefined.mgf:{line}:3: error: undefined material `{name}`");
        assert!(ran.stdout().contains(&shown), "{}", ran.stdout());
    }
    assert!(ran.stdout().contains("undefined.mgf: 5 errors"), "{}", ran.stdout());
    // `render` prints the first error and where to find the others.
    let ran = dir.run("render undefined.mgf -o x.exr").exits(1);
    let wanted =
        ["undefined.mgf:8:3: undefined material `oak`", "; 4 more errors: `femc check undefined.mgf` lists them"];
    assert!(wanted.iter().all(|part| ran.stderr().contains(part)), "{}", ran.stderr());
    assert!(!ran.stderr().contains("slate"), "{}", ran.stderr());
}

#[test]
fn file_names_with_blanks_need_quotes_and_the_error_shows_them() {
    let dir = test_folder();
    for (scene, shown) in [
        (
            "blank-lamp.mgf",
            "blank-lamp.mgf:21:5: error: the file name `my lamp.ies` contains spaces; write it in double quotes: `ies \"my lamp.ies\"`",
        ),
        (
            "blank-include.mgf",
            "blank-include.mgf:1:3: error: the file name `my floor.mgf` contains spaces; write it in double quotes: `i \"my floor.mgf\"`",
        ),
        (
            "blank-texture.mgf",
            "blank-texture.mgf:5:9: error: the file name `my wood.png` contains spaces; write it in double quotes: `map_ed \"my wood.png\"`",
        ),
    ] {
        let ran = dir.run(&format!("check {scene}")).exits(1);
        assert!(ran.stdout().contains(shown), "{}", ran.stdout());
        assert!(ran.stdout().contains(": 1 error"), "{}", ran.stdout());
    }
}

/// Writes a scene with an include, a lamp and a texture whose names have blanks.
fn write_quoted_scene(dir: &TestFolder) {
    let lamp = dir.read("blank-lamp.mgf").replace("my lamp.ies", "\"my lamp.ies\"");
    let texture = dir.read("blank-texture.mgf").replace("my wood.png", "\"my wood.png\"");
    let (texture, _) = texture.split_once("camera").expect("a camera");
    dir.write("my picture.mgf", texture);
    dir.write("quoted.mgf", &format!("{lamp}\ni \"my picture.mgf\" -t -.5 -.5 .1\n"));
    dir.write(
        "plain.mgf",
        &dir.read("quoted.mgf")
            .replace("\"my lamp.ies\"", "lamp-points.ies")
            .replace("\"my picture.mgf\"", "picture.mgf"),
    );
    dir.write("picture.mgf", &texture.replace("\"my wood.png\"", "wood.png"));
    std::fs::copy(dir.path("my wood.png"), dir.path("wood.png")).expect("copied");
}

#[test]
fn quoted_names_give_the_pictures_of_plain_names() {
    let dir = test_folder();
    write_quoted_scene(&dir);
    let report = dir.run("check quoted.mgf --json").exits(0).json();
    assert_eq!(report["errors"], 0);
    dir.run("render quoted.mgf -o quoted.exr --spp 2").exits(0);
    dir.run("render plain.mgf -o plain.exr --spp 2").exits(0);
    assert_eq!(pixels(&dir.path("quoted.exr")), pixels(&dir.path("plain.exr")));
}

#[test]
fn files_whose_names_have_blanks_reach_the_workers_of_a_farm() {
    let dir = test_folder();
    write_quoted_scene(&dir);
    let (_farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    let ran = dir.run(&format!("submit quoted.mgf --spp 2 --server {url}")).exits(0);
    let job = ran.stdout().lines().last().expect("a job id").to_owned();
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o farm --server {url}")).exits(0);
    dir.run("render quoted.mgf -o alone.exr --spp 2").exits(0);
    let fetched = file_names(&dir.path("farm")).into_iter().find(|name| name.ends_with(".exr")).expect("a frame");
    assert_eq!(pixels(&dir.path("farm").join(fetched)), pixels(&dir.path("alone.exr")));
}

#[test]
fn what_a_png_says_of_its_values_is_used() {
    let dir = test_folder();
    for (scene, wanted) in [("png-linear.mgf", 0.5), ("png-cicp-linear.mgf", 0.5), ("png-plain.mgf", 0.214)] {
        let means = means(&dir, scene);
        assert!(are_near(means, [wanted; 3], 1e-3), "{scene}: {means:?}");
        let ran = dir.run(&format!("check {scene}"));
        assert!(!all_output(&ran).contains("texture"), "{}", all_output(&ran));
    }
}

#[test]
fn gray_exrs_and_channels_with_a_dot_are_read() {
    let dir = test_folder();
    // Ramps from 0 to 7/8, and a constant blue of 1/4.
    for (scene, wanted) in [("exr-gray-y.mgf", [0.4375; 3]), ("exr-dotted.mgf", [0.4375, 0.4375, 0.25])] {
        let ran = dir.run(&format!("check {scene}")).exits(0);
        assert!(ran.stdout().contains("0 warnings"), "{}", ran.stdout());
        let means = means(&dir, scene);
        assert!(are_near(means, wanted, 5e-3), "{scene}: {means:?}");
    }
}

#[test]
fn a_texture_above_1_on_a_reflectance_is_said_once() {
    let dir = test_folder();
    let text = dir.read("exr-gray-y.mgf").replace("\ted 3.14159265\n\tmap_ed", "\trd .5\n\tmap_rd");
    dir.write("factors.mgf", &text);
    let above = dir.run("check factors.mgf").exits(0);
    // The image from the bug reports stays below 1.
    assert!(!above.stdout().contains("values above 1"), "{}", above.stdout());
    dir.run("render exr-gray-y.mgf -o bright.exr --spp 1 --set material.picture.ed=1000").exits(0);
    dir.write(
        "factors.mgf",
        &format!("{}m twice =\n\trd .5\n\tmap_rd bright.exr\n", text.replace("gray-y.exr", "bright.exr")),
    );
    let above = dir.run("check factors.mgf --all").exits(0).stdout();
    assert_eq!(above.matches("reflectance factors above 1 are clamped to 1").count(), 1, "{above}");
}
