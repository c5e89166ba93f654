//! Phase functions close to a delta, with a lamp as small as their peak, so that half of the light that is scattered once hits it.
//!
//! The camera looks through fog at the center of a ball. The direct light is L e^-d. Light that is scattered once, at distance s,
//! comes from the ball: its fraction is the integral of the phase function over the ball's angle there. It crosses an equal
//! thickness of fog.

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use super::quadrature::integral;
use crate::text::{camera, material};
use std::f64::consts::PI;

/// Optical thickness of the fog, followed by its albedo and the distance of the ball.
const OPTICAL_THICKNESS: f64 = 1.0;
const ALBEDO: f64 = 0.9;
const LAMP_DISTANCE: f64 = 2.0;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let mut cases = Vec::new();
    for peak in [0.1, 1e-2, 1e-3, 1e-4, 1e-5] {
        let parameter = 1.0 - peak;
        // Half of Henyey-Greenstein's peak lies within about 1 - g, half of Schlick's within about sqrt(2 (1 - k)).
        cases.push(lamp(&format!("hg {parameter}"), 1.0 * peak, |angle| henyey_greenstein(parameter, angle)));
        let wide = (2.0 * peak).sqrt();
        cases.push(lamp(&format!("schlick {parameter}"), wide.min(0.4), |angle| schlick(parameter, angle)));
    }
    measure_all("peaks", &cases, effort, report);
}

fn lamp(phase: &str, angle: f64, fraction_within: impl Fn(f64) -> f64) -> Case {
    let radius = LAMP_DISTANCE * angle;
    // The field of view is a hundredth of the ball's angle.
    let view = camera("0 0 0", "1 0 0", 0.01 * angle.to_degrees()).replace("up .1 .2 .9", "up 0 0 1");
    let fog = format!("medium fog =\n sigma_s {ALBEDO}\n sigma_a {}\n phase {phase}\n", 1.0 - ALBEDO);
    let lamp = material("lamp", &["sides 1", &format!("ed {PI}")]);
    // Scattered light crosses the same thickness of fog as direct light: paths to the ball are longer only by the square of small
    // angles.
    let text = format!(
        "{view}{fog}mbox fog 0 -9 -9 {OPTICAL_THICKNESS} 9 9\n{lamp}v o =\n p {} 0 0\nm lamp\nsph o {radius}\n",
        LAMP_DISTANCE + radius
    );
    let share =
        integral(0.0, OPTICAL_THICKNESS, 64, |s| fraction_within((radius / (LAMP_DISTANCE + radius - s)).asin()));
    let truth = (-OPTICAL_THICKNESS).exp() * (1.0 + ALBEDO * share);
    Case::new(format!("a lamp of {angle:.1e} rad through fog of phase {phase}"), text, truth)
        .with_max_depth(2)
        .with_slack(1e-4 + 0.3 * angle * angle)
}

/// Returns the fraction within an angle of the forward direction.
fn henyey_greenstein(g: f64, angle: f64) -> f64 {
    let versine = 2.0 * (0.5 * angle).sin().powi(2);
    let chord = ((1.0 - g).powi(2) + 2.0 * g * versine).sqrt();
    (1.0 - g * g) / (2.0 * g) * (1.0 / (1.0 - g) - 1.0 / chord)
}

fn schlick(k: f64, angle: f64) -> f64 {
    let versine = 2.0 * (0.5 * angle).sin().powi(2);
    (1.0 - k * k) / (2.0 * k) * (1.0 / (1.0 - k) - 1.0 / (1.0 - k + k * versine))
}
