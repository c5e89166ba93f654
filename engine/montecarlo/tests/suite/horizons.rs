//! Lamps that stand across the horizon of the surface that they light, or across their own plane. The light of the part above the
//! horizon is known in closed form, or by cubature over the lamp's directions.
//!
//! Each lamp is swept through the horizon, alone, beside a few other lamps, and among more lamps than are weighed one by one.

use crate::analytic::{CENTER, prepare, root_of_squares};
use femc_math::color::luminance;
use femc_math::elementary::double::{acos, atan, sin_cos};
use femc_math::glam::DVec3;
use femc_montecarlo::{MisTechnique, PathSettings, Tracer};
use femc_prepared::Prepared;
use femc_stats::testing::{Moments, sidak, z_test};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Probability of a false alarm over all tests here, and the number of comparisons.
const LEVEL: f64 = 1e-4;
const TESTS: usize = 300;
const SAMPLES: u64 = 20_000;
/// Relative error of the cubature.
const CUBATURE_ERROR: f64 = 5e-3;
/// Emittance of the lamps, lm/m2.
const EMITTANCE: f64 = 100.0;

/// Returns the form factor from a horizontal point to a ball across its horizon or above it (\[howell2010\]).
/// - `center`: from the point to the center, relative to the radius.
fn ball_form_factor(center: DVec3) -> f64 {
    let (distance2, cos) = (center.length_squared(), center.z / center.length());
    let (sin, distant) = ((1.0 - cos * cos).sqrt(), center.z.abs() >= 1.0);
    if distant {
        return (cos / distance2).max(0.0);
    }
    let x = (distance2 - 1.0).sqrt();
    let y = -x * cos / sin;
    let across = sin * (1.0 - y * y).sqrt();
    ((cos * acos(y) - x * across) / distance2 + atan(across / x)) / PI
}

/// Returns the form factor from a horizontal point at the origin to the part of a polygon above the horizon, by Lambert's contour
/// integral; positive if its corners run counterclockwise as seen from the point.
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
        if sin <= 1e-14 * a.length() * b.length() {
            return 0.0;
        }
        (FRAC_PI_2 - atan(a.dot(b) / sin)) * normal.z / sin
    };
    (0..above.len()).map(edge).sum::<f64>() / TAU
}

/// Integrates a function of the direction over the cone of a ball, in relation to pi.
fn over_ball(center: DVec3, radius: f64, value: impl Fn(DVec3) -> f64) -> f64 {
    const STEPS: u32 = 600;
    let axis = center.normalize();
    let (x, y) = axis.any_orthonormal_pair();
    let versine = 1.0 - (1.0 - (radius * radius) / center.length_squared()).sqrt();
    let at = |k: u32| (f64::from(k) + 0.5) / f64::from(STEPS);
    let mut sum = 0.0;
    for [i, j] in (0..STEPS * STEPS).map(|k| [k % STEPS, k / STEPS]) {
        let cos = 1.0 - versine * at(i);
        let ((sin_phi, cos_phi), sin) = (sin_cos(TAU * at(j)), (1.0 - cos * cos).sqrt());
        sum += value(axis * cos + (x * cos_phi + y * sin_phi) * sin);
    }
    sum * TAU * versine / f64::from(STEPS * STEPS) / PI
}

/// The other lamps of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Others {
    Nothing,
    Two,
    Many,
}

impl Others {
    const ALL: [Self; 3] = [Self::Nothing, Self::Two, Self::Many];

    /// Places and radii of balls, m.
    fn balls(self) -> Vec<(DVec3, f64)> {
        match self {
            Self::Nothing => vec![],
            Self::Two => vec![(DVec3::new(-0.4, 0.3, 1.0), 0.05), (DVec3::new(0.0, -0.8, -0.5), 0.1)],
            // Half of them are below the horizon.
            Self::Many => (0..140)
                .map(|k| {
                    let (x, y) = (f64::from(k % 14) - 6.5, f64::from(k / 14) - 4.5);
                    (DVec3::new(-1.0 + 0.04 * x, 0.1 * y, if k % 2 == 0 { 0.5 } else { -0.5 }), 0.004)
                })
                .collect(),
        }
    }

