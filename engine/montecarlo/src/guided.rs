//! Sampling of directions at a surface, from the BSDF and from the guide of the first pass.
//!
//! A share of the directions is sampled from the guide, the others from the BSDF. In both cases the density is that of the mixture
//! (one-sample multiple importance sampling with the balance heuristic, \[pharr2023\]). The BSDF always has a share, so the mean is
//! correct for any guide.

use crate::surface::SurfaceInteraction;
use femc_field::{
    DirectionTable, Field, GuidedTargets, RegionTargets, Side, TargetDirections, TargetGuide, TargetPack,
};
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_math::{Frame, Rgb};
use femc_scattering::{Bsdf, BsdfSample, LobeKind, Transmitted};
use std::f32::consts::FRAC_1_PI;

/// Sampler of directions at a vertex.
pub struct DirectionSampler<'a> {
    bsdf: &'a Bsdf,
    frame: &'a Frame,
    /// Outgoing direction, toward the previous vertex, local frame.
    wo: Vec3A,
    guide: Option<(&'a GuideDirections<'a>, f32)>,
}

/// Share of the directions at a surface or in fog that are sampled from a table.
pub(crate) const TABLE_SHARE: f32 = 0.5;

/// Guide of a part of a surface.
#[derive(Clone, Copy)]
pub enum LeafGuide<'a> {
    /// Table of directions.
    Table(&'a DirectionTable),
    /// Targets in space, and their shares.
    Targets(&'a TargetPack, &'a RegionTargets),
}

impl<'a> LeafGuide<'a> {
    /// Returns the directions at a point. `None`: there is nothing to sample.
    #[inline(always)]
    pub fn directions_at(self, point: Vec3A) -> Option<GuideDirections<'a>> {
        match self {
            Self::Table(table) => Some(GuideDirections::Table(table)),
            Self::Targets(pack, region) => TargetDirections::new(pack, region, point).map(GuideDirections::Targets),
        }
    }
}

/// Directions of a guide at a point.
pub enum GuideDirections<'a> {
    /// Table of directions.
    Table(&'a DirectionTable),
    /// Directions toward targets.
    Targets(TargetDirections<'a>),
}

impl GuideDirections<'_> {
    /// Returns the density of [`Self::sample`] in a unit direction of the world, 1/sr.
    #[inline]
    pub fn pdf(&self, dir: Vec3A) -> f32 {
        match self {
            Self::Table(table) => table.pdf(dir),
            Self::Targets(directions) => directions.pdf(dir),
        }
    }

    /// Samples a direction from `u` in [0, 1)^2. Evenly spread numbers give evenly spread directions.
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> Vec3A {
        match self {
            Self::Table(table) => table.sample(u),
            Self::Targets(directions) => directions.sample(u),
        }
    }
}

/// Guide of a field at a surface.
pub struct SurfaceGuide<'a> {
    /// Guide of the leaf, and the share of directions to sample from it, in (0, 1).
    pub leaf: Option<(LeafGuide<'a>, f32)>,
    /// Radiance that the surface scatters toward the previous vertex according to the field, cd/m2, without direct light from
    /// sources: albedo times irradiance, over pi. It is 0 if the field has no data here.
    pub radiance: Rgb,
    /// Index of the region of the targets. `None`: there are none, or the field has no data here.
    pub region: Option<u32>,
}

impl<'a> SurfaceGuide<'a> {
    /// Returns the guide of a field at a surface.
    /// - `targets`: targets of the frame.
    #[inline(always)]
    pub fn new(field: &'a Field, targets: Option<&'a TargetGuide>, surface: &SurfaceInteraction<'_>) -> Self {
        let mut out = Self { leaf: None, radiance: Rgb::ZERO, region: None };
        // A guide has no data about glossy lobes.
        let diffuse = luminance(surface.bsdf.lambertian(surface.wo).0);
        if diffuse <= 0.0 {
            return out;
        }
        let side = if surface.back { Side::Back } else { Side::Front };
        let albedo = surface.bsdf.albedo(surface.wo);
        let diffuse_share = (diffuse / luminance(albedo)).min(1.0);
        if !field.tables.is_empty() {
            let table = field.table_at(&surface.hit, side, surface.point.position);
            out.leaf = table.map(|table| (LeafGuide::Table(table), TABLE_SHARE * diffuse_share));
            return out;
        }
        let found = targets.and_then(|targets| targets.at(field, &surface.hit, side, surface.point.position));
        let Some(GuidedTargets { region, targets, light }) = found else { return out };
        out.radiance = albedo * light * FRAC_1_PI;
        out.region = Some(region);
        let share = |region: &RegionTargets| region.share() * diffuse_share;
        out.leaf = targets.map(|(pack, region)| (LeafGuide::Targets(pack, region), share(region)));
        out.leaf = out.leaf.filter(|(_, share)| *share > 0.0);
        out
    }
}

