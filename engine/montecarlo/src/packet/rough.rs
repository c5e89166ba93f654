//! Rough opaque surfaces in lanes: `femc_scattering::bsdf::Opaque` for viewers on the side of the shading frame's normal.

use super::vectors::{FloatLanes, Functions, V3, VectorLanes};
use femc_math::Rgb;
use femc_scattering::Fresnel;
use femc_scattering::bsdf::Opaque;
use femc_simd::{Simd, Vector};
use std::f32::consts::{FRAC_1_PI, PI};

/// Parameters of the surfaces.
#[derive(Default)]
pub struct RoughLanes {
    /// Lanes with a surface.
    pub used: u32,
    /// Lanes whose Fresnel factor is that of a dielectric, and of a conductor. It is 1 in the others.
    dielectric: u32,
    conductor: u32,
    diffuse: VectorLanes,
    specular: VectorLanes,
    normalization: VectorLanes,
    alpha: FloatLanes,
    eta: FloatLanes,
    k: FloatLanes,
}

impl RoughLanes {
    /// Removes all surfaces.
    #[inline(always)]
    pub fn clear(&mut self) {
        (self.used, self.dielectric, self.conductor) = (0, 0, 0);
    }

    /// Adds a surface.
    #[inline(always)]
    pub fn add(&mut self, lane: usize, surface: &Opaque) {
        self.used |= 1 << lane;
        self.diffuse.set(lane, surface.rd);
        self.specular.set(lane, surface.coat.rs);
        self.alpha.set(lane, surface.alpha);
        match surface.coat.fresnel {
            Fresnel::Unit => self.normalization.set(lane, Rgb::ONE),
            Fresnel::Dielectric { eta } => {
                self.dielectric |= 1 << lane;
                self.eta.set(lane, eta);
                self.normalization.set(lane, surface.coat.normalization());
            }
            Fresnel::Conductor { eta, k } => {
                self.conductor |= 1 << lane;
                self.eta.set(lane, eta);
                self.k.set(lane, k);
                self.normalization.set(lane, surface.coat.normalization());
            }
        }
    }
}

/// Surfaces in the registers, seen by viewers at one cosine each.
pub struct RoughSurfaces<'a, S: Simd> {
    simd: S,
    lanes: &'a RoughLanes,
    wo: V3<S::V>,
    /// Light that the specular part leaves toward the viewer.
    transmitted: V3<S::V>,
    /// Probability of the specular lobe.
    probability: S::V,
}

impl<'a, S: Simd> RoughSurfaces<'a, S> {
    /// Loads the surfaces.
    /// - `wo`: directions toward the viewers, local frame, z > 0.
    #[inline(always)]
    pub fn new(simd: S, lanes: &'a RoughLanes, wo: V3<S::V>) -> Self {
        let zero = simd.splat(0.0);
        let mut surfaces = Self { simd, lanes, wo, transmitted: V3 { x: zero, y: zero, z: zero }, probability: zero };
        let reflectance = surfaces.reflectance(wo.z);
        surfaces.transmitted = surfaces.left_by(reflectance);
        let specular = reflectance.max_element();
        let diffuse = (lanes.diffuse.load(simd) * surfaces.transmitted).max_element();
        let sum = specular + diffuse;
        surfaces.probability = simd.is_positive(sum) & (specular / sum);
        surfaces
    }

    /// Returns the specular reflectance at cosines in [0, 1].
    #[inline(always)]
    fn reflectance(&self, cos: S::V) -> V3<S::V> {
        let Self { simd, lanes, .. } = *self;
        let mut factor = simd.splat(1.0);
        if lanes.dielectric != 0 {
            factor = simd.mask(lanes.dielectric).select(dielectric(simd, cos, simd.load(&lanes.eta.0)), factor);
        }
        if lanes.conductor != 0 {
            let (eta, k) = (simd.load(&lanes.eta.0), simd.load(&lanes.k.0));
            factor = simd.mask(lanes.conductor).select(conductor(simd, cos, eta, k), factor);
        }
        lanes.specular.load(simd).scale(factor)
    }

    /// Returns the light that a specular part with this reflectance leaves.
    #[inline(always)]
    fn left_by(&self, reflectance: V3<S::V>) -> V3<S::V> {
        let one = self.simd.splat(1.0);
        let ones = V3 { x: one, y: one, z: one };
        (ones - reflectance).or_else(self.simd.mask(self.lanes.dielectric | self.lanes.conductor), ones)
    }

