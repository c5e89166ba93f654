//! Closed rooms of uniform radiance with a medium: the mean is that radiance if the medium emits as much as it absorbs.

use super::ResultLine;
use super::furnace::sigma;
use super::measure::{Case, Effort, measure_all};
use super::room::furnace;
use std::f64::consts::PI;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let mut cases = thicknesses();
    cases.extend(glows());
    cases.extend(phases());
    measure_all("media", &cases, effort, report);
}

/// Returns a medium of extinction `sigma_t`, 1/m, and this albedo. Its glow is that of a room of luminance 1.
fn gas(sigma_t: f64, albedo: f64, more: &str) -> String {
    let sigma_a = sigma_t * (1.0 - albedo);
    format!("medium gas =\n sigma_s {}\n sigma_a {sigma_a}\n glow {}\n{more}", sigma_t * albedo, 4.0 * PI * sigma_a)
}

/// Rooms 2 m across, with optical thicknesses from 1e-6 to 1e4.
fn thicknesses() -> Vec<Case> {
    let mut cases = Vec::new();
    for albedo in [0.0, 0.5, 0.999, 1.0] {
        for thickness in [1e-6, 1e-3, 1.0, 1e2, 1e4] {
            // Light leaves fog that absorbs nothing only at the walls: after some 1e4 events here, some 1e8 in the thickest.
            if albedo == 1.0 && thickness > 1e2 {
                continue;
            }
            let text = furnace(1.0, 1.0, 0.5) + &gas(0.5 * thickness, albedo, "") + "mglobal gas\n";
            let case = Case::new(format!("optical thickness {thickness:e}, albedo {albedo}"), text, 1.0);
            let case = case.with_sigma(sigma(albedo));
            // Paths have a thousand events and more. A standard error of 1e-3 would take ten minutes each.
            cases.push(if albedo > 0.9 && thickness > 1.0 { case.with_sigma(5e-3).as_long() } else { case });
        }
    }
    for (name, density) in [("thins with height", "height -.5 .3"), ("thins within a millimeter", "height 0 1e-3")] {
        let text = furnace(1.0, 1.0, 0.5) + &gas(5.0, 0.5, &format!(" density {density}\n")) + "mglobal gas\n";
        cases.push(Case::new(format!("gas that {name}"), text, 1.0).with_sigma(1e-3));
    }
    let boxes = "mbox gas -.5 -.5 -.5 .5 .5 .5\nmbox gas 0 0 0 2 2 2\nmbox gas .3 .2 .1 .3000001 .9 .9\n";
    cases.push(Case::new(
        "boxes that overlap, one of them a sheet",
        furnace(1.0, 1.0, 0.5) + &gas(3.0, 0.5, "") + boxes,
        1.0,
    ));
    cases
}

/// Gas in front of a black sphere of 1 m around the camera: 1 - exp(-thickness).
fn glows() -> Vec<Case> {
    let glow = |thickness: f64| {
        let black = "m wall =\n sides 2\nm wall\nv o =\n p 0 0 0\nsph o 1\n";
        let view = crate::text::camera("0 0 0", "1 0 0", 60.0);
        let text = view + black + &gas(thickness, 0.0, "") + "mglobal gas\n";
        Case::new(format!("glow of optical thickness {thickness:e}"), text, -(-thickness).exp_m1()).with_sigma(1e-4)
    };
    [1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4].map(glow).into()
}

/// Phase functions up to nearly a delta.
fn phases() -> Vec<Case> {
    let mut phases = vec!["rayleigh".to_owned()];
    for parameter in [0.9, 0.99, 0.999, 0.9999, 0.99999, 0.9999999, 0.9999999999] {
        for sign in ["", "-"] {
            phases.push(format!("hg {sign}{parameter}"));
            phases.push(format!("schlick {sign}{parameter}"));
        }
    }
    let mut cases = Vec::new();
    for phase in phases {
        let text = furnace(1.0, 1.0, 0.5) + &gas(1.5, 1.0, &format!(" phase {phase}\n")) + "mglobal gas\n";
        cases.push(Case::new(format!("phase {phase}"), text, 1.0));
    }
    cases
}
