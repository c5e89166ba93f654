//! Lamps with known form factors (algorithm brief, T4), from 1e-4 to 1e3 m and from 1e-10 to 1e10 cd/m2.

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use crate::text::{camera, horizontal_square, material, quad};
use std::f64::consts::PI;

const RHO: f64 = 0.6;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let mut cases = Vec::new();
    for size in [1e-4, 1e-2, 1.0, 1e3] {
        for radiance in [1e-10, 1.0, 1e10] {
            cases.extend([ball(size, radiance), disc(size, radiance), square(size, radiance), tilted(size, radiance)]);
        }
    }
    cases.extend([0.0, 0.5, 0.9].map(cap));
    measure_all("lamps", &cases, effort, report);
}

/// Returns a floor seen vertically from 1 cm above, and a lamp: `text` uses a material `lamp` of 1e-10 to 1e10 cd/m2.
fn floor_under(radiance: f64, text: &str) -> String {
    // The camera sees less than a micrometer, where light from a lamp 1 m away is constant.
    let view = camera("0 -1e-4 .01", "0 0 0", 0.01);
    let floor = material("floor", &["sides 2", &format!("rd {RHO}")]) + &horizontal_square("floor", [0.0; 3], 0.5);
    view + &floor + &material("lamp", &["sides 2", &format!("ed {}", PI * radiance)]) + text
}

fn case(shape: &str, size: f64, radiance: f64, text: &str, form_factor: f64) -> Case {
    let name = format!("{shape} of {size:e} m and {radiance:e} cd/m2");
    let slack = 1e-4;
    Case::new(name, floor_under(radiance, text), RHO * radiance * form_factor).with_slack(slack)
}

/// Sphere above the horizon: (R/d)^2.
fn ball(r: f64, radiance: f64) -> Case {
    let d = 2.0 + r;
    case("ball", r, radiance, &format!("v o =\n p 0 0 {d}\nm lamp\nsph o {r}\n"), (r / d).powi(2))
}

/// Sphere off the normal: (R/d)^2 cos.
fn tilted(r: f64, radiance: f64) -> Case {
    let d = 4.0 * r + 2.0;
    let at = [0.6 * d, 0.0, 0.8 * d];
    let text = format!("v o =\n p {} {} {}\nm lamp\nsph o {r}\n", at[0], at[1], at[2]);
    case("ball aside", r, radiance, &text, 0.8 * (r / d).powi(2))
}

/// Coaxial disc: R^2 / (R^2 + h^2).
fn disc(r: f64, radiance: f64) -> Case {
    let h = 1.0;
    let text = format!("v o =\n p 0 0 {h}\n n 0 0 -1\nm lamp\nring o 0 {r}\n");
    case("disc", r, radiance, &text, r * r / (r * r + h * h))
}

/// Square of half side a, vertically above at height h: the sum of four equal form factors of a corner, each a quarter of (2/pi)
/// X/sqrt(1+X^2) atan(X/sqrt(1+X^2)), X = a/h.
fn square(a: f64, radiance: f64) -> Case {
    let s = a / (1.0 + a * a).sqrt();
    let corners = [[-a, -a], [-a, a], [a, a], [a, -a]].map(|[x, y]| format!("{x} {y} 1"));
    let text = quad("lamp", corners.each_ref().map(String::as_str));
    case("square", a, radiance, &text, 4.0 / PI * s * s.atan())
}

/// Disc at height h in a sphere of 1 m. Seen from every point of the sphere below it, its form factor is the fraction of the
/// sphere's area behind it.
fn cap(h: f64) -> Case {
    let view = camera("0 0 -.9", ".3 .1 -.99", 60.0);
    let sphere = material("wall", &["sides 2", &format!("rd {RHO}")]) + "v o =\n p 0 0 0\nm wall\nsph o 1\n";
    let lamp = material("lamp", &["sides 2", &format!("ed {PI}")]);
    let r = (1.0 - h * h).sqrt();
    let text = format!("{view}{sphere}{lamp}v l =\n p 0 0 {h}\n n 0 0 -1\nm lamp\nring l 0 {r}\n");
    Case::new(format!("disc in a sphere, at {h} m"), text, RHO * 0.5 * (1.0 - h)).with_max_depth(2).with_slack(1e-5)
}
