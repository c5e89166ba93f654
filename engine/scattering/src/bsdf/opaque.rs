//! Diffuse plus GGX or mirror reflection: `f = rd C / pi + rs F D G2 / (4 cos_o cos_i)`.
//!
//! Covers plastics (dielectric index), metals (complex index, no diffuse part) and the format's plain `rd` + `rs`.
//! One of the two lobes is picked in proportion to its largest albedo channel at `wo`; `pdf` is the mixture's.

use super::{BsdfSample, LobeKind, Sides, Transmitted, coat::Coat, flip_to_side};
#[cfg(test)]
use super::{Example, MaterialParameters, WARM};
use crate::microfacet::{SMOOTH_ALPHA, reflect, reflection_lobe, sample_visible_normal};
use femc_math::{Rgb, color::luminance, glam::Vec3A, warp};
use std::f32::consts::FRAC_1_PI;

/// An opaque surface with a diffuse and a specular part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opaque {
    /// Diffuse reflectance.
    pub rd: Rgb,
    /// Specular part.
    pub coat: Coat,
    /// GGX roughness; at most [`SMOOTH_ALPHA`] means a mirror.
    pub alpha: f32,
    /// Sides that reflect.
    pub sides: Sides,
}

impl Opaque {
    /// Checks whether the specular part is a delta.
    #[inline]
    pub fn is_smooth(&self) -> bool {
        self.alpha <= SMOOTH_ALPHA
    }

    /// Returns the luminance of the diffuse reflectance and of the specular reflectance toward `wo`, and the roughness.
    #[inline]
    pub fn lobes(&self, wo: Vec3A) -> (f32, f32, f32) {
        let cos = wo.z.abs();
        (luminance(self.rd * self.coat.transmitted(cos)), luminance(self.coat.reflectance(cos)), self.alpha)
    }

    /// Returns the probability of the specular lobe at `cos_o` = |wo.z|.
    #[inline]
    fn specular_probability(&self, cos_o: f32) -> f32 {
        let specular = self.coat.reflectance(cos_o).max_element();
        let diffuse = (self.rd * self.coat.transmitted(cos_o)).max_element();
        if specular + diffuse > 0.0 { specular / (specular + diffuse) } else { 0.0 }
    }

    /// Turns both directions to the upper side. `None` if nothing is reflected.
    #[inline]
    fn flipped_upward(&self, wo: Vec3A, wi: Vec3A) -> Option<(Vec3A, Vec3A)> {
        (wo.z * wi.z > 0.0 && self.sides.exist_at(wo.z)).then(|| (flip_to_side(wo, wo.z), flip_to_side(wi, wi.z)))
    }

    /// Returns the value and density of the non-delta parts.
    #[inline]
    fn eval_pdf(&self, wo: Vec3A, wi: Vec3A) -> (Rgb, f32) {
        let p = self.specular_probability(wo.z);
        let cosine = wi.z * FRAC_1_PI;
        let mut value = self.rd * self.coat.diffuse_factor(wo.z, wi.z) * cosine;
        let mut pdf = (1.0 - p) * cosine;
        if !self.is_smooth() {
            let lobe = reflection_lobe(wo, wi, self.alpha);
            value += self.coat.reflectance(lobe.cos_half) * lobe.value;
            pdf += p * lobe.pdf;
        }
        (value, pdf)
    }

