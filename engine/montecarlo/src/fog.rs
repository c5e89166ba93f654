//! Participating media on a segment of a path: emission, free distances, and single scattering.
//!
//! Single scattering on the segment is sampled in two ways. (1) Choose a light by the amount of its light that the segment
//! scatters, a distance by the same measure, then a point on the light. (2) Sample a distance by transmittance, then a direction
//! that hits the light. Both have densities over (light, distance, direction) and are combined there with the power heuristic.
//!
//! Directions after an event are sampled from the phase function or toward a light, with the density of the mixture of both.

use crate::dimensions as dim;
use crate::path_state::PathState;
use crate::shadow::ShadowTester;
use crate::square;
use crate::technique::{MisTechnique, mis_weight};
use crate::tracer::TracerCounters;
use femc_emission::{DeltaKind, DirectionContext, LightWeights, SegmentContext};
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::Prepared;
use femc_prepared::media::{DistanceSample, MediaRay, ScatterEvent};
use femc_prepared::single_scatter::{MediumSegment, SingleScatterSampler};

/// Share of the directions after an event that are sampled from the phase function.
const PHASE_SHARE: f32 = 0.5;
/// Number of segments at whose ends directions may be sampled toward lights. In thick fog a path has thousands of segments, and the
/// product of so many factors with mean 1 would nearly always be close to 0. On the drive through the roundabout, a value of 6
/// makes paths a seventh longer than 24, and the variance is not lower.
const MAX_GUIDED_SEGMENTS: u32 = 24;
/// Number of angles at which the lights are evaluated, for a camera ray, whose light counts most, and for later ones.
const ANGLES_FROM_CAMERA: u32 = 6;
const ANGLES: u32 = 3;

/// The media of a ray, and the weights of the lights for it.
#[derive(Default)]
pub struct FoggyRay {
    /// Media of the ray.
    pub media: MediaRay,
    /// Scattering stretch of the segment, as context for the choice of a light. `None`: nothing scatters.
    light_context: Option<SegmentContext>,
    light_weights: LightWeights,
}

/// A scattering event of the path, with the data for the weights of lights that are hit later.
#[derive(Clone, Copy)]
pub struct Collision {
    /// The event; `pdf` is the density of its distance, 1/m.
    pub event: ScatterEvent,
    /// Position, m.
    pub position: Vec3A,
}

/// Outcome of sampling the distance of the next collision on a ray.
pub enum FreeFlight {
    /// The path collides before the end of the ray.
    Collision(Collision),
    /// The path reaches the end of the ray.
    Through {
        /// Transmittance of the ray, divided by the probability of no collision.
        weight: Rgb,
    },
}

/// A direction sampled after an event.
#[derive(Clone, Copy)]
pub struct DirectionSample {
    /// Unit direction.
    pub dir: Vec3A,
    /// Density of the direction, 1/sr.
    pub pdf: f32,
    /// Density of the direction by the phase function alone, 1/sr. Light that is hit is weighted with this one, because it needs no
    /// evaluation of the lights.
    pub phase_pdf: f32,
    /// Factor on the throughput.
    pub weight: Rgb,
}

/// Light scattered once on a segment.
#[derive(Clone, Copy)]
pub struct SingleScatterSample {
    /// Radiance at the segment's start, cd/m2.
    pub color: Rgb,
    /// Index of the chosen light.
    pub light: u32,
    /// Event that scattered the light.
    pub event: ScatterEvent,
}

impl FoggyRay {
    /// Returns the density, 1/m, with which way 1 chooses `light` and samples the distance of `event` on this ray.
    pub fn airlight_pdf(&self, scene: &Prepared, light: u32, time: f32, event: &ScatterEvent) -> f32 {
        let Some(light_context) = &self.light_context else { return 0.0 };
        let chosen = scene.lights.probability(&self.light_weights, light_context, light);
        if chosen <= 0.0 {
            return 0.0;
        }
        airlight_distances(scene, self, light_context, light, time)
            .map_or(0.0, |distances| chosen * distances.pdf(event))
    }
}

