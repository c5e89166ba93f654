//! Direct light of the first pass from lamps that stand across the horizon of the elements that they light. The light of the part
//! above the horizon is known in closed form.

use crate::layers::scene;
use femc_math::color::luminance;
use femc_math::elementary::double::{acos, atan, sin_cos};
use femc_math::glam::DVec3;
use femc_pipeline::radiosity::{SolveOptions, solve};
use femc_pipeline::{Form, SceneSource, Settings, Side, prepare_world};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Emittance of the lamps, lm/m2.
const EMITTANCE: f64 = 100.0;

/// Returns the form factor from a horizontal point to a ball across its horizon or above it (\[howell2010\]).
/// - `center`: from the point to the center, relative to the radius.
fn ball_form_factor(center: DVec3) -> f64 {
    let (distance2, cos) = (center.length_squared(), center.z / center.length());
    if center.z.abs() >= 1.0 {
        return (cos / distance2).max(0.0);
    }
    let (x, sin) = ((distance2 - 1.0).sqrt(), (1.0 - cos * cos).sqrt());
    let y = -x * cos / sin;
    let across = sin * (1.0 - y * y).sqrt();
    ((cos * acos(y) - x * across) / distance2 + atan(across / x)) / PI
}

/// Returns the form factor from a horizontal point at the origin to the part of a polygon above the horizon, by Lambert's contour
/// integral, without a sign.
fn polygon_form_factor(corners: &[DVec3]) -> f64 {
    let mut above = Vec::new();
    for (k, &a) in corners.iter().enumerate() {
        let b = corners[(k + 1) % corners.len()];
        if a.z >= 0.0 {
            above.push(a);
        }
        if (a.z < 0.0) != (b.z < 0.0) {
            above.push(a + (b - a) * (a.z / (a.z - b.z)));
        }
    }
    let edge = |k: usize| {
        let (a, b) = (above[k], above[(k + 1) % above.len()]);
        let normal = a.cross(b);
        let sin = normal.length();
        let angle = FRAC_PI_2 - atan(a.dot(b) / sin.max(f64::MIN_POSITIVE));
        if sin <= 1e-14 * a.length() * b.length() { 0.0 } else { angle * normal.z / sin }
    };
    ((0..above.len()).map(edge).sum::<f64>() / TAU).abs()
}

/// A floor at height 0: its least and greatest x and y.
type Rectangle = [f64; 4];
const SMALL: Rectangle = [-0.05, 0.05, -0.05, 0.05];
const LARGE: Rectangle = [-1.0, 0.45, -0.6, 0.8];

/// Returns the mean irradiance of a floor by the first pass, lx.
fn solved(lamp: &str, [x0, x1, y0, y1]: Rectangle) -> f64 {
    let text = format!(
        "camera main =\n\torigin 0 -3 1\n\ttarget 0 0 0\n\tfov 40\n\tfilm 8 8\nm lamp =\n\tsides 1\n\tc\n\ted {EMITTANCE}\nm floor =\n\
         \tsides 2\n\tc\n\trd .5\nm lamp\n{lamp}m floor\nv e =\n\tp {x0} {y0} 0\nv f =\n\tp {x1} {y0} 0\nv g =\n\tp {x1} {y1} 0\nv h =\n\
         \tp {x0} {y1} 0\nf e f g h\n"
    );
    let source = SceneSource::new(Arc::new(scene(&text)));
    let world = prepare_world(&source, &Settings::default(), 1, None).expect("a frame");
    let options = SolveOptions { error: 0.3, ..SolveOptions::default() };
    let solution = solve(&world, &options, &AtomicBool::new(false)).expect("a solution");
    let field = &solution.field;
    let is_floor = |number: &usize| {
        let surface = &field.surfaces[*number];
        surface.side == Side::Front
            && matches!(surface.form, Form::Parallelogram(_))
            && (surface.area() - ((x1 - x0) * (y1 - y0)) as f32).abs() < 1e-5
    };
    let floor = (0..field.surfaces.len()).find(is_floor).expect("the floor");
    let leaves = field.leaves_of(floor as u32);
    // Shares of the area, in parameters of the surface.
    let share = |edges: [femc_math::glam::Vec2; 2]| f64::from(edges[0].perp_dot(edges[1]).abs());
    let total: f64 = leaves.iter().map(|(_, outline)| share(outline.edges)).sum();
    assert!((total - 1.0).abs() < 1e-5, "{total}");
    let light = |leaf: u32| f64::from(luminance(solution.field.direct[leaf as usize].mean_irradiance()));
    leaves.iter().map(|(leaf, outline)| light(*leaf) * share(outline.edges)).sum()
}

