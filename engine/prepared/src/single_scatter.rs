//! Sampling of distances on a ray segment by the light of one source that fog scatters there.

use crate::lights::Lights;
use crate::media::{DistanceSample, Media, MediaRay, ScatterEvent};
use femc_emission::{Airlight, EquiangularSegment, SegmentContext, SegmentMedium, SourceProfile};
use femc_geometry::World;

/// Maximum share of distances that are sampled by transmittance.
const MAX_TRANSMITTANCE_SHARE: f32 = 0.8;

/// Minimum share of distances that are sampled by transmittance if the segment extends beyond the closely examined range.
const MIN_TRANSMITTANCE_SHARE: f32 = 0.02;

/// A ray segment.
#[derive(Clone, Copy)]
pub struct MediumSegment<'a> {
    /// Segment as the choice of a light uses it.
    pub light_context: &'a SegmentContext,
    /// All media of the frame.
    pub media: &'a Media,
    /// Media that the ray passes through.
    pub ray: &'a MediaRay,
    /// Minimum distance of a light from the ray, m; smaller distances are raised to it.
    pub min_light_distance: f32,
}

/// A distribution of distances. Most are sampled by the light that is scattered at each distance. If the fog is so thick that it
/// changes between the angles at which the light is evaluated, a share is sampled by transmittance alone.
#[derive(Clone, Copy, Debug)]
pub struct SingleScatterSampler {
    airlight: Airlight,
    start: f32,
    /// Share of distances that are sampled by transmittance.
    transmittance_share: f32,
}

impl SingleScatterSampler {
    /// Creates the distribution for `light` at `time` in the shutter; `None` if the light is never chosen.
    pub fn new(lights: &Lights, world: &World, segment: &MediumSegment<'_>, light: u32, time: f32) -> Option<Self> {
        let MediumSegment { light_context, media, ray, min_light_distance: least_distance } = *segment;
        let sampler = lights.sampler();
        let node = sampler.node(light)?;
        let (start, end) = light_context.range;
        let center = lights.center(world, light, time);
        let least = least_distance.max(0.5 * node.radius());
        let equiangular = EquiangularSegment::new(
            sampler.level(),
            light_context.origin,
            light_context.dir,
            light_context.range,
            center,
            least,
        );
        let (depth, scattering) = media.depth_and_scattering(ray, &equiangular.distances().map(|t| t + start));
        let medium = SegmentMedium { depth, scattering, extinction: node.extinction(), phase: light_context.phase };
        let measured = lights.intensities(light, || equiangular.directions());
        let source = measured.as_ref().map_or(SourceProfile::Bounds(node), SourceProfile::Sampled);
        let airlight = equiangular.airlight(sampler.level(), &medium, source);
        let steep = airlight.steepness(&depth);
        let thick = MAX_TRANSMITTANCE_SHARE * steep / (1.0 + steep);
        let by_transmittance = if light_context.end <= end { thick } else { thick.max(MIN_TRANSMITTANCE_SHARE) };
        Some(Self { airlight, start, transmittance_share: by_transmittance })
    }

    /// Samples an event with `u` and, for colored media, `channel`, both in [0, 1). Returns the event, whose weight is not divided
    /// by a density, and the density, 1/m.
    pub fn sample(&self, media: &Media, ray: &MediaRay, u: f32, channel: f32) -> Option<(ScatterEvent, f32)> {
        let share = self.transmittance_share;
        let t = if u < share {
            let DistanceSample::Scatter(event) = media.sample_distance(ray, f64::from(u / share), channel) else {
                return None;
            };
            event.t
        } else {
            self.start + self.airlight.sample((u - share) / (1.0 - share))
        };
        let event = media.event_at(ray, t)?;
        let density = self.pdf(&event);
        (density > 0.0).then_some((event, density))
    }

    /// Returns the density of an event's distance, 1/m.
    pub fn pdf(&self, event: &ScatterEvent) -> f32 {
        let about = self.airlight.pdf(event.t - self.start);
        self.transmittance_share * event.pdf + (1.0 - self.transmittance_share) * about
    }
}
