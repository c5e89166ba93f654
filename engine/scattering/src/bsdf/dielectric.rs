//! Boundary of a solid dielectric, smooth or rough (\[walter2007\]).
//!
//! Reflection is F, transmission `(1 - F) ts`. Radiance refracted from index `n_i` to `n_o` scales by `(n_o / n_i)^2`. That factor
//! is in the weights, and `eta` = `n_i / n_o` of a sample lets Russian roulette remove it. Shadowing is
//! `1 / (1 + Lambda_o + Lambda_i)` for both lobes. A diffuse part, if there is one, shares the light as in [`super::coat`], where R
//! is the F of each direction's own side: `f_r = rd T(o) T(i) / (pi (1 - F_mean))`,
//! `f_t = td T(o) T(i) n_o^2 / (pi (1 - F_mean outside))` with T = 1 - F.

use super::{BsdfSample, LobeKind, Transmitted, flip_to_side};
#[cfg(test)]
use super::{Example, MaterialParameters, Sides, WARM};
use crate::Fresnel;
use crate::fresnel::{Interface, dielectric};
use crate::microfacet::{
    SMOOTH_ALPHA, masking_density, normal_distribution, reflect, reflection_lobe, sample_visible_normal, visibility,
};
use femc_math::{Rgb, glam::Vec3A, warp};
use std::f32::consts::FRAC_1_PI;

/// Relative distance of the index from 1 below which light passes straight through and nothing is reflected.
const INDEX_TOLERANCE: f32 = 1e-3;

/// A dielectric interface between the outside (front, index 1) and the inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dielectric {
    /// Index of the inside relative to the outside, > 0.
    eta: f32,
    /// Specular transmittance of one crossing.
    ts: Rgb,
    /// GGX roughness of both lobes; at most [`SMOOTH_ALPHA`] means smooth.
    alpha: f32,
    /// Diffuse reflectance.
    rd: Rgb,
    /// Diffuse transmittance.
    td: Rgb,
    /// `1 - F_mean` seen from the outside. From the inside it is this value divided by `eta^2`.
    transmitted_mean: f32,
}

/// Probabilities of choosing a lobe.
struct LobeProbabilities {
    specular: f32,
    rd: f32,
    td: f32,
}

impl Dielectric {
    /// Creates the boundary.
    /// - `eta`: index of the inside over the outside, > 0;
    /// - `alpha`: roughness of both specular lobes.
    pub fn new(eta: f32, ts: Rgb, alpha: f32, rd: Rgb, td: Rgb) -> Self {
        let matched = (eta - 1.0).abs() < INDEX_TOLERANCE;
        let (eta, alpha) = if matched { (1.0, 0.0) } else { (eta, alpha) };
        let transmitted_mean = Fresnel::Dielectric { eta }.transmitted_mean();
        Self { eta, ts, alpha, rd, td, transmitted_mean }
    }

    /// Multiplies the diffuse reflectance by `factor`.
    pub fn with_diffuse_factor(mut self, factor: Rgb) -> Self {
        self.rd *= factor;
        self
    }

    /// Removes the diffuse parts.
    #[cfg(test)]
    pub(crate) fn without_diffuse(self) -> Self {
        Self { rd: Rgb::ZERO, td: Rgb::ZERO, ..self }
    }

    /// Makes the specular lobes deltas.
    pub fn smooth(mut self) -> Self {
        self.alpha = 0.0;
        self
    }

    /// Checks whether the specular lobes are deltas.
    #[inline]
    pub fn is_smooth(&self) -> bool {
        self.alpha <= SMOOTH_ALPHA
    }

    /// Returns the share of the light that goes straight through an index-matched interface, which reflects nothing.
    #[inline]
    pub fn straight_through(&self) -> Rgb {
        if self.eta == 1.0 && self.is_smooth() { self.ts } else { Rgb::ZERO }
    }

    /// Checks whether there is a diffuse part.
    #[inline]
    pub fn has_diffuse(&self) -> bool {
        self.rd.max_element() > 0.0 || self.td.max_element() > 0.0
    }

    /// Returns the index of the other side over that of the side with the sign of `z`.
    #[inline]
    fn eta_from(&self, z: f32) -> f32 {
        if z > 0.0 { self.eta } else { 1.0 / self.eta }
    }