    /// Returns f |cos wi| without a delta part, 1/sr.
    #[inline]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> Rgb {
        self.flipped_upward(wo, wi).map_or(Rgb::ZERO, |(wo, wi)| self.eval_pdf(wo, wi).0)
    }

    /// Returns the density of `sample` without a delta part, 1/sr.
    #[inline]
    pub fn pdf(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        self.flipped_upward(wo, wi).map_or(0.0, |(wo, wi)| self.eval_pdf(wo, wi).1)
    }

    /// Samples a direction; `choice` picks the lobe.
    #[inline]
    pub fn sample(&self, wo: Vec3A, u: [f32; 2], choice: f32) -> Option<BsdfSample> {
        if wo.z == 0.0 || !self.sides.exist_at(wo.z) {
            return None;
        }
        let up = flip_to_side(wo, wo.z);
        let p = self.specular_probability(up.z);
        let (wi, lobe) = if choice < p {
            if self.is_smooth() {
                return Some(BsdfSample {
                    wi: Vec3A::new(-wo.x, -wo.y, wo.z),
                    weight: self.coat.reflectance(up.z) / p,
                    pdf: p,
                    lobe: LobeKind::Delta,
                    transmitted: Transmitted::No,
                    eta: 1.0,
                });
            }
            (reflect(up, sample_visible_normal(up, self.alpha, u)), LobeKind::Glossy)
        } else {
            (warp::cosine_hemisphere(u), LobeKind::Diffuse)
        };
        if wi.z <= 0.0 {
            return None;
        }
        let (value, pdf) = self.eval_pdf(up, wi);
        (pdf > 0.0).then(|| BsdfSample {
            wi: flip_to_side(wi, wo.z),
            weight: value / pdf,
            pdf,
            lobe,
            transmitted: Transmitted::No,
            eta: 1.0,
        })
    }

    /// Returns the directional albedo. The energy that single scattering loses in rough lobes is not subtracted.
    #[inline]
    pub fn albedo(&self, wo: Vec3A) -> Rgb {
        let cos = wo.z.abs();
        self.coat.reflectance(cos) + self.rd * self.coat.transmitted(cos)
    }

    /// Returns the share of light from all directions that the diffuse part reflects.
    pub fn hemispherical_diffuse_albedo(&self) -> Rgb {
        let factors = mean_cosines().flat_map(|cos_o| mean_cosines().map(move |cos_i| (cos_o, cos_i)));
        let sum: Rgb = factors.map(|(cos_o, cos_i)| self.coat.diffuse_factor(cos_o, cos_i)).sum();
        self.rd * sum / (DIRECTIONS * DIRECTIONS) as f32
    }

    /// Returns the share of light from all directions that is reflected, without what single scattering loses in rough lobes.
    pub fn hemispherical_albedo(&self) -> Rgb {
        let mut specular = Rgb::ZERO;
        for cos in mean_cosines() {
            if self.is_smooth() {
                specular += self.coat.reflectance(cos) / DIRECTIONS as f32;
                continue;
            }
            let wo = Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, cos);
            for k in 0..DIRECTIONS * DIRECTIONS {
                let u = [k % DIRECTIONS, k / DIRECTIONS].map(|k| (k as f32 + 0.5) / DIRECTIONS as f32);
                let wi = reflect(wo, sample_visible_normal(wo, self.alpha, u));
                if wi.z > 0.0 {
                    let lobe = reflection_lobe(wo, wi, self.alpha);
                    let weight = lobe.value / (lobe.pdf * DIRECTIONS.pow(3) as f32);
                    specular += self.coat.reflectance(lobe.cos_half) * weight;
                }
            }
        }
        self.hemispherical_diffuse_albedo() + specular
    }
}

/// Number of strata by which directions are integrated, for each of their two numbers.
const DIRECTIONS: u32 = 16;

/// Returns cosines to the normal that represent the cosine distribution of directions.
fn mean_cosines() -> impl Iterator<Item = f32> {
    (0..DIRECTIONS).map(|k| ((k as f32 + 0.5) / DIRECTIONS as f32).sqrt())
}

/// Materials of this member, for the tests of the laws.
#[cfg(test)]
pub(super) fn examples() -> Vec<Example> {
    let p = MaterialParameters::default();
    let plastic = MaterialParameters { rd: WARM, rs: Rgb::splat(0.5), ior: Some((1.5, 0.0)), ..p };
    let rough = |rs_alpha: f32| {
        [
            Example::rough("gloss", rs_alpha, MaterialParameters { rs: WARM, rs_alpha, ..p }),
            Example::rough("floor", rs_alpha, MaterialParameters { ior: None, rs_alpha, ..plastic }),
            Example::rough("plastic", rs_alpha, MaterialParameters { rs_alpha, ..plastic }),
            Example::rough(
                "silver",
                rs_alpha,
                MaterialParameters { rs: Rgb::ONE, rs_alpha, ior: Some((0.15, 3.6)), ..p },
            ),
        ]
    };
    [Example::new("smooth plastic", plastic)]
        .into_iter()
        .chain(Example::ROUGHNESSES.into_iter().flat_map(rough))
        .collect()
}
