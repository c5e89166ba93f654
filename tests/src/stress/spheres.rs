//! Spheres seen from inside: integrating spheres (algorithm brief, T6), and spheres of gas (T7).

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use super::quadrature::gauss;
use crate::text::{camera, material};
use std::f64::consts::{PI, TAU};

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let mut cases = Vec::new();
    for x in [1e-3, 0.1, 1.0, 5.0] {
        cases.extend(gas(x));
    }
    for rho in [0.5, 0.9, 0.99] {
        cases.push(sphere_with_port(rho));
    }
    cases.extend([0.5, 0.99].map(sphere_with_lamp));
    measure_all("spheres", &cases, effort, report);
}

/// Absorbing gas of thickness x = kappa R, and a wall of luminance 1 and reflectance 1/2. The wall receives the fraction F = (1 -
/// (1 + 2x) e^{-2x}) / (2 x^2) of its own light. The camera at the center sees the wall through e^-x.
fn gas(x: f64) -> Vec<Case> {
    let share =
        if x < 0.01 { 1.0 - 4.0 / 3.0 * x + x * x } else { (1.0 - (1.0 + 2.0 * x) * (-2.0 * x).exp()) / (2.0 * x * x) };
    let wall = material("wall", &["sides 2", &format!("rd .5\n ed {PI}")]) + "v o =\n p 0 0 0\nm wall\nsph o 1\n";
    let text = camera("0 0 0", "1 0 0", 60.0) + &wall + &format!("medium gas =\n sigma_a {x}\nmglobal gas\n");
    let seen = (-x).exp();
    vec![
        Case::new(format!("gas of {x:e}, reflected once"), text.clone(), seen * (1.0 + 0.5 * share))
            .with_max_depth(2)
            .with_sigma(1e-4),
        Case::new(format!("gas of {x:e}"), text, seen / (1.0 - 0.5 * share)),
    ]
}

/// A sphere of reflectance `rho` with a black lamp over the opening of a cap. The lamp illuminates the rest of the sphere evenly.
/// The cap has the fraction f of the sphere's area, and each round loses f and 1 - rho: E = pi L f / (1 - rho (1 - f)).
fn sphere_with_port(rho: f64) -> Case {
    let h: f64 = 0.9;
    let f = 0.5 * (1.0 - h);
    let view = camera("0 0 -.5", "1 0 -.5", 60.0);
    let sphere = material("wall", &["sides 2", &format!("rd {rho}")]) + "v o =\n p 0 0 0\nm wall\nsph o 1\n";
    let lamp = material("lamp", &["sides 2", &format!("ed {PI}")]);
    let text = format!("{view}{sphere}{lamp}v l =\n p 0 0 {h}\n n 0 0 -1\nm lamp\nring l 0 {}\n", (1.0 - h * h).sqrt());
    Case::new(format!("sphere of reflectance {rho} with a port of {f:.2}"), text, rho * f / (1.0 - rho * (1.0 - f)))
}

/// A black ball of 5 cm and 1000 lm, 20 cm above the center of a sphere of 1 m. The result is nearly Phi rho / (A (1 - rho (1 -
/// f))) with f the ratio of the areas, but the lamp is nearer to the top and casts a shadow. The truth comes from an integral
/// equation for the illuminance, which depends only on the height.
fn sphere_with_lamp(rho: f64) -> Case {
    let text = INTEGRATING_SPHERE.replace("rd 0.99", &format!("rd {rho}"));
    let wall = Illuminance::new(rho);
    // The film's mean is taken over the centers of 96 x 96 pixels.
    let n = 96;
    let half = 30f64.to_radians().tan();
    let at = |k: i32| half * (2.0 * (f64::from(k) + 0.5) / f64::from(n) - 1.0);
    let mut sum = 0.0;
    for row in 0..n {
        for column in 0..n {
            let dir = normalize([1.0, at(column), at(row)]);
            let from = [0.0, 0.0, -0.5];
            sum += wall.at(chord(from, dir)[2]);
        }
    }
    let truth = rho / PI * sum / f64::from(n * n);
    Case::new(format!("integrating sphere of reflectance {rho}"), text, truth).with_slack(1e-5)
}

/// Scene for this truth.
const INTEGRATING_SPHERE: &str = "camera main =\n origin 0 0 -.5\n target 1 0 -.5\n fov 60\n film 8 8\n\
    m wall =\n sides 1\n c\n rd 0.99\nm lamp =\n sides 1\n c\n ed 31830.9886\n\
    m wall\nv o =\n p 0 0 0\nsph o -1\nm lamp\nv l =\n p 0 0 .2\nsph l .05\n";

/// Illuminance of the wall, lx, at equal steps of height.
struct Illuminance(Vec<f64>);

const STEPS: usize = 128;
const LAMP: [f64; 3] = [0.0, 0.0, 0.2];
const RADIUS: f64 = 0.05;