    /// Returns the value times the cosine, and the density, 1/sr: `Opaque::eval_pdf`. Both are 0 below the surface.
    #[inline(always)]
    pub fn eval_pdf(&self, wi: V3<S::V>) -> (V3<S::V>, S::V) {
        let Self { simd, lanes, wo, transmitted, probability } = *self;
        let one = simd.splat(1.0);
        let half = simd.splat(0.5);
        let cosine = wi.z * simd.splat(FRAC_1_PI);
        let factor = transmitted * self.left_by(self.reflectance(wi.z)) * lanes.normalization.load(simd);
        let diffuse = (lanes.diffuse.load(simd) * factor).scale(cosine);
        let sum = wo + wi;
        let scale = one / sum.dot(sum).sqrt();
        let is_finite = simd.is_positive(scale) & scale.lt(simd.splat(f32::INFINITY));
        let zero = simd.splat(0.0);
        let h = sum.scale(scale).or_else(is_finite, V3 { x: zero, y: zero, z: one });
        let alpha = simd.load(&lanes.alpha.0);
        let alpha2 = alpha * alpha;
        let t = h.x * h.x + h.y * h.y + alpha2 * h.z * h.z;
        let distribution = alpha2 / (simd.splat(PI) * t * t);
        let rest = one - alpha2;
        let root_o = (alpha2 + rest * wo.z * wo.z).sqrt();
        let root_i = (alpha2 + rest * wi.z * wi.z).sqrt();
        let visibility = half / (wi.z * root_o + wo.z * root_i);
        let value = distribution * wi.z * visibility;
        let density = distribution * (half / (wo.z + root_o));
        let cos_half = wo.dot(h).max(zero).min(one);
        let glossy = self.reflectance(cos_half).scale(value);
        let pdf = (one - probability) * cosine + probability * density;
        let above = simd.is_positive(wo.z * wi.z);
        ((diffuse + glossy).masked(above), above & pdf)
    }

    /// Samples directions: `Opaque::sample`. Returns directions, weights and densities, 1/sr. A density of 0 means that the light
    /// is absorbed.
    #[inline(always)]
    pub fn sample(&self, u: [S::V; 2], choice: S::V) -> (V3<S::V>, V3<S::V>, S::V) {
        let Self { simd, lanes, wo, probability, .. } = *self;
        let (zero, one) = (simd.splat(0.0), simd.splat(1.0));
        let alpha = simd.load(&lanes.alpha.0);
        // A visible normal.
        let stretched = V3 { x: wo.x * alpha, y: wo.y * alpha, z: wo.z };
        let stretched = stretched.over(stretched.dot(stretched).sqrt());
        let half_z = (one - u[1]) * (one + stretched.z);
        let z = half_z - stretched.z;
        let r = ((one - z) * (one + z)).max(zero).sqrt();
        let [sin, cos] = simd.sin_cos_of_turns(u[0]);
        let normal = V3 { x: (r * cos + stretched.x) * alpha, y: (r * sin + stretched.y) * alpha, z: half_z };
        let normal = normal.over(normal.dot(normal).sqrt());
        let glossy = normal.scale(simd.splat(2.0) * wo.dot(normal)) - wo;
        let wi = glossy.or_else(choice.lt(probability), simd.cosine_hemisphere(u));
        let (value, pdf) = self.eval_pdf(wi);
        let pdf = simd.is_positive(wi.z) & pdf;
        (wi, value.over(pdf).masked(simd.is_positive(pdf)), pdf)
    }
}

/// `fresnel::dielectric`.
#[inline(always)]
fn dielectric<S: Simd>(simd: S, cos: S::V, eta: S::V) -> S::V {
    let (one, half) = (simd.splat(1.0), simd.splat(0.5));
    let sin2 = (one - cos) * (one + cos) / (eta * eta);
    let transmitted = (one - sin2).sqrt();
    let s = (cos - eta * transmitted) / (cos + eta * transmitted);
    let p = (eta * cos - transmitted) / (eta * cos + transmitted);
    one.le(sin2).select(one, (half * (s * s + p * p)).min(one))
}

/// `fresnel::conductor`.
#[inline(always)]
fn conductor<S: Simd>(simd: S, cos: S::V, eta: S::V, k: S::V) -> S::V {
    let (zero, one, half) = (simd.splat(0.0), simd.splat(1.0), simd.splat(0.5));
    let cos2 = cos * cos;
    let sin2 = one - cos2;
    let real = eta * eta - k * k - sin2;
    let modulus = (real * real + simd.splat(4.0) * eta * eta * k * k).sqrt();
    let a = (half * (modulus + real)).max(zero).sqrt();
    let s_sum = modulus + cos2;
    let s_cross = simd.splat(2.0) * cos * a;
    let s = (s_sum - s_cross) / (s_sum + s_cross);
    let p_sum = cos2 * modulus + sin2 * sin2;
    let p_cross = s_cross * sin2;
    let p = s * (p_sum - p_cross) / (p_sum + p_cross);
    (half * (s + p)).max(zero).min(one)
}