/// A sampled direction and its sampler.
pub struct GuidedSample {
    /// Direction, its weight and its density in the mixture of BSDF and guide.
    pub sample: BsdfSample,
    /// Ratio of the density actually used to that of the BSDF alone.
    pub pdf_ratio: f32,
    /// Whether the guide sampled the direction.
    pub is_guide_sample: bool,
}

impl<'a> DirectionSampler<'a> {
    /// Creates a sampler without a guide.
    pub fn new(bsdf: &'a Bsdf, frame: &'a Frame, wo: Vec3A) -> Self {
        Self { bsdf, frame, wo, guide: None }
    }

    /// Adds the directions of a guide.
    /// - `share`: share of the directions to sample from them, in (0, 1).
    #[inline(always)]
    pub fn add_guide(&mut self, directions: &'a GuideDirections<'a>, share: f32) {
        self.guide = Some((directions, share));
    }

    /// Returns the share of directions that the guide samples, in [0, 1).
    pub fn guide_share(&self) -> f32 {
        self.guide.map_or(0.0, |(_, share)| share)
    }

    /// Returns the density of [`Self::sample`], 1/sr, without deltas.
    /// - `wi`, `dir`: unit, in the local frame and in the world's.
    #[inline]
    pub fn pdf(&self, wi: Vec3A, dir: Vec3A) -> f32 {
        let by_bsdf = self.bsdf.pdf(self.wo, wi);
        match &self.guide {
            None => by_bsdf,
            Some((directions, share)) => by_bsdf * (1.0 - share) + directions.pdf(dir) * share,
        }
    }