    fn text(self) -> String {
        let ball = |(center, radius): (DVec3, f64)| {
            format!("v o =\n p {} {} {}\nsph o {radius}\n", center.x, center.y, center.z)
        };
        self.balls().into_iter().map(ball).collect()
    }

    fn form_factor(self) -> f64 {
        self.balls().into_iter().map(|(center, radius)| ball_form_factor(center / radius)).sum()
    }
}

/// Floor around the origin, small enough to hide nothing. The camera sees its middle.
/// - `material`: lines of its material; `normal`: line of its corners' normal.
fn scene(lamp: &str, others: Others, material: &str, normal: &str) -> Prepared {
    let corner = |name: &str, x: f64, y: f64| format!("v {name} =\n p {x} {y} 0\n{normal}");
    let [e, f, g, h] = [("e", -0.05, -0.05), ("f", 0.05, -0.05), ("g", 0.05, 0.05), ("h", -0.05, 0.05)]
        .map(|(n, x, y)| corner(n, x, y));
    let text = format!(
        "camera main =\n origin .01 -.3 .9\n target 0 0 0\n fov 1\n film 1 1\nm lamp =\n sides 1\n c\n ed {EMITTANCE}\n\
         m floor =\n sides 2\n{material}m lamp\n{lamp}{}m floor\n{e}{f}{g}{h}f e f g h\n",
        others.text()
    );
    prepare(&text, "main")
}

fn moments(scene: &Prepared, single_technique: Option<MisTechnique>) -> Moments {
    let mut moments = Moments::default();
    for seed in 0..SAMPLES {
        let settings = PathSettings { seed, max_depth: 2, single_technique };
        moments.add(luminance(Tracer::new(scene, settings).sample(0, 0, CENTER).color).into());
    }
    moments
}

/// Compares each technique with the known light, relative to the light of a whole sky of lamps.
fn assert_light(name: &str, scene: &Prepared, expected: f64) {
    const UNIT: f64 = EMITTANCE / PI;
    for technique in [None, Some(MisTechnique::Light), Some(MisTechnique::Scatter)] {
        if technique == Some(MisTechnique::Scatter) && expected * (SAMPLES as f64) < 100.0 {
            continue;
        }
        let moments = moments(scene, technique);
        let (mean, error) = (moments.mean / UNIT, moments.standard_error() / UNIT);
        let p = z_test(mean, root_of_squares([error, CUBATURE_ERROR * expected / 3.0]), expected);
        let what = format!("{name}, {technique:?}: {mean} +- {error} for {expected}");
        assert!((mean - expected).abs() <= 1e-5 * expected + 1e-9 || p >= sidak(LEVEL, TESTS), "{what}");
        // Light that is missing altogether would be seen.
        assert!(technique == Some(MisTechnique::Scatter) || 8.0 * error <= expected, "too noisy: {what}");
    }
}

const MATTE: &str = " c\n rd .5\n";
/// Heights of a lamp of radius 0.4: far above, tangent from above, across in eight steps, tangent from below, far below.
const HEIGHTS: [f64; 11] = [0.9, 0.4, 0.399, 0.3, 0.15, 0.01, 0.0, -0.01, -0.15, -0.3, -0.37];

#[test]
fn balls_across_the_horizon_light_a_floor_as_known() {
    for others in Others::ALL {
        for z in HEIGHTS {
            let center = DVec3::new(1.0, 0.2, z);
            let scene = scene(&format!("v l =\n p 1 .2 {z}\nsph l .4\n"), others, MATTE, "");
            let expected = 0.5 * (ball_form_factor(center / 0.4) + others.form_factor());
            assert_light(&format!("ball at {z}, {others:?}"), &scene, expected);
        }
    }
}

/// The closed form is the cubature's value, so that neither is wrong alone.
#[test]
fn the_ball_s_closed_form_is_the_integral_over_its_cone() {
    for z in HEIGHTS {
        let center = DVec3::new(1.0, 0.2, z);
        let (closed, sum) = (ball_form_factor(center / 0.4), over_ball(center, 0.4, |dir| dir.z.max(0.0)));
        assert!((closed - sum).abs() < 1e-6 + 1e-3 * closed, "{z}: {closed} {sum}");
    }
}

