//! Half spaces and slabs of scattering media (algorithm brief, T10 to T14).
//!
//! A slab is a box 2e4 m across. Its thickness in meters equals its thickness in mean free paths. A ceiling of luminance 1 right
//! above illuminates it. A camera that looks vertically down sees the fraction of vertical light that the slab reflects
//! (reciprocity). A camera below that looks vertically up sees the transmitted fraction. A patch of a millimeter receives the mean
//! over all directions. Its luminance over its reflectance is the fraction of the incident diffuse light.

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use super::quadrature::{gauss, integral};
use crate::text::{block, camera, horizontal_square, material};
use std::f64::consts::PI;

/// Reflectance of patches.
const RHO: f64 = 0.5;
const HALF_WIDTH: f64 = 1e4;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    for (_, cases) in laws() {
        measure_all("slabs", &cases, effort, report);
    }
}

/// Returns the cases by law.
pub fn laws() -> Vec<(&'static str, Vec<Case>)> {
    let mut henyey_greenstein = forward();
    henyey_greenstein.push(giovanelli());
    vec![("T10", half_spaces()), ("T11", milne()), ("T12", slabs()), ("T13", henyey_greenstein), ("T14", unscattered())]
}

#[derive(Clone, Copy, PartialEq)]
enum SlabSide {
    Above,
    Below,
}

/// Returns a medium of extinction 1 (`more`: its phase function) from z = -`thickness` to 0, under a ceiling.
fn slab(thickness: f64, albedo: f64, more: &str, view: &str) -> String {
    let fog = format!("medium fog =\n sigma_s {albedo}\n sigma_a {}\n{more}", 1.0 - albedo);
    let ceiling = material("ceiling", &["sides 2", &format!("ed {PI}")])
        + &horizontal_square("ceiling", [0.0, 0.0, 1.0], HALF_WIDTH);
    format!("{view}{fog}mbox fog -{HALF_WIDTH} -{HALF_WIDTH} -{thickness} {HALF_WIDTH} {HALF_WIDTH} 0\n{ceiling}")
}

/// Returns a camera that looks at the slab at the angle of cosine `mu`.
fn camera_toward_slab(from: SlabSide, thickness: f64, mu: f64) -> String {
    let sin = (1.0 - mu * mu).sqrt();
    match from {
        SlabSide::Above => camera("0 0 .5", &format!("{sin} 0 {}", 0.5 - mu), 0.01),
        SlabSide::Below => {
            camera(&format!("0 0 {}", -thickness - 0.5), &format!("{sin} 0 {}", mu - thickness - 0.5), 0.01)
        }
    }
    .replace("up .1 .2 .9", "up 0 1 0")
}

/// Returns a patch that faces the slab, and a camera that looks at it from the slab's side.
fn patch(from: SlabSide, thickness: f64) -> String {
    let (z, camera_z) = match from {
        SlabSide::Above => (0.5, 0.49),
        SlabSide::Below => (-thickness - 0.5, -thickness - 0.49),
    };
    let view = camera(&format!("0 -1e-4 {camera_z}"), &format!("0 0 {z}"), 0.01);
    // The other side is black, because the ceiling would illuminate it.
    let corner = |x: f64, y: f64| format!("{x} {y} {z}");
    let h = 5e-4;
    let face = [corner(-h, -h), corner(-h, h), corner(h, h), corner(h, -h)];
    let mut face = face.each_ref().map(String::as_str);
    if from == SlabSide::Below {
        face.reverse();
    }
    view + &material("patch", &["sides 1", &format!("rd {RHO}")]) + &crate::text::quad("patch", face)
}

/// Chandrasekhar's H function for isotropic scattering (\[chandrasekhar1960\]), from iterating 1/H = sqrt(1-w) + w/2 int H(m) m /
/// (mu + m) dm.
struct HFunction {
    albedo: f64,
    nodes: Vec<(f64, f64)>,
    values: Vec<f64>,
}

impl HFunction {
    fn new(albedo: f64) -> Self {
        // The nodes are in the square root of mu, because H is steep near mu = 0.
        let nodes: Vec<_> = gauss(64, 0.0, 1.0).into_iter().map(|(x, w)| (x * x, 2.0 * x * w)).collect();
        let mut this = Self { albedo, values: vec![1.0; nodes.len()], nodes };
        for _ in 0..20_000 {
            let next: Vec<f64> = this.nodes.iter().map(|&(mu, _)| this.at(mu)).collect();
            let change = next.iter().zip(&this.values).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
            this.values = next.iter().zip(&this.values).map(|(a, b)| 0.5 * (a + b)).collect();
            if change < 1e-13 {
                break;
            }
        }
        this
    }

    fn at(&self, mu: f64) -> f64 {
        let sum: f64 = self.nodes.iter().zip(&self.values).map(|(&(m, w), h)| w * h * m / (mu + m)).sum();
        1.0 / ((1.0 - self.albedo).sqrt() + 0.5 * self.albedo * sum)
    }

    /// Returns the reflected fraction of light from `mu`.
    fn plane(&self, mu: f64) -> f64 {
        1.0 - (1.0 - self.albedo).sqrt() * self.at(mu)
    }