    #[inline]
    fn lobe_probabilities(&self, cos_o: f32, eta: f32) -> LobeProbabilities {
        if !self.has_diffuse() {
            return LobeProbabilities { specular: 1.0, rd: 0.0, td: 0.0 };
        }
        let f = dielectric(cos_o, eta).reflectance;
        let specular = f + (1.0 - f) * self.ts.max_element();
        let (rd, td) = ((1.0 - f) * self.rd.max_element(), (1.0 - f) * self.td.max_element());
        let sum = specular + rd + td;
        LobeProbabilities { specular: specular / sum, rd: rd / sum, td: td / sum }
    }

    /// Returns the probability of reflection for a facet with reflectance `f`.
    #[inline]
    fn reflection_probability(&self, f: f32) -> f32 {
        let through = (1.0 - f) * self.ts.max_element();
        if f + through > 0.0 { f / (f + through) } else { 1.0 }
    }

    /// Returns the half vector on `wo`'s side, for `wo` up and `wi` down; `None` if no facet connects the two.
    #[inline]
    fn half_vector(wo: Vec3A, wi: Vec3A, eta: f32) -> Option<Vec3A> {
        let h = (wo + wi * eta).normalize_or_zero();
        let h = if h.z < 0.0 { -h } else { h };
        (h.z > 0.0 && wo.dot(h) > 0.0 && wi.dot(h) < 0.0).then_some(h)
    }

    /// Returns the value and density of the non-delta parts; `wo` up, `wi` on either side, `eta` the other side over `wo`'s.
    fn eval_pdf(&self, wo: Vec3A, wi: Vec3A, eta: f32) -> (Rgb, f32) {
        let selection = self.lobe_probabilities(wo.z, eta);
        let (mut value, mut pdf) = (Rgb::ZERO, 0.0);
        let cos_i = wi.z.abs();
        let left = |cos, eta| 1.0 - dielectric(cos, eta).reflectance;
        // Index of wo's side, squared: the outside has index 1, and seen from the inside `eta` is the inverse index.
        let n_o2 = if eta == self.eta { 1.0 } else { self.eta * self.eta };
        if wi.z > 0.0 {
            if selection.rd > 0.0 {
                let shared = left(wo.z, eta) * left(cos_i, eta) * n_o2 / self.transmitted_mean;
                value += self.rd * (shared * cos_i * FRAC_1_PI);
                pdf += selection.rd * cos_i * FRAC_1_PI;
            }
            if !self.is_smooth() {
                let lobe = reflection_lobe(wo, wi, self.alpha);
                let f = dielectric(lobe.cos_half, eta).reflectance;
                value += Rgb::splat(f * lobe.value);
                pdf += selection.specular * self.reflection_probability(f) * lobe.pdf;
            }
        } else {
            if selection.td > 0.0 {
                let shared = left(wo.z, eta) * left(cos_i, 1.0 / eta) * n_o2 / self.transmitted_mean;
                value += self.td * (shared * cos_i * FRAC_1_PI);
                pdf += selection.td * cos_i * FRAC_1_PI;
            }
            if !self.is_smooth()
                && let Some(h) = Self::half_vector(wo, wi, eta)
            {
                let (o_h, i_h) = (wo.dot(h), -wi.dot(h));
                let f = dielectric(o_h.min(1.0), eta).reflectance;
                let d = normal_distribution(h, self.alpha);
                let denominator = o_h - eta * i_h;
                let jacobian = 4.0 * o_h * i_h / (denominator * denominator);
                value += self.ts * ((1.0 - f) * d * cos_i * visibility(wo.z, cos_i, self.alpha) * jacobian);
                let through = 1.0 - self.reflection_probability(f);
                pdf += selection.specular * through * d * masking_density(wo.z, self.alpha) * jacobian * eta * eta;
            }
        }
        (value, pdf)
    }

    /// Returns f |cos wi| without delta parts, 1/sr.
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> Rgb {
        if wo.z * wi.z == 0.0 {
            return Rgb::ZERO;
        }
        self.eval_pdf(flip_to_side(wo, wo.z), flip_to_side(wi, wo.z), self.eta_from(wo.z)).0
    }

    /// Returns the density of `sample` without delta parts, 1/sr.
    pub fn pdf(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        if wo.z * wi.z == 0.0 {
            return 0.0;
        }
        self.eval_pdf(flip_to_side(wo, wo.z), flip_to_side(wi, wo.z), self.eta_from(wo.z)).1
    }