/// Returns the mean of a form factor over a floor.
fn mean(floor: Rectangle, form_factor: impl Fn(DVec3) -> f64) -> f64 {
    const STEPS: u32 = 24;
    let [x0, x1, y0, y1] = floor;
    let at = |k: u32| (f64::from(k) + 0.5) / f64::from(STEPS);
    let points = (0..STEPS * STEPS).map(|k| [at(k % STEPS), at(k / STEPS)]);
    let sum: f64 = points.map(|[u, v]| form_factor(DVec3::new(x0 + (x1 - x0) * u, y0 + (y1 - y0) * v, 0.0))).sum();
    sum / f64::from(STEPS * STEPS)
}

/// Compares the light of a lamp at several heights, the greatest first. The tolerance is a share of the light, and a small share of
/// the light at the first height. The light at the last height but one, below the horizon, is much more.
fn assert_sweep(name: &str, heights: &[f64], lamp: impl Fn(f64) -> String, form_factor: impl Fn(f64, DVec3) -> f64) {
    for (size, floor) in [("small", SMALL), ("large", LARGE)] {
        let known = |z: f64| EMITTANCE * mean(floor, |point| form_factor(z, point));
        let most = known(heights[0]);
        for &z in heights {
            let (got, known) = (solved(&lamp(z), floor), known(z));
            let what = format!("{name}, {size} floor, height {z}: {got} for {known}, {most} above");
            assert!((got - known).abs() <= 0.05 * known + 0.01 * most, "{what}");
        }
        let below = known(heights[heights.len() - 2]);
        assert!(below > 4.0 * (0.05 * below + 0.01 * most), "{name}: the limit would not see that light is missing");
    }
}

#[test]
fn first_pass_has_the_light_of_balls_across_the_horizon() {
    const RADIUS: f64 = 0.4;
    let heights = [0.999, -0.3, -0.7].map(|height| height * RADIUS);
    let lamp = |z: f64| format!("v l =\n\tp 1 .2 {z}\nsph l {RADIUS}\n");
    let known = |z: f64, point: DVec3| ball_form_factor((DVec3::new(1.0, 0.2, z) - point) / RADIUS);
    assert_sweep("ball", &heights, lamp, known);
}

#[test]
fn first_pass_has_panels_and_discs_across_the_horizon() {
    let panel = |z: f64| [[0.6, -0.4, z - 0.5], [0.6, 0.4, z - 0.5], [0.8, 0.4, z + 0.5], [0.8, -0.4, z + 0.5]];
    let lamp = |z: f64| {
        let corners = panel(z);
        let vertices: String = corners
            .iter()
            .zip("abcd".chars())
            .map(|([x, y, z], name)| format!("v {name} =\n\tp {x} {y} {z}\n"))
            .collect();
        format!("{vertices}f d c b a\n")
    };
    let heights = [0.5, -0.1, -0.3];
    assert_sweep("panel", &heights, lamp, |z, point| {
        polygon_form_factor(&panel(z).map(|corner| DVec3::from(corner) - point))
    });
    let disc = |z: f64| format!("v l =\n\tp .7 0 {z}\n\tn -1 0 0\nring l 0 .5\n");
    assert_sweep("disc", &heights, disc, |z, point| {
        let rim = |k: u32| {
            let (sin, cos) = sin_cos(TAU * f64::from(k) / 200.0);
            DVec3::new(0.7, 0.5 * cos, z + 0.5 * sin) - point
        };
        polygon_form_factor(&(0..200).map(rim).collect::<Vec<_>>())
    });
}