    /// Returns the reflected fraction of diffuse light.
    fn spherical(&self) -> f64 {
        let moment: f64 = self.nodes.iter().zip(&self.values).map(|(&(m, w), h)| w * h * m).sum();
        1.0 - 2.0 * (1.0 - self.albedo).sqrt() * moment
    }
}

/// T10. A slab of 60 diffusion lengths stands for a half space.
fn half_spaces() -> Vec<Case> {
    let mut cases = Vec::new();
    for (albedo, depth) in [(0.5, 60.0), (0.8, 90.0), (0.9, 120.0), (0.95, 160.0), (0.99, 350.0)] {
        let h = HFunction::new(albedo);
        for mu in [1.0, 0.5, 0.1] {
            let text = slab(depth, albedo, "", &camera_toward_slab(SlabSide::Above, depth, mu));
            cases.push(
                Case::new(format!("half space of albedo {albedo}, cosine {mu}"), text, h.plane(mu)).with_slack(1e-4),
            );
        }
        let text = slab(depth, albedo, "", &patch(SlabSide::Above, depth));
        cases.push(
            Case::new(format!("half space of albedo {albedo}, diffuse"), text, RHO * h.spherical()).with_slack(1e-4),
        );
        cases.push(half_space_under_lamp(albedo, depth, &h));
    }
    cases
}

/// f_r = w/(4 pi) H(mu) H(mu0) / (mu + mu0), with a small distant lamp at mu0 = 0.6, seen from mu = 1.
fn half_space_under_lamp(albedo: f64, depth: f64, h: &HFunction) -> Case {
    let (far, radius, mu0) = (1e5, 100.0, 0.6);
    let at = [0.8 * far, 0.0, mu0 * far];
    let lamp = material("lamp", &["sides 1", "ed 3141592.65358979"]);
    let lamp = lamp + &format!("v o =\n p {} {} {}\nm lamp\nsph o {radius}\n", at[0], at[1], at[2]);
    let fog = format!("medium fog =\n sigma_s {albedo}\n sigma_a {}\n", 1.0 - albedo);
    let view = camera_toward_slab(SlabSide::Above, depth, 1.0);
    let text = format!("{view}{fog}mbox fog -{HALF_WIDTH} -{HALF_WIDTH} -{depth} {HALF_WIDTH} {HALF_WIDTH} 0\n{lamp}");
    let reflectance = albedo / (4.0 * PI) * h.at(1.0) * h.at(mu0) / (1.0 + mu0);
    let irradiance = PI * 1e6 * (radius / far).powi(2) * mu0;
    // The lamp has an angular diameter of 0.1 degrees.
    Case::new(format!("half space of albedo {albedo} under a lamp"), text, reflectance * irradiance).with_slack(1e-4)
}

/// T11, with a slab of albedo 1 and thickness 10. Within some free paths of its dark side light only flows through, and the
/// emerging radiance is (sqrt 3 / 4 pi) H(mu) F. The flux F is pi times the transmitted fraction, 4/3 / (10 + 2 * 0.7104461).
fn milne() -> Vec<Case> {
    let thickness = 10.0;
    let h = HFunction::new(1.0);
    let flux = PI * 4.0 / 3.0 / (thickness + 2.0 * 0.710_446_1);
    let case = |mu: f64| {
        let text = slab(thickness, 1.0, "", &camera_toward_slab(SlabSide::Below, thickness, mu));
        let truth = 3f64.sqrt() / (4.0 * PI) * h.at(mu) * flux;
        Case::new(format!("light that emerges from deep below, cosine {mu}"), text, truth)
            .with_slack(2e-4)
            .with_sigma(3e-3)
    };
    vec![case(1.0), case(0.5), case(0.1)]
}

/// T12: (thickness, albedo, [reflected, transmitted] fraction of diffuse light, [..] of vertical light).
const ISOTROPIC: [(f64, f64, [f64; 2], [f64; 2]); 11] = [
    (0.1, 1.0, [0.08430, 0.91570], [0.04769, 0.95231]),
    (0.5, 1.0, [0.29583, 0.70417], [0.20251, 0.79749]),
    (1.0, 1.0, [0.44659, 0.55341], [0.34133, 0.65867]),
    (1.0, 0.9, [0.35271, 0.47475], [0.26741, 0.59163]),
    (2.0, 1.0, [0.60994, 0.39006], [0.51752, 0.48249]),
    (2.0, 0.99, [0.58800, 0.37335], [0.49749, 0.46570]),
    (2.0, 0.9, [0.43714, 0.26558], [0.36165, 0.35650]),
    (2.0, 0.5, [0.14508, 0.10706], [0.11283, 0.18932]),
    (5.0, 1.0, [0.79232, 0.20768], [0.73872, 0.2613]),
    (5.0, 0.9, [0.47632, 0.05343], [0.41253, 0.07666]),
    (10.0, 1.0, [0.88321, 0.11679], [0.8530, 0.1470]),
];

