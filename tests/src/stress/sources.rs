//! Point sources in unbounded media (algorithm brief, T8 and T9): radiance of a ray.

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use super::quadrature::integral;
use crate::text::{block, camera, material};
use std::f64::consts::PI;

/// A source of one candela in all directions.
const POINT: &str =
    "IESNA:LM-63-2002\n[TEST] isotropic\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 1\n0 90 180\n0\n1 1 1\n";

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    for (_, cases) in laws() {
        measure_all("sources", &cases, effort, report);
    }
}

/// Returns the cases by law.
pub fn laws() -> Vec<(&'static str, Vec<Case>)> {
    let mut cases = vec![absorber()];
    for albedo in [0.5, 0.9] {
        let fluence = Fluence::new(albedo);
        for (name, r0, cos) in [("beside", 1.0, 0.0), ("toward", 3.0, -0.95), ("away", 1.0, 1.0), ("far", 2.0, 0.0)] {
            let case = scattered(name, &fluence, r0, cos).with_sigma(3e-3);
            cases.push(if r0 > 1.0 || albedo > 0.5 { case.as_long() } else { case });
        }
    }
    vec![("T8", cases), ("T9", airlight())]
}

/// A ray from `start` to `end` along x, with the source at distance `h` from x = 0. Single scattering: sigma_s exp(-sigma_t (x -
/// start + r)) / (4 pi r^2).
fn airlight() -> Vec<Case> {
    // (sigma_s, sigma_t, h, start, end, number in the brief)
    let known = [
        (1.0, 1.0, 1.0, 0.0, f64::INFINITY, 0.015_382_72),
        (1.0, 1.0, 1.0, -2.0, f64::INFINITY, 0.008_933_162),
        (1.0, 1.0, 1.0, -5.0, f64::INFINITY, 5.656_51e-4),
        (1.0, 1.0, 0.1, -1.0, f64::INFINITY, 0.726_775_8),
        (0.2, 0.3, 0.7, -3.0, 5.0, 0.018_675_21),
    ];
    let case = |(sigma_s, sigma_t, h, start, end, truth): (f64, f64, f64, f64, f64, f64)| {
        let view = camera(&format!("{start} 0 0"), &format!("{} 0 0", start + 1.0), 0.01);
        let wall =
            if end.is_finite() { block("wall", [end, -9.0, -9.0], [end + 1.0, 9.0, 9.0]) } else { String::new() };
        let fog = format!("medium fog =\n sigma_s {sigma_s}\n sigma_a {}\nmglobal fog\n", sigma_t - sigma_s);
        let black = material("wall", &["sides 2"]) + &wall;
        let text = view + &fog + &black + &format!("ies point.ies -t 0 0 {h}\n");
        let name = format!("airlight of sigma_s {sigma_s}, sigma_t {sigma_t}, {h} m beside, from {start} to {end} m");
        let by_quadrature = single(sigma_s, sigma_t, h, start, end.min(60.0));
        assert!(
            (truth / by_quadrature - 1.0).abs() < 2e-6,
            "{name}: quadrature gives {by_quadrature}, expected {truth}"
        );
        Case::new(name, text, truth).with_file("point.ies", POINT).with_max_depth(2).with_slack(2e-5)
    };
    known.map(case).into()
}

fn single(sigma_s: f64, sigma_t: f64, h: f64, start: f64, end: f64) -> f64 {
    integral(start, end, 4000, |x| {
        let r2 = x * x + h * h;
        sigma_s * (-sigma_t * (x - start + r2.sqrt())).exp() / (4.0 * PI * r2)
    })
}

/// No scattering: a diffuse patch that faces the source receives exp(-sigma_a r) / r^2.
fn absorber() -> Case {
    let view = camera("0 0 .01", "0 1e-4 0", 0.01);
    let floor = material("floor", &["sides 2", "rd .5"]) + &crate::text::horizontal_square("floor", [0.0; 3], 1.0);
    let text = view + &floor + "medium gas =\n sigma_a .8\nmglobal gas\nies point.ies -t 0 0 2\n";
    let truth = 0.5 / PI * (-0.8f64 * 2.01).exp() / 4.0;
    Case::new("source in an absorber", text, truth).with_file("point.ies", POINT).with_slack(1e-4)
}

