//! A thin sheet: reflection and transmission, each diffuse and specular, on both sides, without refraction.
//!
//! The transmitted GGX lobe is the reflected one mirrored through the surface. With roughness 0, light passes straight through. If
//! `ts` > 0, `rs` and `ts` are used as given (no Fresnel factor). A sheet with an index and without `ts` is a coated translucent
//! surface. Its diffuse parts share the light that the specular part leaves, equally from both sides.

use super::{BsdfSample, LobeKind, Sides, Transmitted, coat::Coat, flip_to_side};
#[cfg(test)]
use super::{Example, MaterialParameters, WARM};
use crate::microfacet::{SMOOTH_ALPHA, reflect, reflection_lobe, sample_visible_normal};
use femc_math::{Rgb, glam::Vec3A, warp};
use std::f32::consts::FRAC_1_PI;

/// A thin translucent or transparent surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sheet {
    /// Diffuse reflectance.
    pub rd: Rgb,
    /// Diffuse transmittance.
    pub td: Rgb,
    /// Specular reflection.
    pub coat: Coat,
    /// Specular transmittance.
    pub ts: Rgb,
    /// Roughness of the reflected lobe; at most [`SMOOTH_ALPHA`] means a mirror.
    pub rs_alpha: f32,
    /// Roughness of the transmitted lobe; at most [`SMOOTH_ALPHA`] means clear.
    pub ts_alpha: f32,
    /// Sides from which the sheet exists.
    pub sides: Sides,
}

/// Selection probabilities, summing to 1 (or all 0).
struct LobeProbabilities {
    rs: f32,
    ts: f32,
    rd: f32,
    td: f32,
}

impl Sheet {
    #[inline]
    fn lobe_probabilities(&self, cos_o: f32) -> LobeProbabilities {
        let left = self.coat.transmitted(cos_o);
        let (rs, ts) = (self.coat.reflectance(cos_o).max_element(), self.ts.max_element());
        let (rd, td) = ((self.rd * left).max_element(), (self.td * left).max_element());
        let sum = rs + ts + rd + td;
        let scale = if sum > 0.0 { 1.0 / sum } else { 0.0 };
        LobeProbabilities { rs: rs * scale, ts: ts * scale, rd: rd * scale, td: td * scale }
    }

    /// Returns the value and density for an upward `wo`, and a `wi` that was turned up from the side `transmitted`.
    #[inline]
    fn eval_pdf(&self, wo: Vec3A, wi: Vec3A, transmitted: Transmitted) -> (Rgb, f32) {
        let selection = self.lobe_probabilities(wo.z);
        let cosine = wi.z * FRAC_1_PI;
        let (diffuse, alpha, p_diffuse, p_specular) = match transmitted {
            Transmitted::No => (self.rd, self.rs_alpha, selection.rd, selection.rs),
            Transmitted::Yes => (self.td, self.ts_alpha, selection.td, selection.ts),
        };
        let mut value = diffuse * self.coat.diffuse_factor(wo.z, wi.z) * cosine;
        let mut pdf = p_diffuse * cosine;
        if p_specular > 0.0 && alpha > SMOOTH_ALPHA {
            let lobe = reflection_lobe(wo, wi, alpha);
            value += lobe.value
                * match transmitted {
                    Transmitted::No => self.coat.reflectance(lobe.cos_half),
                    Transmitted::Yes => self.ts,
                };
            pdf += p_specular * lobe.pdf;
        }
        (value, pdf)
    }

    #[inline]
    fn flipped_upward(&self, wo: Vec3A, wi: Vec3A) -> Option<(Vec3A, Vec3A, Transmitted)> {
        if wo.z * wi.z == 0.0 || !self.sides.exist_at(wo.z) {
            return None;
        }
        let transmitted = if wo.z * wi.z < 0.0 { Transmitted::Yes } else { Transmitted::No };
        Some((flip_to_side(wo, wo.z), flip_to_side(wi, wi.z), transmitted))
    }

