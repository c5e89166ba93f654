//! White furnaces of rough mirrors: a floor of reflectance 1 under a white sky loses light only by the model's own shadowing. The
//! loss is computed here with quadrature over the microfacets.

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use super::room::{uniform_material, walls};
use crate::text::{camera, horizontal_square, material};
use std::f64::consts::TAU;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let mut cases = Vec::new();
    for degrees in [0.0f64, 45.0, 85.0] {
        for alpha in [0.0, 1e-4, 1e-3, 1e-2, 0.1, 0.3, 1.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let view = camera(&format!("{} 0 {}", -0.9 * sin, 0.9 * cos), "0 0 0", 0.01);
            let floor =
                material("floor", &["sides 2", &format!("rs 1 {alpha}")]) + &horizontal_square("floor", [0.0; 3], 0.9);
            let text = view + &walls(1.0, &uniform_material(1.0, 0.0)) + &floor;
            let name = format!("roughness {alpha:e} seen at {degrees} degrees");
            cases.push(Case::new(name, text, albedo(cos, alpha)).with_slack(1e-4));
        }
    }
    measure_all("gloss", &cases, effort, report);
}

/// Returns the fraction of light from direction `cos` that a GGX mirror reflects: the mean, over microfacet normals of density D
/// cos, of `G2 (wo . h) / (cos_o cos_h)` where the reflected direction is above the surface (\[heitz2014\]).
fn albedo(cos: f64, alpha: f64) -> f64 {
    if alpha == 0.0 {
        return 1.0;
    }
    let a2 = alpha * alpha;
    let wo = [(1.0 - cos * cos).max(0.0).sqrt(), cos];
    let lambda = |z: f64| 0.5 * ((1.0 + a2 * (1.0 / (z * z) - 1.0)).sqrt() - 1.0);
    // Midpoint rule, because the integrand has a kink where reflected directions go below the surface.
    let (rings, spokes) = (600, 400);
    let mut sum = 0.0;
    for ring in 0..rings {
        // Substitutes the square root of 1 - u: at u = 1 the integrand grows as 1 / cos_h.
        let root = (f64::from(ring) + 0.5) / f64::from(rings);
        let (u, weight) = (1.0 - root * root, 2.0 * root);
        let cos_h = ((1.0 - u) / (1.0 + (a2 - 1.0) * u)).sqrt();
        let sin_h = (1.0 - cos_h * cos_h).max(0.0).sqrt();
        for spoke in 0..spokes {
            let phi = TAU * (f64::from(spoke) + 0.5) / f64::from(spokes);
            let d = wo[0] * sin_h * phi.cos() + wo[1] * cos_h;
            let z = 2.0 * d * cos_h - wo[1];
            if d > 0.0 && z > 0.0 {
                sum += weight * d / (wo[1] * cos_h) / (1.0 + lambda(wo[1]) + lambda(z));
            }
        }
    }
    sum / f64::from(rings * spokes)
}

#[cfg(test)]
mod tests {
    use super::albedo;

    #[test]
    fn smooth_mirrors_lose_nothing_and_rough_ones_a_third() {
        assert!((albedo(0.7, 1e-3) - 1.0).abs() < 1e-4);
        let (normal, grazing) = (albedo(1.0, 1.0), albedo(0.1, 1.0));
        println!("{normal} {grazing}");
        assert!(normal > 0.3 && normal < 0.8 && grazing > normal);
    }
}