impl Illuminance {
    fn new(rho: f64) -> Self {
        let height = |k: usize| 2.0 * k as f64 / STEPS as f64 - 1.0;
        // The direct light is (R/d)^2 cos times pi L. The lamp hides the same fraction of the wall's light.
        let share = |z: f64| {
            let d2 = 1.0 + LAMP[2] * LAMP[2] - 2.0 * z * LAMP[2];
            RADIUS * RADIUS * (1.0 - z * LAMP[2]) / (d2 * d2.sqrt())
        };
        let direct: Vec<f64> = (0..=STEPS).map(|k| 31_830.988_6 * share(height(k))).collect();
        let mut all = Self(direct.clone());
        let (rings, middles) = (gauss(8, 0.0, 1.0), 16);
        let average = |of: &[f64]| (0..STEPS).map(|k| 0.5 * (of[k] + of[k + 1])).sum::<f64>() / STEPS as f64;
        for _ in 0..100 {
            // First the hidden light at each height, as a fraction of the mean. Then the mean that follows from this and the direct
            // light.
            let mean = average(&all.0);
            let lost: Vec<f64> = (0..=STEPS)
                .map(|k| {
                    let z = height(k);
                    let from = [(1.0 - z * z).max(0.0).sqrt(), 0.0, z];
                    // The mean over the shadow is uniform on the wall: weight the solid angle by the cosine over twice the sine of
                    // the chord. The lamp's disc is nearly at one position, so directions in its cone are even by area.
                    let toward = [0, 1, 2].map(|i| LAMP[i] - from[i]);
                    let d = toward.iter().map(|x| x * x).sum::<f64>().sqrt();
                    let axis = toward.map(|x| x / d);
                    let (u, v) = basis(axis);
                    let sin2 = (RADIUS / d).powi(2);
                    let (mut hidden, mut weight) = (0.0, 0.0);
                    for &(s, w) in &rings {
                        let sin = (s * sin2).sqrt();
                        let cos = (1.0 - s * sin2).sqrt();
                        for m in 0..middles {
                            let (b, a) = (TAU * (f64::from(m) + 0.5) / f64::from(middles)).sin_cos();
                            let dir = [0, 1, 2].map(|i| axis[i] * cos + (u[i] * a + v[i] * b) * sin);
                            // On the wall, dA = 4 cos dw (chord 2 cos), so weight by the cosine and by dw = sin dsin / cos.
                            let at_wall = -(dir[0] * from[0] + dir[1] * from[1] + dir[2] * from[2]);
                            let w = w * at_wall / cos;
                            hidden += w * all.at(chord(from, dir)[2]);
                            weight += w;
                        }
                    }
                    share(z) * hidden / weight / mean
                })
                .collect();
            let mean = average(&direct) / (1.0 - rho * (1.0 - average(&lost)));
            let next: Vec<f64> =
                direct.iter().zip(&lost).map(|(direct, lost)| direct + rho * mean * (1.0 - lost)).collect();
            let change = next.iter().zip(&all.0).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
            all.0 = next;
            if change < 1e-10 {
                break;
            }
        }
        all
    }

    fn at(&self, z: f64) -> f64 {
        let x = (0.5 * (z + 1.0) * STEPS as f64).clamp(0.0, STEPS as f64 - 1e-9);
        let k = x as usize;
        self.0[k] + (self.0[k + 1] - self.0[k]) * (x - k as f64)
    }
}

/// Returns the point where a ray from a point in the unit sphere hits it.
fn chord(from: [f64; 3], dir: [f64; 3]) -> [f64; 3] {
    let b: f64 = (0..3).map(|i| from[i] * dir[i]).sum();
    let c = from.iter().map(|x| x * x).sum::<f64>() - 1.0;
    let t = -b + (b * b - c).max(0.0).sqrt();
    [0, 1, 2].map(|i| from[i] + t * dir[i])
}

fn normalize(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.map(|x| x / length)
}

fn basis(n: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let u = normalize(if n[0].abs() > 0.6 { [-n[2], 0.0, n[0]] } else { [0.0, n[2], -n[1]] });
    (u, [n[1] * u[2] - n[2] * u[1], n[2] * u[0] - n[0] * u[2], n[0] * u[1] - n[1] * u[0]])
}

#[cfg(test)]
mod tests {
    use super::Illuminance;

    #[test]
    fn an_integrating_sphere_is_nearly_as_its_port_fraction_says() {
        let (rho, f, area) = (0.99, 0.0025, 4.0 * std::f64::consts::PI);
        let wall = Illuminance::new(rho);
        let mean = wall.0.iter().sum::<f64>() / wall.0.len() as f64;
        let expected = 1000.0 / area / (1.0 - rho * (1.0 - f));
        println!("{mean} lx, {expected} by the formula");
        assert!((mean / expected - 1.0).abs() < 2e-3);
    }
}
