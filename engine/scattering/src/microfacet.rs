//! GGX microfacets with height-correlated Smith shadowing (\[walter2007\], \[heitz2014\]).
//!
//! All directions are on the upper side (z > 0); callers flip them. `alpha` is the roughness, > 0. Normals are sampled among the
//! VISIBLE ones (\[heitz2018\]) by spherical caps (\[dupuy2023\]). There is only single scattering, so rough lobes lose energy.

use femc_math::elementary::sin_cos_of_turns;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Roughness up to which a lobe is treated as perfectly specular: it is narrower than `f32` directions resolve.
pub const SMOOTH_ALPHA: f32 = 1e-4;

/// Returns the density of microfacet normals, `D(h)` in 1/sr; `int D(h) h.z dh = 1`. It uses the slopes, so it is exact near the
/// pole.
#[inline]
pub fn normal_distribution(h: Vec3A, alpha: f32) -> f32 {
    let alpha2 = alpha * alpha;
    let t = h.x * h.x + h.y * h.y + alpha2 * h.z * h.z;
    alpha2 / (PI * t * t)
}

/// Returns `cos (1 + 2 Lambda)` of a direction with cosine `cos` > 0, the only form of Smith's Lambda that stays finite at grazing
/// angles.
#[inline]
pub fn smith_root(cos: f32, alpha: f32) -> f32 {
    let alpha2 = alpha * alpha;
    (alpha2 + (1.0 - alpha2) * cos * cos).sqrt()
}

/// Returns the height-correlated `G2 / (4 cos_o cos_i)`.
#[inline]
pub fn visibility(cos_o: f32, cos_i: f32, alpha: f32) -> f32 {
    0.5 / (cos_i * smith_root(cos_o, alpha) + cos_o * smith_root(cos_i, alpha))
}

/// Returns `G1(o) / (4 cos_o)`: times `D`, it is the density of reflected directions from visible normals.
#[inline]
pub fn masking_density(cos_o: f32, alpha: f32) -> f32 {
    0.5 / (cos_o + smith_root(cos_o, alpha))
}

/// Returns `G2 / G1(o)`, in [0, 1].
#[inline]
pub fn shadowing_given_masking(cos_o: f32, cos_i: f32, alpha: f32) -> f32 {
    let (root_o, root_i) = (smith_root(cos_o, alpha), smith_root(cos_i, alpha));
    cos_i * (cos_o + root_o) / (cos_i * root_o + cos_o * root_i)
}

/// Samples a microfacet normal visible from `wo` (z > 0) with density `G1 D max(0, wo.h) / wo.z`.
#[inline]
pub fn sample_visible_normal(wo: Vec3A, alpha: f32, u: [f32; 2]) -> Vec3A {
    let stretched = Vec3A::new(wo.x * alpha, wo.y * alpha, wo.z).normalize();
    // A point of the cap of reflected directions, z in (-stretched.z, 1]. The half vector's z is computed without cancellation.
    let half_z = (1.0 - u[1]) * (1.0 + stretched.z);
    let z = half_z - stretched.z;
    let r = ((1.0 - z) * (1.0 + z)).max(0.0).sqrt();
    let (sin, cos) = sin_cos_of_turns(u[0]);
    Vec3A::new((r * cos + stretched.x) * alpha, (r * sin + stretched.y) * alpha, half_z).normalize()
}

/// Returns the mirror image of `w` about `axis` (unit).
#[inline]
pub fn reflect(w: Vec3A, axis: Vec3A) -> Vec3A {
    axis * (2.0 * w.dot(axis)) - w
}

/// Returns the reflection lobe `D G2 / (4 cos_o)` (f |cos_i| without the Fresnel factor) and its density, both for z > 0.
#[inline]
pub fn reflection_lobe(wo: Vec3A, wi: Vec3A, alpha: f32) -> MicrofacetLobe {
    let h = (wo + wi).normalize_or(Vec3A::Z);
    let d = normal_distribution(h, alpha);
    MicrofacetLobe {
        value: d * wi.z * visibility(wo.z, wi.z, alpha),
        pdf: d * masking_density(wo.z, alpha),
        cos_half: wo.dot(h).clamp(0.0, 1.0),
    }
}

/// Value and density of a microfacet lobe for one pair of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MicrofacetLobe {
    /// f |cos_i| without the Fresnel factor, 1/sr.
    pub value: f32,
    /// Density of sampling by visible normals, 1/sr.
    pub pdf: f32,
    /// Cosine between `wo` and the half vector: the argument of the Fresnel factor.
    pub cos_half: f32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::warp;

    #[test]
    fn the_normal_distribution_projects_to_one() {
        for alpha in [0.02f32, 0.1, 0.5, 1.0] {
            // Integrated in t = tan^2: D cos dw = alpha^2 dt / (alpha^2 + t)^2 over the azimuth; here numerically in theta.
            let n = 200_000;
            let mut sum = 0.0f64;
            for i in 0..n {
                let x = (i as f64 + 0.5) / n as f64;
                let theta = std::f64::consts::FRAC_PI_2 * x * x * x;
                let weight = std::f64::consts::FRAC_PI_2 * 3.0 * x * x / n as f64;
                let h = Vec3A::new(theta.sin() as f32, 0.0, theta.cos() as f32);
                let d = f64::from(normal_distribution(h, alpha));
                sum += d * theta.cos() * theta.sin() * std::f64::consts::TAU * weight;
            }
            assert!((sum - 1.0).abs() < 1e-4, "alpha {alpha}: {sum}");
        }
    }

    #[test]
    fn sampled_normals_are_valid_at_grazing_angles_and_tiny_alpha() {
        for alpha in [2e-4f32, 0.02, 0.3, 1.0] {
            for cos in [1.0f32, 0.5, 0.01, 1e-6] {
                let wo = warp::direction(cos, 0.1);
                for i in 0..2000u32 {
                    let u = [(i as f32 * 0.618_034).fract(), (i as f32 + 0.5) / 2000.0];
                    let h = sample_visible_normal(wo, alpha, u);
                    assert!((h.length() - 1.0).abs() < 1e-5 && h.z >= 0.0 && wo.dot(h) > -1e-6, "{alpha} {cos} {h}");
                }
            }
        }
    }

    #[test]
    fn the_forms_of_the_smith_terms_agree_with_the_definition() {
        let lambda = |cos: f64, a: f64| 0.5 * ((1.0 + a * a * (1.0 / (cos * cos) - 1.0)).sqrt() - 1.0);
        for a in [0.05f32, 0.4, 1.0] {
            for (o, i) in [(0.9f32, 0.3f32), (0.02, 0.8), (0.05, 0.04)] {
                let (lo, li) = (lambda(o.into(), a.into()), lambda(i.into(), a.into()));
                let g2 = 1.0 / (1.0 + lo + li);
                let expected = g2 / (4.0 * f64::from(o) * f64::from(i));
                assert!((f64::from(visibility(o, i, a)) / expected - 1.0).abs() < 1e-5);
                assert!((f64::from(masking_density(o, a)) * 4.0 * f64::from(o) * (1.0 + lo) - 1.0).abs() < 1e-5);
                assert!((f64::from(shadowing_given_masking(o, i, a)) / (g2 * (1.0 + lo)) - 1.0).abs() < 1e-5);
            }
        }
    }
}