fn slabs() -> Vec<Case> {
    let mut cases = Vec::new();
    for (thickness, albedo, diffuse, normal) in &ISOTROPIC {
        let (thickness, albedo) = (*thickness, *albedo);
        for (from, k, what) in [(SlabSide::Above, 0, "reflected"), (SlabSide::Below, 1, "transmitted")] {
            let name = format!("slab of {thickness}, albedo {albedo}, {what}");
            // The brief rounds its numbers to 1e-5, the last ones to 1e-4.
            let slack = |truth: f64| 1e-4 + if thickness > 5.0 { 6e-5 } else { 1e-5 } / truth;
            let sigma = if thickness > 2.0 && from == SlabSide::Below { 3e-3 } else { 1e-3 };
            let text = slab(thickness, albedo, "", &camera_toward_slab(from, thickness, 1.0));
            cases.push(
                Case::new(format!("{name} of a beam"), text, normal[k]).with_slack(slack(normal[k])).with_sigma(sigma),
            );
            let text = slab(thickness, albedo, "", &patch(from, thickness));
            let case = Case::new(format!("{name} of diffuse light"), text, RHO * diffuse[k]);
            cases.push(case.with_slack(slack(diffuse[k])).with_sigma(sigma));
        }
    }
    cases
}

/// T14: unscattered light, 2 E3(tau) of diffuse light and e^-tau of a beam.
fn unscattered() -> Vec<Case> {
    let mut cases = Vec::new();
    for thickness in [1e-4, 0.1, 1.0, 5.0] {
        let e3 = integral(0.0, 1.0, 400, |mu| if mu > 0.0 { mu * (-thickness / mu).exp() } else { 0.0 });
        let beam = slab(thickness, 0.0, "", &camera_toward_slab(SlabSide::Below, thickness, 1.0));
        cases.push(Case::new(format!("absorber of {thickness}, a beam"), beam, (-thickness).exp()));
        let diffuse = slab(thickness, 0.0, "", &patch(SlabSide::Below, thickness));
        cases.push(
            Case::new(format!("absorber of {thickness}, diffuse light"), diffuse, RHO * 2.0 * e3).with_slack(1e-4),
        );
    }
    cases
}

/// T13: Henyey-Greenstein with g = 0.75, thickness 2, albedo 0.9: van de Hulst's table, as cited by \[wang1995\].
fn forward() -> Vec<Case> {
    let case = |from: SlabSide, what: &str, truth: f64| {
        let text = slab(2.0, 0.9, " phase hg .75\n", &camera_toward_slab(from, 2.0, 1.0));
        Case::new(format!("slab of 2, albedo 0.9, g 0.75, {what}"), text, truth).with_slack(1e-4)
    };
    vec![case(SlabSide::Above, "reflected", 0.09739), case(SlabSide::Below, "transmitted", 0.66096)]
}

/// T13: a half space of albedo 0.9 behind an interface of index 1.5: Giovanelli's 0.2600 (1955) for a vertical beam, as cited by
/// \[wang1995\].
fn giovanelli() -> Case {
    let depth = 120.0;
    let skin = material("skin", &["sides 1", "ir 1.5 0", "ts 1 0", "inside fog"]);
    let solid = skin + &block("skin", [-HALF_WIDTH, -HALF_WIDTH, -depth], [HALF_WIDTH, HALF_WIDTH, 0.0]);
    let fog = "medium fog =\n sigma_s .9\n sigma_a .1\n";
    let ceiling = material("ceiling", &["sides 2", &format!("ed {PI}")])
        + &horizontal_square("ceiling", [0.0, 0.0, 1.0], HALF_WIDTH);
    let text = format!("{}{fog}{solid}{ceiling}", camera_toward_slab(SlabSide::Above, depth, 1.0));
    Case::new("half space of albedo 0.9 behind an index of 1.5", text, 0.2600).with_slack(5e-4)
}

#[cfg(test)]
mod tests {
    use super::HFunction;

    #[test]
    fn the_h_function_and_its_moments_are_those_of_the_brief() {
        let known = [
            (0.5, 1.251260, 0.115226, 0.146544),
            (0.8, 1.598220, 0.285255, 0.341867),
            (0.9, 1.850099, 0.414947, 0.478024),
            (0.95, 2.077124, 0.535541, 0.596669),
            (0.99, 2.472793, 0.752721, 0.794564),
        ];
        for (albedo, at_one, plane, spherical) in known {
            let h = HFunction::new(albedo);
            for (value, known) in [(h.at(1.0), at_one), (h.plane(1.0), plane), (h.spherical(), spherical)] {
                assert!((value - known).abs() < 2e-6, "{albedo}: {value}, not {known}");
            }
        }
        let h = HFunction::new(1.0);
        for (mu, known) in [(0.0, 0.137832), (0.5, 0.277426), (1.0, 0.400790)] {
            let emergent = 3f64.sqrt() / (4.0 * std::f64::consts::PI) * h.at(mu);
            assert!((emergent - known).abs() < 2e-6, "{mu}: {emergent}, not {known}");
        }
        assert!(
            (h.at(1.0) - 2.907811).abs() < 5e-6
                && (h.at(1.0).powi(2) / (8.0 * std::f64::consts::PI) - 0.336428).abs() < 2e-6
        );
    }
}