/// A sheet scatters the light of both sides.
#[test]
fn balls_across_the_horizon_light_both_sides_of_a_sheet() {
    for others in [Others::Nothing, Others::Two, Others::Many] {
        for z in [0.3, 0.0, -0.01, -0.3, -0.6] {
            let center = DVec3::new(1.0, 0.2, z);
            let scene = scene(&format!("v l =\n p 1 .2 {z}\nsph l .4\n"), others, " c\n rd .3\n td .6\n", "");
            let mirrored = |center: DVec3| center * DVec3::new(1.0, 1.0, -1.0);
            let below: f64 =
                others.balls().into_iter().map(|(center, radius)| ball_form_factor(mirrored(center) / radius)).sum();
            let expected = 0.3 * (ball_form_factor(center / 0.4) + others.form_factor())
                + 0.6 * (ball_form_factor(mirrored(center) / 0.4) + below);
            assert_light(&format!("sheet, ball at {z}, {others:?}"), &scene, expected);
        }
    }
}

/// Panels and discs that stand upright across the horizon.
#[test]
fn panels_and_discs_across_the_horizon_light_a_floor_as_known() {
    const SIDES: u32 = 2000;
    for others in Others::ALL {
        for z in [0.6, 0.5, 0.2, 0.0, -0.1, -0.3, -0.45] {
            // Both face the floor along -x; the panel leans.
            let panel = [[0.8, -0.4, z - 0.5], [0.8, 0.4, z - 0.5], [1.0, 0.4, z + 0.5], [1.0, -0.4, z + 0.5]];
            let text: String = panel
                .iter()
                .zip("abcd".chars())
                .map(|([x, y, z], name)| format!("v {name} =\n p {x} {y} {z}\n"))
                .collect();
            let corners: Vec<DVec3> = panel.into_iter().map(DVec3::from).collect();
            let factor = polygon_form_factor(&corners).abs();
            let lit = scene(&format!("{text}f d c b a\n"), others, MATTE, "");
            assert_light(&format!("panel at {z}, {others:?}"), &lit, 0.5 * (factor + others.form_factor()));
            let rim = |k: u32| {
                let (sin, cos) = sin_cos(TAU * f64::from(k) / f64::from(SIDES));
                DVec3::new(0.9, 0.5 * cos, z + 0.5 * sin)
            };
            let factor = polygon_form_factor(&(0..SIDES).map(rim).collect::<Vec<_>>()).abs();
            let lit = scene(&format!("v l =\n p .9 0 {z}\n n -1 0 0\nring l 0 .5\n"), others, MATTE, "");
            assert_light(&format!("disc at {z}, {others:?}"), &lit, 0.5 * (factor + others.form_factor()));
        }
    }
}

/// A panel over the floor that turns through its own plane: it shows its front, its edge, and its dark back.
#[test]
fn a_panel_that_turns_away_darkens_as_known() {
    for others in Others::ALL {
        for lean in [0.9, 0.5, 0.12, 0.02, -0.02, -0.5] {
            // The plane of the panel passes the origin at a distance of about `lean`.
            let far = [[0.4, -0.3, 0.5], [0.4, 0.3, 0.5], [0.8 + lean, 0.3, 1.0], [0.8 + lean, -0.3, 1.0]];
            let corners: Vec<DVec3> = far.into_iter().map(DVec3::from).collect();
            let text: String = far
                .iter()
                .zip("abcd".chars())
                .map(|([x, y, z], name)| format!("v {name} =\n p {x} {y} {z}\n"))
                .collect();
            let facing = polygon_form_factor(&[corners[3], corners[2], corners[1], corners[0]]);
            for (order, factor) in [("f a b c d", -facing), ("f d c b a", facing)] {
                // Seen from the front, the corners run counterclockwise around the normal.
                let factor = (-factor).max(0.0);
                let lit = scene(&format!("{text}{order}\n"), others, MATTE, "");
                let expected = 0.5 * (factor + others.form_factor());
                if expected == 0.0 {
                    let moments = moments(&lit, None);
                    assert_eq!(moments.mean, 0.0, "{order}, {lean}: light from a dark side");
                } else {
                    assert_light(&format!("{order}, {lean}, {others:?}"), &lit, expected);
                }
            }
        }
    }
}