/// Radiance of a ray through an isotropic scatterer of extinction 1, from all orders of scattering: w / (4 pi) times the integral
/// of the fluence.
/// - `r0`: distance of its start from the source; `cos`: of its angle with the direction away from the source.
fn scattered(name: &str, fluence: &Fluence, r0: f64, cos: f64) -> Case {
    let albedo = fluence.albedo;
    let along = |s: f64| fluence.at((r0 * r0 + s * s + 2.0 * r0 * s * cos).sqrt()) * (-s).exp();
    let truth = albedo / (4.0 * PI) * integral(0.0, 18.0, 200, along);
    let sin = (1.0 - cos * cos).sqrt();
    let view = camera(&format!("{r0} 0 0"), &format!("{} {sin} 0", r0 + cos), 0.01);
    let fog = format!("medium fog =\n sigma_s {albedo}\n sigma_a {}\nmglobal fog\n", 1.0 - albedo);
    let text = view + &fog + "ies point.ies\n";
    Case::new(format!("all orders of a source, albedo {albedo}, a ray {name}"), text, truth)
        .with_file("point.ies", POINT)
        .with_slack(1e-4)
}

/// Fluence around a point source of 1 cd in an isotropic scatterer of extinction 1, cd/m2 sr:
/// 4 pi {e^-r / (4 pi r^2) + 1 / (2 pi^2 r) int k sin(kr) w (atan k / k)^2 / (1 - w atan k / k) dk}, tabulated.
struct Fluence {
    albedo: f64,
    /// r times the scattered part, in steps of [`STEP`].
    table: Vec<f64>,
}

const STEP: f64 = 0.04;
const STEPS: u32 = 600;

impl Fluence {
    fn new(albedo: f64) -> Self {
        let scattered = |n: u32| scattered_fluence(albedo, STEP * f64::from(n)) * STEP * f64::from(n);
        let mut table: Vec<f64> = (1..=STEPS).map(scattered).collect();
        table.insert(0, scattered_fluence(albedo, 1e-4) * 1e-4);
        Self { albedo, table }
    }

    fn at(&self, r: f64) -> f64 {
        let x = (r / STEP).min(f64::from(STEPS));
        // Cubic interpolation through four neighbors.
        let k = (x as usize).clamp(1, STEPS as usize - 2);
        let t = x - k as f64;
        let p = &self.table[k - 1..k + 3];
        let scattered = p[1]
            + 0.5
                * t
                * (p[2] - p[0]
                    + t * (2.0 * p[0] - 5.0 * p[1] + 4.0 * p[2] - p[3] + t * (3.0 * (p[1] - p[2]) + p[3] - p[0])));
        (-r).exp() / (r * r) + scattered / r
    }
}

/// Returns the scattered part, from integrals over half periods of the sine. Repeated averages of the partial sums accelerate their
/// alternating sum.
fn scattered_fluence(albedo: f64, r: f64) -> f64 {
    let f = |k: f64| {
        let a = if k < 1e-6 { 1.0 } else { k.atan() / k };
        k * (k * r).sin() * albedo * a * a / (1.0 - albedo * a)
    };
    let mut sums = Vec::new();
    let mut sum = 0.0;
    // Small k need short steps where r is small and half periods are long.
    for n in 0..40u32 {
        let (low, high) = (PI / r * f64::from(n), PI / r * f64::from(n + 1));
        let pieces = if n == 0 { (high.ln().max(1.0) * 40.0) as usize } else { 8 };
        sum += if n == 0 {
            integral(0.0, high.cbrt(), pieces, |x| 3.0 * x * x * f(x * x * x))
        } else {
            integral(low, high, pieces, f)
        };
        if n >= 20 {
            sums.push(sum);
        }
    }
    while sums.len() > 1 {
        sums = sums.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
    }
    4.0 * PI * sums[0] / (2.0 * PI * PI * r)
}

#[cfg(test)]
mod tests {
    use super::Fluence;
    use std::f64::consts::PI;

    #[test]
    fn the_fluence_around_a_source_is_that_of_the_brief() {
        let known = [(0.5, [0.0586951, 0.00792762, 0.00172220]), (0.9, [0.143284, 0.0371264, 0.0141400])];
        for (albedo, values) in known {
            let fluence = Fluence::new(albedo);
            for (r, value) in [1.0, 2.0, 3.0].into_iter().zip(values) {
                let here = fluence.at(r) / (4.0 * PI);
                assert!((here / value - 1.0).abs() < 1e-4, "{albedo} {r}: {here}, not {value}");
            }
            // The absorbed light equals the emitted light, so the integral of the fluence is 1 / (1 - w).
            let all = super::integral(1e-3, 24.0, 1000, |r| r * r * fluence.at(r));
            assert!((all * (1.0 - albedo) - 1.0).abs() < 5e-3, "{albedo}: {all}");
        }
    }
}