    /// Returns f |cos wi| without delta parts, 1/sr.
    #[inline]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> Rgb {
        self.flipped_upward(wo, wi).map_or(Rgb::ZERO, |(wo, wi, t)| self.eval_pdf(wo, wi, t).0)
    }

    /// Returns the density of `sample` without delta parts, 1/sr.
    #[inline]
    pub fn pdf(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        self.flipped_upward(wo, wi).map_or(0.0, |(wo, wi, t)| self.eval_pdf(wo, wi, t).1)
    }

    /// Samples a direction; `choice` picks the lobe.
    #[inline]
    pub fn sample(&self, wo: Vec3A, u: [f32; 2], choice: f32) -> Option<BsdfSample> {
        if wo.z == 0.0 || !self.sides.exist_at(wo.z) {
            return None;
        }
        let up = flip_to_side(wo, wo.z);
        let p = self.lobe_probabilities(up.z);
        let delta = |wi, weight, pdf, transmitted| {
            Some(BsdfSample { wi, weight, pdf, lobe: LobeKind::Delta, transmitted, eta: 1.0 })
        };
        let glossy = |alpha| reflect(up, sample_visible_normal(up, alpha, u));
        let (wi, lobe, transmitted) = if choice < p.rs {
            if self.rs_alpha <= SMOOTH_ALPHA {
                let mirrored = Vec3A::new(-wo.x, -wo.y, wo.z);
                return delta(mirrored, self.coat.reflectance(up.z) / p.rs, p.rs, Transmitted::No);
            }
            (glossy(self.rs_alpha), LobeKind::Glossy, Transmitted::No)
        } else if choice < p.rs + p.ts {
            if self.ts_alpha <= SMOOTH_ALPHA {
                return delta(-wo, self.ts / p.ts, p.ts, Transmitted::Yes);
            }
            (glossy(self.ts_alpha), LobeKind::Glossy, Transmitted::Yes)
        } else {
            let transmitted = if choice < p.rs + p.ts + p.rd { Transmitted::No } else { Transmitted::Yes };
            (warp::cosine_hemisphere(u), LobeKind::Diffuse, transmitted)
        };
        if wi.z <= 0.0 {
            return None;
        }
        let (value, pdf) = self.eval_pdf(up, wi, transmitted);
        let side = match transmitted {
            Transmitted::No => wo.z,
            Transmitted::Yes => -wo.z,
        };
        (pdf > 0.0).then(|| BsdfSample {
            wi: flip_to_side(wi, side),
            weight: value / pdf,
            pdf,
            lobe,
            transmitted,
            eta: 1.0,
        })
    }

    /// Returns the directional albedo, reflected and transmitted. The loss of single scattering is not subtracted.
    #[inline]
    pub fn albedo(&self, wo: Vec3A) -> Rgb {
        let cos = wo.z.abs();
        self.coat.reflectance(cos) + self.ts + (self.rd + self.td) * self.coat.transmitted(cos)
    }
}

/// Materials of this member, for the tests of the laws.
#[cfg(test)]
pub(super) fn examples() -> Vec<Example> {
    let p = MaterialParameters::default();
    let gray = Rgb::splat;
    let smooth = [
        Example::new("translucent", MaterialParameters { rd: gray(0.3), td: WARM, ..p }),
        Example::new("clear sheet", MaterialParameters { rs: gray(0.1), ts: gray(0.8), ..p }),
    ];
    let rough = |rs_alpha: f32| {
        let sheet = MaterialParameters {
            rd: gray(0.1),
            td: gray(0.15),
            rs: WARM * 0.5,
            ts: gray(0.4),
            rs_alpha,
            ts_alpha: 0.5 * rs_alpha,
            ..p
        };
        let ior = Some((1.5, 0.0));
        let waxed = MaterialParameters { rd: gray(0.3), td: gray(0.3), rs: gray(0.4), rs_alpha, ior, ..p };
        [Example::rough("sheet", rs_alpha, sheet), Example::rough("waxed sheet", rs_alpha, waxed)]
    };
    smooth.into_iter().chain(Example::ROUGHNESSES.into_iter().flat_map(rough)).collect()
}
