//! Materials that must not return more light than they receive.

use super::{place, said};
use crate::common::film;

/// A lamp of 1000 lm/m2 has 1000 / pi cd/m2: no pixel of a closed room that gains nothing is brighter.
const LAMP: f32 = 1000.0 / std::f32::consts::PI;

#[test]
fn a_room_in_saturated_red_gloss_is_no_brighter_than_its_lamp_by_any_method() {
    let place = place();
    for method in ["pt", "fem", "femc"] {
        let line = format!("render red-gloss.mgf -o {method}.exr --spp 16 --method {method} --json");
        let summary = place.run(&line).exits(0).json();
        assert_eq!(summary["bad_samples"], 0, "{method}");
        let film = film(&place.path(&format!("{method}.exr")));
        let luminance = |p: &[f32]| 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2];
        let brightest = film.rgb.chunks(3).map(luminance).fold(0.0, f32::max);
        assert!(film.rgb.iter().all(|x| x.is_finite()) && brightest <= 1.005 * LAMP, "{method}: {brightest}");
    }
}

#[test]
fn a_color_that_asks_for_more_light_than_there_is_is_said_once() {
    let ran = place().run("check red-gloss.mgf").exits(0);
    assert_eq!(said(&ran).matches("2.758 times the red light").count(), 1, "{}", said(&ran));
}
