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
    /// What the vertex scatters toward where the path came from, by the field, without light straight from sources: albedo by channel times the
    /// luminance of the irradiance, lx. 0: the field knows nothing.
    pub ahead: Rgb,
}

/// A direction, and who drew it.
pub struct Drawn {
    /// The direction, its weight and its density by the BSDF and the guide together.
    pub sample: BsdfSample,
    /// How much more often than by the BSDF alone such a direction is drawn.
    pub often: f32,
    /// Whether the guide drew it.
    pub by_guide: bool,
}

impl<'a> Scattering<'a> {
    /// Without a guide.
    pub fn new(bsdf: &'a Bsdf, frame: &'a Frame, wo: Vec3A) -> Self {
        Self { bsdf, frame, wo, guide: None, ahead: Rgb::ZERO }
    }

    /// The same with a field's guide.
    pub fn guided(mut self, field: &'a Field, (hit, point, back): (&Hit, &SurfacePoint, bool)) -> Self {
        // Of a gloss the guide knows nothing.
        let diffuse = luminance(self.bsdf.lambertian(self.wo).0);
        let side = if back { Side::Back } else { Side::Front };
        if diffuse <= 0.0 {
            return self;
        }
        let Some(guided) = field.guided(hit, side, point.position) else { return self };
        let albedo = self.bsdf.albedo(self.wo);
        self.ahead = albedo * guided.light;
        self.guide = guided.directions.and_then(|directions| {
            let share = directions.share * (diffuse / luminance(albedo)).min(1.0);
            (share > 0.0).then_some((directions, share))
        });
        self
    }

    /// Whether a guide draws a share of the directions.
    pub fn is_guided(&self) -> bool {
        self.guide.is_some()
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

    /// Draws a direction from `u` in [0, 1)^2, whose first number picks who draws it, too, so that points which are spread evenly stay so for
    /// the guide's lobes and for the BSDF; `choice` in [0, 1) picks a lobe of the BSDF. `None`: the light is absorbed.
    #[inline]
    pub fn sample(&self, u: [f32; 2], choice: f32) -> Option<Drawn> {
        let Some((directions, share)) = &self.guide else {
            let sample = self.bsdf.sample(self.wo, u, choice)?;
            return Some(Drawn { sample, often: 1.0, by_guide: false });
        };
        let by_guide = u[0] < *share;
        let mut drawn = if by_guide {
            let wi = self.frame.to_local(directions.sample_evenly([u[0] / share, u[1]]));
            let transmitted = if wi.z * self.wo.z < 0.0 { Transmitted::Yes } else { Transmitted::No };
            BsdfSample { wi, weight: Rgb::ZERO, pdf: 0.0, lobe: LobeKind::Diffuse, transmitted, eta: 1.0 }
        } else {
            // Below 1 by rounding.
            let rest = ((u[0] - share) / (1.0 - share)).min(1.0 - f32::EPSILON / 2.0);
            self.bsdf.sample(self.wo, [rest, u[1]], choice)?
        };
        if drawn.lobe == LobeKind::Delta {
            drawn.weight /= 1.0 - share;
            drawn.pdf *= 1.0 - share;
            return Some(Drawn { sample: drawn, often: 1.0 - share, by_guide });
        }
        let value = self.bsdf.eval(self.wo, drawn.wi);
        if value == Rgb::ZERO {
            return None;
        }
        let by_bsdf = self.bsdf.pdf(self.wo, drawn.wi);
        let by_lobes = directions.pdf(self.frame.to_world(drawn.wi));
        drawn.pdf = by_bsdf * (1.0 - share) + by_lobes * share;
        drawn.weight = value / drawn.pdf;
        // The BSDF may draw whatever it scatters, so its density is 0 by rounding at most.
        let often = drawn.pdf / by_bsdf.max(1e-6 * drawn.pdf);
        Some(Drawn { sample: drawn, often, by_guide })
    }
}