    /// Samples a direction; `choice` picks the lobe.
    pub fn sample(&self, wo: Vec3A, u: [f32; 2], choice: f32) -> Option<BsdfSample> {
        if wo.z == 0.0 {
            return None;
        }
        let up = flip_to_side(wo, wo.z);
        let eta = self.eta_from(wo.z);
        let p = self.lobe_probabilities(up.z, eta);
        let (wi, lobe) = if choice < p.specular {
            let choice = choice / p.specular;
            if self.is_smooth() {
                return self.sample_smooth(wo, choice, p.specular);
            }
            let h = sample_visible_normal(up, self.alpha, u);
            let o_h = up.dot(h).clamp(0.0, 1.0);
            let interface = dielectric(o_h, eta);
            let wi = if choice < self.reflection_probability(interface.reflectance) {
                let wi = reflect(up, h);
                (wi.z > 0.0).then_some(wi)?
            } else {
                let wi = refract(up, h, o_h, eta, interface);
                (wi.z < 0.0).then_some(wi)?
            };
            (wi, LobeKind::Glossy)
        } else {
            let up_wi = warp::cosine_hemisphere(u);
            (if choice < p.specular + p.rd { up_wi } else { flip_to_side(up_wi, -1.0) }, LobeKind::Diffuse)
        };
        let (value, pdf) = self.eval_pdf(up, wi, eta);
        let (transmitted, eta) = if wi.z < 0.0 { (Transmitted::Yes, eta) } else { (Transmitted::No, 1.0) };
        (pdf > 0.0).then(|| BsdfSample {
            wi: Vec3A::new(wi.x, wi.y, if wo.z < 0.0 { -wi.z } else { wi.z }),
            weight: value / pdf,
            pdf,
            lobe,
            transmitted,
            eta,
        })
    }

    fn sample_smooth(&self, wo: Vec3A, choice: f32, selected: f32) -> Option<BsdfSample> {
        let eta = self.eta_from(wo.z);
        let interface = dielectric(wo.z.abs(), eta);
        let f = interface.reflectance;
        let p = self.reflection_probability(f);
        let (wi, weight, p, transmitted, eta) = if choice < p {
            (Vec3A::new(-wo.x, -wo.y, wo.z), Rgb::splat(f), p, Transmitted::No, 1.0)
        } else {
            let z = if wo.z > 0.0 { -interface.cos_transmitted } else { interface.cos_transmitted };
            let wi = Vec3A::new(-wo.x / eta, -wo.y / eta, z).normalize();
            (wi, self.ts * ((1.0 - f) / (eta * eta)), 1.0 - p, Transmitted::Yes, eta)
        };
        let pdf = p * selected;
        (pdf > 0.0).then(|| BsdfSample { wi, weight: weight / pdf, pdf, lobe: LobeKind::Delta, transmitted, eta })
    }

    /// Returns the directional albedo with the square of the index ratio removed. The loss of single scattering is not subtracted.
    pub fn albedo(&self, wo: Vec3A) -> Rgb {
        let f = dielectric(wo.z.abs(), self.eta_from(wo.z)).reflectance;
        Rgb::splat(f) + (self.ts + self.rd + self.td) * (1.0 - f)
    }
}

/// Refracts `wo` (`o_h` = wo.h > 0) through a facet with normal `h`.
#[inline]
fn refract(wo: Vec3A, h: Vec3A, o_h: f32, eta: f32, interface: Interface) -> Vec3A {
    (h * (o_h / eta - interface.cos_transmitted) - wo / eta).normalize()
}

/// Materials of this member, for the tests of the laws.
#[cfg(test)]
pub(super) fn examples() -> Vec<Example> {
    let gray = Rgb::splat;
    let solid =
        |index: f32| MaterialParameters { ior: Some((index, 0.0)), sides: Sides::One, ..MaterialParameters::default() };
    let glass = solid(1.5);
    let milky = MaterialParameters { ts: WARM, rd: gray(0.2), td: gray(0.3), ..glass };
    let smooth =
        [Example::solid("glass", MaterialParameters { ts: gray(1.0), ..glass }), Example::solid("milky glass", milky)];
    let rough = |ts_alpha: f32| {
        let ts = WARM * 2.0;
        [
            ("rough glass", MaterialParameters { ts, ts_alpha, ..glass }),
            ("rough bubble", MaterialParameters { ts, ts_alpha, ..solid(0.75) }),
            ("frosted glass", MaterialParameters { ts_alpha, ..milky }),
        ]
        .map(|(name, p)| Example::solid(&format!("{name} {ts_alpha}"), p))
    };
    smooth.into_iter().chain(Example::ROUGHNESSES.into_iter().flat_map(rough)).collect()
}