/// Rows of upright panels, more than are weighed one by one. All face along -x, so that only those beyond the floor light it, and a
/// group's middle may face away although some of its panels do not.
#[test]
fn panels_of_a_group_that_faces_away_light_a_floor_as_known() {
    let (mut text, mut factor) = (String::new(), 0.0);
    for k in 0..150 {
        let (x, z) = (f64::from(k % 30) * 0.05 - 1.0, 0.2 + 0.15 * f64::from(k / 30));
        let corners = [[0.45, z], [0.5, z], [0.5, z + 0.05], [0.45, z + 0.05]].map(|[y, z]| DVec3::new(x, y, z));
        for (name, corner) in "abcd".chars().zip(corners) {
            text += &format!("v {name} =\n p {} {} {}\n", corner.x, corner.y, corner.z);
        }
        text += "f d c b a\n";
        factor += if x > 0.0 { polygon_form_factor(&corners).abs() } else { 0.0 };
    }
    let lit = scene(&text, Others::Nothing, MATTE, "");
    assert_eq!(lit.lights.len(), 150);
    assert_light("rows of panels", &lit, 0.5 * factor);
}

/// A point-like ball at small angles above and below the horizon.
#[test]
fn small_lamps_near_the_horizon_light_a_floor_as_known() {
    for others in [Others::Nothing, Others::Two, Others::Many] {
        for z in [0.3, 0.02, 0.003, 0.001, 0.0, -0.001, -0.0015] {
            let center = DVec3::new(1.0, 0.2, z);
            let lit = scene(&format!("v l =\n p 1 .2 {z}\nsph l .002\n"), others, MATTE, "");
            let expected = 0.5 * (ball_form_factor(center / 0.002) + others.form_factor());
            for technique in [None, Some(MisTechnique::Light)] {
                let moments = moments(&lit, technique);
                let (mean, error) = (moments.mean * PI / EMITTANCE, moments.standard_error() * PI / EMITTANCE);
                let p = z_test(mean, error, expected);
                let is_near = (mean / expected - 1.0).abs() < 2e-3;
                assert!(is_near || p >= sidak(LEVEL, TESTS), "{z}, {others:?}: {mean} +- {error} for {expected}");
            }
        }
    }
}

/// Shading normals lean toward the lamp or away from it. Light counts where both normals see it.
#[test]
fn lamps_across_the_horizon_of_a_shading_normal_light_as_known() {
    for lean in [-0.6, -0.3, 0.3, 0.6] {
        let shading = DVec3::new(lean, 0.0, (1.0 - lean * lean).sqrt());
        let normal = format!(" n {} {} {}\n", shading.x, shading.y, shading.z);
        for others in [Others::Nothing, Others::Two] {
            for z in [0.6, 0.3, 0.0, -0.2] {
                let center = DVec3::new(1.0, 0.2, z);
                let light = |center, radius| {
                    over_ball(center, radius, |dir| if dir.z > 0.0 { shading.dot(dir).max(0.0) } else { 0.0 })
                };
                let lit = scene(&format!("v l =\n p 1 .2 {z}\nsph l .4\n"), others, MATTE, &normal);
                let all = others.balls().into_iter().map(|(center, radius)| light(center, radius)).sum::<f64>();
                let expected = 0.5 * (light(center, 0.4) + all);
                if expected > 1e-4 {
                    assert_light(&format!("normal {lean}, ball at {z}, {others:?}"), &lit, expected);
                }
            }
        }
    }
}

/// Glossy floors: lamps chosen by the BSDF's lobes against scattering alone, which chooses no lamp.
#[test]
fn lamps_across_the_horizon_light_a_glossy_floor() {
    for others in [Others::Two, Others::Many] {
        for z in [0.3, 0.0, -0.15, -0.3] {
            let lit = scene(&format!("v l =\n p .2 .9 {z}\nsph l .4\n"), others, " c\n rd .2\n rs .6 .4\n", "");
            let [lamps, scattered, all] =
                [Some(MisTechnique::Light), Some(MisTechnique::Scatter), None].map(|only| moments(&lit, only));
            for other in [lamps, all] {
                let error = root_of_squares([other, scattered].map(|it| it.standard_error()));
                let p = z_test(other.mean, error, scattered.mean);
                let what = format!("{z}, {others:?}: {other:?} for {scattered:?}: {p}");
                let is_exact = 20.0 * other.standard_error() < other.mean;
                assert!(p >= sidak(LEVEL, TESTS) && is_exact, "{what}");
            }
        }
    }
}