    /// Samples a direction from `u` in [0, 1)^2. The first number also picks the sampler, so that evenly spread points stay so for
    /// the guide and for the BSDF. `choice` in [0, 1) picks a lobe of the BSDF. `None`: the light is absorbed.
    #[inline]
    pub fn sample(&self, u: [f32; 2], choice: f32) -> Option<GuidedSample> {
        let Some((directions, share)) = self.guide else {
            let sample = self.bsdf.sample(self.wo, u, choice)?;
            return Some(GuidedSample { sample, pdf_ratio: 1.0, is_guide_sample: false });
        };
        let by_guide = u[0] < share;
        let mut sample = if by_guide {
            let wi = self.frame.to_local(directions.sample([u[0] / share, u[1]]));
            let transmitted = if wi.z * self.wo.z < 0.0 { Transmitted::Yes } else { Transmitted::No };
            BsdfSample { wi, weight: Rgb::ZERO, pdf: 0.0, lobe: LobeKind::Diffuse, transmitted, eta: 1.0 }
        } else {
            // Clamped below 1 because of rounding.
            let rest = ((u[0] - share) / (1.0 - share)).min(1.0 - f32::EPSILON / 2.0);
            self.bsdf.sample(self.wo, [rest, u[1]], choice)?
        };
        if sample.lobe == LobeKind::Delta {
            sample.weight /= 1.0 - share;
            sample.pdf *= 1.0 - share;
            return Some(GuidedSample { sample, pdf_ratio: 1.0 - share, is_guide_sample: by_guide });
        }
        let value = self.bsdf.eval(self.wo, sample.wi);
        if value == Rgb::ZERO {
            return None;
        }
        let by_bsdf = self.bsdf.pdf(self.wo, sample.wi);
        let by_guide_pdf = directions.pdf(self.frame.to_world(sample.wi));
        sample.pdf = by_bsdf * (1.0 - share) + by_guide_pdf * share;
        sample.weight = value / sample.pdf;
        // The BSDF can sample everything that it scatters, so its density is 0 only by rounding.
        let pdf_ratio = sample.pdf / by_bsdf.max(1e-6 * sample.pdf);
        Some(GuidedSample { sample, pdf_ratio, is_guide_sample: by_guide })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_field::{Ball, PACK_TARGETS};
    use femc_scattering::MaterialParameters;

    /// Samples directions of a material with a guide, whose targets are on both sides of the surface.
    fn samples(
        parameters: &MaterialParameters,
        share: f32,
        check: impl Fn(GuidedSample, Vec3A, &DirectionSampler<'_>),
    ) {
        let bsdf = Bsdf::from_parameters(parameters);
        let frame = Frame::from_normal(Vec3A::new(0.48, 0.6, 0.64));
        let wo = Vec3A::new(0.8, 0.0, 0.6);
        let ball = |dir: Vec3A| Ball { center: dir * 3.0, radius: 1.2 }.into();
        let (above, below) = (frame.to_world(Vec3A::new(0.2, 0.9, 0.1).normalize()), frame.to_world(Vec3A::NEG_Z));
        let pack = TargetPack::new(&[ball(above), ball(below)]);
        let region = RegionTargets { shares: [0.1; PACK_TARGETS], ..Default::default() };
        let directions = LeafGuide::Targets(&pack, &region).directions_at(Vec3A::ZERO).expect("targets in sight");
        let mut sampler = DirectionSampler::new(&bsdf, &frame, wo);
        sampler.add_guide(&directions, share);
        let grid = 24;
        let center = |at: u16| (f32::from(at) + 0.5) / f32::from(grid);
        for x in 0..grid {
            for y in 0..grid {
                if let Some(sample) = sampler.sample([center(x), center(y)], center(x * 7 % grid)) {
                    check(sample, wo, &sampler);
                }
            }
        }
    }

    #[test]
    fn a_guided_sample_says_on_which_side_it_is() {
        let sheet = MaterialParameters { rd: Rgb::splat(0.3), td: Rgb::splat(0.4), ..Default::default() };
        let counts = [(); 4].map(|()| std::cell::Cell::new(0));
        samples(&sheet, 0.6, |GuidedSample { sample, pdf_ratio, is_guide_sample }, wo, sampler| {
            let is_behind = (sample.wi.z < 0.0) != (wo.z < 0.0);
            assert_eq!(sample.transmitted == Transmitted::Yes, is_behind, "{sample:?}");
            let density = sampler.pdf(sample.wi, sampler.frame.to_world(sample.wi));
            assert!((sample.pdf / density - 1.0).abs() < 1e-4, "{sample:?} {density}");
            let by_bsdf = sampler.bsdf.pdf(wo, sample.wi);
            assert!((pdf_ratio * by_bsdf / density - 1.0).abs() < 1e-4, "{sample:?} {pdf_ratio}");
            let count = &counts[usize::from(is_behind) + 2 * usize::from(is_guide_sample)];
            count.set(count.get() + 1);
        });
        assert!(counts.iter().all(|count| count.get() > 20), "{counts:?}");
    }

    #[test]
    fn a_mirrored_sample_has_the_probability_of_its_choice() {
        let polished = MaterialParameters { rd: Rgb::splat(0.3), rs: Rgb::splat(0.4), ..Default::default() };
        let (mirrored, share) = (std::cell::Cell::new(0), 0.75);
        samples(&polished, share, |GuidedSample { sample, pdf_ratio, is_guide_sample }, wo, _| {
            if sample.lobe != LobeKind::Delta {
                return;
            }
            mirrored.set(mirrored.get() + 1);
            assert!(sample.wi.abs_diff_eq(Vec3A::new(-wo.x, -wo.y, wo.z), 1e-6) && !is_guide_sample, "{sample:?}");
            // The reflectance is what the weight leaves of the light, times the probability.
            assert!((sample.weight * sample.pdf).abs_diff_eq(Rgb::splat(0.4), 1e-5), "{sample:?}");
            assert_eq!(pdf_ratio, 1.0 - share);
        });
        assert!(mirrored.get() > 20, "{mirrored:?}");
    }
}
