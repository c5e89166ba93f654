//! Weights of lights for a point: the unoccluded light that arrives there, times the fraction that is scattered on.

use super::approx::exp;
use super::light_blocks::{LightLanes, Weigh, dot, splat, subtract};
use crate::tree::{BsdfLobes, PointContext};
use femc_math::glam::Vec3A;
use femc_simd::{Simd, Vector};
use std::f32::consts::FRAC_1_PI;

/// Lower bound of cosines: bounds are exact only up to rounding.
const COSINE_TOLERANCE: f32 = 1e-3;

impl Weigh for PointContext {
    #[inline(always)]
    fn weigh<S: Simd>(&self, simd: S, lights: &LightLanes<S>) -> S::V {
        let c = |x| simd.splat(x);
        let (zero, one) = (c(0.0), c(1.0));
        let position = splat(simd, self.position);
        let toward = subtract(lights.center, position);
        let distance2 = dot(toward, toward);
        let least2 = (lights.radius * lights.radius).max(c(1e-20));
        let bounded2 = distance2.max(least2);
        let distance = bounded2.sqrt();
        let inverse = one / distance;
        let [profile, below] = lights.profile((zero - dot(lights.axis, toward)) * inverse, inverse);
        let mut weight = lights.intensity * profile;
        if self.normal != Vec3A::ZERO {
            let sin = (lights.radius * inverse).min(one);
            let cos = dot(splat(simd, self.normal), toward) * inverse;
            let bound = cos * (one - sin * sin).max(zero).sqrt() + sin;
            let lit = bound.min(one).max(c(COSINE_TOLERANCE));
            let value = match &self.lobes {
                None => lit,
                Some(lobes) => scattered_luminance(simd, lobes, self.normal, toward, inverse, lit, sin),
            };
            weight = c(-COSINE_TOLERANCE).lt(bound).select(weight * value, zero);
        }
        weight / (below * bounded2 * exp(simd, lights.extinction * distance))
    }
}

/// Computes the luminance that the lobes scatter from `toward` (not unit), 1/sr, times the cosine.
/// - `cos`: of the light, > 0; `sin`: of the angle that its radius subtends.
#[inline(always)]
fn scattered_luminance<S: Simd>(
    simd: S,
    lobes: &BsdfLobes,
    normal: Vec3A,
    toward: [S::V; 3],
    inverse: S::V,
    cos: S::V,
    sin: S::V,
) -> S::V {
    let c = |x| simd.splat(x);
    let diffuse = c(lobes.diffuse * FRAC_1_PI) * cos;
    if lobes.glossy <= 0.0 {
        return diffuse;
    }
    // A microfacet lobe (\[walter2007\]), widened by half the light's angle.
    let cos_o = lobes.wo.dot(normal).max(COSINE_TOLERANCE);
    let between = dot(splat(simd, lobes.wo), toward) * inverse;
    let half = c(cos_o) + cos;
    let cos_h2 = (half * half / (c(2.0) + c(2.0) * between).max(c(1e-12))).min(c(1.0));
    let alpha2 = c(lobes.alpha * lobes.alpha) + c(0.25) * sin * sin;
    let t = (c(1.0) - cos_h2) + alpha2 * cos_h2;
    let normals = alpha2 / (c(std::f32::consts::PI) * t * t);
    let rough2 = lobes.alpha * lobes.alpha;
    let root_o = (rough2 + (1.0 - rough2) * cos_o * cos_o).sqrt();
    let root_i = (c(rough2) + c(1.0 - rough2) * cos * cos).sqrt();
    let masked = c(0.5) * cos / (cos * c(root_o) + c(cos_o) * root_i);
    diffuse + c(lobes.glossy) * normals.min(c(1e12)) * masked + c(1e-4) * cos
}
