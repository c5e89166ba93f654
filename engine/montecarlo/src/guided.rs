//! Directions at a surface, by the BSDF and by what the first pass knows of where light comes from.
//!
//! A share of the directions is drawn by the guide, the others by the BSDF; whichever it was, the density is that of both together
//! (one-sample multiple importance sampling with the balance heuristic, \[pharr2023\]). The BSDF always has a share, so the mean is
//! right whatever the guide says.

use femc_field::{Directions, Field, Side};
use femc_geometry::Hit;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_math::{Frame, Rgb};
use femc_prepared::SurfacePoint;
use femc_scattering::{Bsdf, BsdfSample, LobeKind, Transmitted};

/// How directions are drawn at a vertex.
pub struct Scattering<'a> {
    bsdf: &'a Bsdf,
    frame: &'a Frame,
    /// Local frame, toward where the path came from.
    wo: Vec3A,
    guide: Option<(Directions<'a>, f32)>,
}

impl<'a> Scattering<'a> {
    /// - `field`: what guides; `None`: nothing.
    pub fn new(
        field: Option<&'a Field>,
        (bsdf, frame, wo): (&'a Bsdf, &'a Frame, Vec3A),
        (hit, point, back): (&Hit, &SurfacePoint, bool),
    ) -> Self {
        let guide = || {
            // Of a gloss the guide knows nothing.
            let diffuse = luminance(bsdf.lambertian(wo).0);
            if diffuse <= 0.0 {
                return None;
            }
            let side = if back { Side::Back } else { Side::Front };
            let directions = field?.directions(hit, side, point.position)?;
            let share = directions.share * (diffuse / luminance(bsdf.albedo(wo))).min(1.0);
            (share > 0.0).then_some((directions, share))
        };
        let guide = if field.is_some() { guide() } else { None };
        Self { bsdf, frame, wo, guide }
    }

    /// Density of [`Self::sample`], 1/sr, deltas excluded.
    /// - `wi`, `dir`: unit, in the local frame and in the world's.
    #[inline]
    pub fn pdf(&self, wi: Vec3A, dir: Vec3A) -> f32 {
        let by_bsdf = self.bsdf.pdf(self.wo, wi);
        match &self.guide {
            None => by_bsdf,
            Some((directions, share)) => by_bsdf * (1.0 - share) + directions.pdf(dir) * share,
        }
    }

    /// Draws a direction from `u` in [0, 1)^2; `choice` in [0, 1) picks who draws it, and the lobe. `None`: the light is absorbed.
    #[inline]
    pub fn sample(&self, u: [f32; 2], choice: f32) -> Option<BsdfSample> {
        let Some((directions, share)) = &self.guide else { return self.bsdf.sample(self.wo, u, choice) };
        let mut drawn = if choice < *share {
            let wi = self.frame.to_local(directions.sample(choice / share, u));
            let transmitted = if wi.z * self.wo.z < 0.0 { Transmitted::Yes } else { Transmitted::No };
            BsdfSample { wi, weight: Rgb::ZERO, pdf: 0.0, lobe: LobeKind::Diffuse, transmitted, eta: 1.0 }
        } else {
            // Below 1 by rounding.
            let rest = ((choice - share) / (1.0 - share)).min(1.0 - f32::EPSILON / 2.0);
            self.bsdf.sample(self.wo, u, rest)?
        };
        if drawn.lobe == LobeKind::Delta {
            drawn.weight /= 1.0 - share;
            drawn.pdf *= 1.0 - share;
            return Some(drawn);
        }
        let value = self.bsdf.eval(self.wo, drawn.wi);
        if value == Rgb::ZERO {
            return None;
        }
        drawn.pdf = self.pdf(drawn.wi, self.frame.to_world(drawn.wi));
        drawn.weight = value / drawn.pdf;
        Some(drawn)
    }
}
