//! Tests of materials that must not return more light than they receive.

use super::{all_output, test_folder};
use crate::common::film;

/// Luminance of a lamp of 1000 lm/m2: 1000 / pi cd/m2. In a closed room without energy gain no pixel is brighter.
const LAMP: f32 = 1000.0 / std::f32::consts::PI;

#[test]
fn red_gloss_room_is_no_brighter_than_its_lamp_by_any_method() {
    let dir = test_folder();
    // The first pass is exact to a few percent.
    for (method, most) in [("pt", 1.005), ("fem", 1.03), ("femc", 1.005)] {
        let line = format!("render red-gloss.mgf -o {method}.exr --spp 16 --method {method} --json");
        let summary = dir.run(&line).exits(0).json();
        assert_eq!(summary["bad_samples"], 0, "{method}");
        let film = film(&dir.path(&format!("{method}.exr")));
        let luminance = |p: &[f32]| 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2];
        let brightest = film.rgb.chunks(3).map(luminance).fold(0.0, f32::max);
        assert!(film.rgb.iter().all(|x| x.is_finite()) && brightest <= most * LAMP, "{method}: {brightest}");
    }
}

#[test]
fn a_color_that_asks_for_more_light_than_there_is_is_said_once() {
    let ran = test_folder().run("check red-gloss.mgf").exits(0);
    assert_eq!(all_output(&ran).matches("2.758 times the red light").count(), 1, "{}", all_output(&ran));
}

/// A closed box whose walls emit light and reflect all of it: its light never converges, after any number of iterations.
const WHITE_BOX: &str = "camera main =\n origin .3 .2 .1\n target 1 .4 0\n fov 60\n film 16 16\nm wall =\n sides 2\n c\n rd 1\n\
    ed 3.14159265358979\nv a =\n p -1 -1 -1\nv b =\n p 1 -1 -1\nv c =\n p 1 1 -1\nv d =\n p -1 1 -1\nm wall\n\
    prism a b c d -2\n";

#[test]
fn untrusted_first_pass_fails_and_names_the_alternative() {
    let dir = test_folder();
    dir.write("white.mgf", WHITE_BOX);
    for method in ["fem", "femc"] {
        let ran = dir.run(&format!("render white.mgf -o {method}.exr --spp 4 --method {method}")).exits(1);
        let words = all_output(&ran);
        assert!(words.contains("solution cannot be trusted") && words.contains("use `--method pt`"), "{words}");
        assert!(!dir.path(&format!("{method}.exr")).exists());
    }
    // Path tracing needs no first pass, and the solution can still be viewed.
    dir.run("render white.mgf -o pt.exr --spp 4 --method pt --max-depth 20").exits(0);
    let report = dir.run("field white.mgf -o white.glb --json").exits(0).json();
    assert!(report["untrusted"].as_str().is_some_and(|reason| reason.contains("does not converge")), "{report}");
}