/// Returns the distribution of distances for a light.
fn airlight_distances(
    scene: &Prepared,
    ray: &FoggyRay,
    light_context: &SegmentContext,
    light: u32,
    time: f32,
) -> Option<SingleScatterSampler> {
    let stretch = MediumSegment {
        light_context,
        media: &scene.media,
        ray: &ray.media,
        min_light_distance: scene.min_light_distance,
    };
    SingleScatterSampler::new(&scene.lights, &scene.world, &stretch, light, time)
}

/// Sampler of the media on the current ray of a path. The caller has found their intervals.
pub struct FogSampler<'a> {
    /// The scene.
    pub scene: &'a Prepared,
    /// Media of the ray.
    pub ray: &'a mut FoggyRay,
    /// Weights of lights for directions.
    pub direction_weights: &'a mut LightWeights,
    /// Tester of shadow rays.
    pub shadow: &'a mut ShadowTester,
    /// Counters of the work.
    pub counters: &'a mut TracerCounters,
    /// Only technique that counts, if set.
    pub single_technique: Option<MisTechnique>,
}

impl FogSampler<'_> {
    /// Returns the radiance that the media of the segment emit.
    pub fn glow(&mut self, path: &mut PathState) -> Rgb {
        if !self.scene.media.glows() {
            return Rgb::ZERO;
        }
        path.stream.seek(path.base + dim::GLOW);
        self.scene.media.emitted_radiance(&self.ray.media, path.stream.next_1d())
    }

    /// Samples the distance of the next collision.
    pub fn sample_collision(&mut self, path: &mut PathState) -> FreeFlight {
        path.stream.seek(path.base + dim::DISTANCE);
        let [u, channel] = path.stream.next_2d();
        path.stream.seek(path.base + dim::DISTANCE_FINE);
        match self.scene.media.sample_distance(&self.ray.media, dim::uniform_48([u, path.stream.next_1d()]), channel) {
            DistanceSample::Through { weight } => FreeFlight::Through { weight },
            DistanceSample::Scatter(event) => {
                FreeFlight::Collision(Collision { event, position: path.ray.origin + path.ray.dir * event.t })
            }
        }
    }

    /// Weighs the lights for the segment. Call it before [`Self::sample_airlight`] and [`FoggyRay::airlight_pdf`].
    pub fn weigh_lights(&mut self, path: &PathState) {
        let scene = self.scene;
        self.ray.light_context = None;
        if scene.lights.is_empty() {
            return;
        }
        let Some(range) = scene.media.scattering_range(&self.ray.media) else { return };
        let fog = scene.media.mean_properties(&self.ray.media, range);
        let angles = if path.bounce == 0 { ANGLES_FROM_CAMERA } else { ANGLES };
        let light_context = scene.lights.segment_context(path.ray.origin, path.ray.dir, range, fog, angles);
        scene.lights.weigh(&light_context, &mut self.ray.light_weights);
        self.ray.light_context = Some(light_context);
    }

    /// Samples single scattering on the segment with a light and a distance for it (way 1).
    pub fn sample_airlight(&mut self, path: &mut PathState) -> Option<SingleScatterSample> {
        let scene = self.scene;
        let light_context = self.ray.light_context?;
        path.stream.seek(path.base + dim::AIRLIGHT_LIGHT);
        let choice = dim::uniform_48(path.stream.next_2d());
        let (light, probability) = scene.lights.choose(&self.ray.light_weights, &light_context, choice)?;
        let distances = airlight_distances(scene, self.ray, &light_context, light, path.ray.time)?;
        path.stream.seek(path.base + dim::AIRLIGHT);
        let u = path.stream.next_1d();
        path.stream.seek(path.base + dim::AIRLIGHT_CHANNEL);
        let (event, density) = distances.sample(&scene.media, &self.ray.media, u, path.stream.next_1d())?;
        let position = path.ray.origin + path.ray.dir * event.t;
        path.stream.seek(path.base + dim::AIRLIGHT_POINT);
        let point = path.stream.next_2d();
        let sample = scene.lights.sample_light(&scene.world, &scene.textures, light, position, path.ray.time, point)?;
        let nothing = SingleScatterSample { color: Rgb::ZERO, light, event };
        if sample.radiance == Rgb::ZERO {
            return Some(nothing);
        }
        let (phase, phase_pdf) = scene.media.phase(&self.ray.media, &event, -path.ray.dir, sample.dir);
        let pdf = density * probability * sample.pdf;
        let by_scattering = if sample.delta == DeltaKind::Position { 0.0 } else { square(event.pdf * phase_pdf / pdf) };
        let weight = mis_weight(self.single_technique, MisTechnique::Light, by_scattering);
        if weight <= 0.0 {
            return Some(nothing);
        }
        let from = (position, Vec3A::ZERO, Vec3A::ZERO);
        let visibility =
            self.shadow.visibility::<true>(scene, from, &sample, path.ray.time, &path.medium_stack, self.counters);
        Some(SingleScatterSample {
            color: event.weight * phase * sample.radiance * visibility * (weight / pdf),
            ..nothing
        })
    }

    /// Returns the medium of an event on the segment. Among several media it is the one that scatters most there.
    pub fn dominant_medium(&self, event: &ScatterEvent) -> u16 {
        self.scene.media.dominant_medium(&self.ray.media, event)
    }

    /// Returns the first emitting medium on the segment.
    pub fn emitting_medium(&self) -> u16 {
        self.scene.media.emitting_medium(&self.ray.media)
    }

    /// Returns the context of an event for sampling directions toward lights. `None` if there are no lights.
    fn direction_context(&self, path: &PathState, position: Vec3A, event: &ScatterEvent) -> Option<DirectionContext> {
        let (extinction, phase) = self.scene.media.event_properties(&self.ray.media, event);
        (!self.scene.lights.sampler().is_empty()).then_some(DirectionContext {
            position,
            wo: -path.ray.dir,
            extinction,
            phase,
        })
    }

    /// Samples the direction after an event.
    pub fn sample_direction(&mut self, path: &mut PathState, collision: &Collision) -> Option<DirectionSample> {
        let scene = self.scene;
        let (media, event, many) = (&scene.media, &collision.event, scene.lights.sampler());
        path.stream.seek(path.base + dim::LOBE);
        let mut choice = path.stream.next_1d();
        path.stream.seek(path.base + dim::DIRECTION);
        let u = path.stream.next_2d();
        let from = (path.bounce < MAX_GUIDED_SEGMENTS)
            .then(|| self.direction_context(path, collision.position, event))
            .flatten();
        let mut toward_light = None;
        if let Some(from) = &from {
            many.weigh_directions(from, self.direction_weights);
            if choice >= PHASE_SHARE {
                choice = (choice - PHASE_SHARE) / (1.0 - PHASE_SHARE);
                path.stream.seek(path.base + dim::LIGHT_DIRECTION);
                toward_light =
                    many.sample_direction(from, self.direction_weights, dim::uniform_48(path.stream.next_2d()), u);
            } else {
                choice /= PHASE_SHARE;
            }
        }
        let by_phase = || media.sample_phase(&self.ray.media, event, choice).sample(-path.ray.dir, u).wi;
        let dir = toward_light.unwrap_or_else(by_phase);
        let (value, phase) = media.phase(&self.ray.media, event, -path.ray.dir, dir);
        let pdf = match &from {
            None => phase,
            Some(from) => {
                PHASE_SHARE * phase + (1.0 - PHASE_SHARE) * many.direction_pdf(from, self.direction_weights, dir, phase)
            }
        };
        (pdf > 0.0 && phase > 0.0).then(|| DirectionSample { dir, pdf, phase_pdf: phase, weight: value / pdf })
    }
}
