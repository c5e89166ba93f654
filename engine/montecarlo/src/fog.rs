//! Participating media on a segment of a path: emission, free distances, and single scattering.
//!
//! Single scattering on the segment is sampled in two ways. (1) Choose a light by the amount of its light that the segment
//! scatters, a distance by the same measure, then a point on the light. (2) Sample a distance by transmittance, then a direction
//! that hits the light. Both have densities over (light, distance, direction) and are combined there with the power heuristic.
//!
//! Directions after an event are sampled from the phase function or toward a light, with the density of the mixture of both.

use crate::dimensions as dim;
use crate::path::{Counters, square};
use crate::shadow::Shadow;
use crate::technique::{Technique, weight};
use femc_emission::{AlongSegment, Choice, DeltaKind, FromPoint};
use femc_math::glam::Vec3A;
use femc_math::{Rgb, SampleStream};
use femc_prepared::Prepared;
use femc_prepared::airlit::{Airlit, Stretch};
use femc_prepared::media::{Distance, Event, Inside, MediaRay};

/// Share of the directions after an event that are sampled from the phase function.
const BY_PHASE: f32 = 0.5;
/// Number of segments at whose ends directions may be sampled toward lights. In thick fog a path has thousands of segments, and the
/// product of so many factors with mean 1 would nearly always be close to 0. On the drive through the roundabout, a value of 6
/// makes paths a seventh longer than 24, and the variance is not lower.
const GUIDED: u32 = 24;
/// Number of angles at which the lights are evaluated, for a camera ray, whose light counts most, and for later ones.
const ANGLES_FROM_CAMERA: u32 = 6;
const ANGLES: u32 = 3;

/// The current segment of the path.
#[derive(Clone, Copy)]
pub struct Segment<'a> {
    /// Start, m.
    pub origin: Vec3A,
    /// Unit direction.
    pub dir: Vec3A,
    /// Time in the shutter.
    pub time: f32,
    /// Closed objects that contain the segment's start.
    pub inside: &'a Inside,
    /// Index of the segment, 0: the camera's.
    pub bounce: u32,
    /// First random dimension of the segment.
    pub base: u32,
}

/// The media of a ray, and the weights of the lights for it.
#[derive(Default)]
pub struct FoggyRay {
    /// Media of the ray.
    pub media: MediaRay,
    /// Scattering stretch of the segment, as context for the choice of a light. `None`: nothing scatters.
    wanted: Option<AlongSegment>,
    choice: Choice,
}

/// A scattering event of the path, with the data for the weights of lights that are hit later.
#[derive(Clone, Copy)]
pub struct Collision {
    /// The event; `pdf` is the density of its distance, 1/m.
    pub event: Event,
    /// Position, m.
    pub position: Vec3A,
}

/// A direction sampled after an event.
#[derive(Clone, Copy)]
pub struct NewDirection {
    /// Unit direction.
    pub dir: Vec3A,
    /// Density of the direction, 1/sr.
    pub pdf: f32,
    /// Density of the direction by the phase function alone, 1/sr. Light that is hit is weighted with this one, because it needs no
    /// evaluation of the lights.
    pub phase: f32,
    /// Factor on the throughput.
    pub weight: Rgb,
}

/// Light scattered once on a segment.
#[derive(Clone, Copy)]
pub struct Scattered {
    /// Radiance at the segment's start, cd/m2.
    pub color: Rgb,
    /// Index of the chosen light.
    pub light: u32,
    /// Event that scattered the light.
    pub event: Event,
}

impl FoggyRay {
    /// Returns the density, 1/m, with which way 1 chooses `light` and samples the distance of `event` on this ray.
    pub fn airlight_pdf(&self, scene: &Prepared, light: u32, time: f32, event: &Event) -> f32 {
        let Some(wanted) = &self.wanted else { return 0.0 };
        let chosen = scene.lights.probability(&self.choice, wanted, light);
        if chosen <= 0.0 {
            return 0.0;
        }
        airlit(scene, self, wanted, light, time).map_or(0.0, |airlit| chosen * airlit.pdf(event))
    }
}

/// Returns the distribution of distances for a light.
fn airlit(scene: &Prepared, ray: &FoggyRay, wanted: &AlongSegment, light: u32, time: f32) -> Option<Airlit> {
    let stretch = Stretch { wanted, media: &scene.media, ray: &ray.media, least_distance: scene.least_distance };
    Airlit::new(&scene.lights, &scene.world, &stretch, light, time)
}

/// Sampler of the media of one segment, which the caller has intersected.
pub struct Fog<'a, 's> {
    /// The scene.
    pub scene: &'s Prepared,
    /// Media of the segment.
    pub ray: &'a mut FoggyRay,
    /// Weights of lights for directions.
    pub directions: &'a mut Choice,
    /// Tester of shadow rays.
    pub shadow: &'a mut Shadow,
    /// Counters of the work.
    pub counters: &'a mut Counters,
    /// Only technique that counts, if set.
    pub only: Option<Technique>,
}

impl Fog<'_, '_> {
    /// Returns the radiance that the media of the segment emit.
    pub fn glow(&mut self, segment: &Segment<'_>, stream: &mut SampleStream) -> Rgb {
        if !self.scene.media.glows() {
            return Rgb::ZERO;
        }
        stream.seek(segment.base + dim::GLOW);
        self.scene.media.glow(&self.ray.media, stream.next_1d())
    }

    /// Samples the distance of the next event. `Err`: no event on the segment, with the weight of the transmission.
    pub fn collide(&mut self, segment: &Segment<'_>, stream: &mut SampleStream) -> Result<Collision, Rgb> {
        stream.seek(segment.base + dim::DISTANCE);
        let [u, channel] = stream.next_2d();
        stream.seek(segment.base + dim::DISTANCE_FINE);
        match self.scene.media.draw(&self.ray.media, dim::fine([u, stream.next_1d()]), channel) {
            Distance::Through { weight } => Err(weight),
            Distance::Scatter(event) => Ok(Collision { event, position: segment.origin + segment.dir * event.t }),
        }
    }

    /// Weighs the lights for the segment. Call it before [`Self::airlight`] and [`FoggyRay::airlight_pdf`].
    pub fn weigh(&mut self, segment: &Segment<'_>) {
        let scene = self.scene;
        self.ray.wanted = None;
        if scene.lights.is_empty() {
            return;
        }
        let Some(range) = scene.media.scattering_range(&self.ray.media) else { return };
        let fog = scene.media.character(&self.ray.media, range);
        let angles = if segment.bounce == 0 { ANGLES_FROM_CAMERA } else { ANGLES };
        let wanted = scene.lights.along(segment.origin, segment.dir, range, fog, angles);
        scene.lights.weigh(&wanted, &mut self.ray.choice);
        self.ray.wanted = Some(wanted);
    }

    /// Samples single scattering on the segment with a light and a distance for it (way 1).
    pub fn airlight(&mut self, segment: &Segment<'_>, stream: &mut SampleStream) -> Option<Scattered> {
        let scene = self.scene;
        let wanted = self.ray.wanted?;
        stream.seek(segment.base + dim::AIRLIGHT_LIGHT);
        let choice = dim::fine(stream.next_2d());
        let (light, probability) = scene.lights.choose(&self.ray.choice, &wanted, choice)?;
        let airlit = airlit(scene, self.ray, &wanted, light, segment.time)?;
        stream.seek(segment.base + dim::AIRLIGHT);
        let u = stream.next_1d();
        stream.seek(segment.base + dim::AIRLIGHT_CHANNEL);
        let (event, density) = airlit.sample(&scene.media, &self.ray.media, u, stream.next_1d())?;
        let position = segment.origin + segment.dir * event.t;
        stream.seek(segment.base + dim::AIRLIGHT_POINT);
        let point = stream.next_2d();
        let sample = scene.lights.sample_light(&scene.world, &scene.textures, light, position, segment.time, point)?;
        let nothing = Scattered { color: Rgb::ZERO, light, event };
        if sample.radiance == Rgb::ZERO {
            return Some(nothing);
        }
        let (phase, phase_pdf) = scene.media.phase(&self.ray.media, &event, -segment.dir, sample.dir);
        let pdf = density * probability * sample.pdf;
        let by_scattering = if sample.delta == DeltaKind::Position { 0.0 } else { square(event.pdf * phase_pdf / pdf) };
        let weight = weight(self.only, Technique::Light, by_scattering);
        if weight <= 0.0 {
            return Some(nothing);
        }
        let from = (position, Vec3A::ZERO, Vec3A::ZERO);
        let visibility =
            self.shadow.visibility::<true>(scene, from, &sample, segment.time, segment.inside, self.counters);
        Some(Scattered { color: event.weight * phase * sample.radiance * visibility * (weight / pdf), ..nothing })
    }

    /// Returns the medium of an event on the segment. Among several media it is the one that scatters most there.
    pub fn medium_of(&self, event: &Event) -> u16 {
        self.scene.media.medium_of(&self.ray.media, event)
    }

    /// Returns the first emitting medium on the segment.
    pub fn glowing(&self) -> u16 {
        self.scene.media.glowing(&self.ray.media)
    }

    /// Returns the context of an event for sampling directions toward lights. `None` if there are no lights.
    fn leaving(&self, segment: &Segment<'_>, position: Vec3A, event: &Event) -> Option<FromPoint> {
        let (extinction, phase) = self.scene.media.character_at(&self.ray.media, event);
        (!self.scene.lights.many().is_empty()).then_some(FromPoint {
            position,
            toward: -segment.dir,
            extinction,
            phase,
        })
    }

    /// Samples the direction after an event.
    pub fn scatter(
        &mut self,
        segment: &Segment<'_>,
        collision: &Collision,
        stream: &mut SampleStream,
    ) -> Option<NewDirection> {
        let scene = self.scene;
        let (media, event, many) = (&scene.media, &collision.event, scene.lights.many());
        stream.seek(segment.base + dim::LOBE);
        let mut choice = stream.next_1d();
        stream.seek(segment.base + dim::DIRECTION);
        let u = stream.next_2d();
        let from = (segment.bounce < GUIDED).then(|| self.leaving(segment, collision.position, event)).flatten();
        let mut toward_light = None;
        if let Some(from) = &from {
            many.weigh_directions(from, self.directions);
            if choice >= BY_PHASE {
                choice = (choice - BY_PHASE) / (1.0 - BY_PHASE);
                stream.seek(segment.base + dim::TOWARD);
                toward_light = many.sample_direction(from, self.directions, dim::fine(stream.next_2d()), u);
            } else {
                choice /= BY_PHASE;
            }
        }
        let by_phase = || media.draw_phase(&self.ray.media, event, choice).sample(-segment.dir, u).wi;
        let dir = toward_light.unwrap_or_else(by_phase);
        let (value, phase) = media.phase(&self.ray.media, event, -segment.dir, dir);
        let pdf = match &from {
            None => phase,
            Some(from) => BY_PHASE * phase + (1.0 - BY_PHASE) * many.direction_pdf(from, self.directions, dir, phase),
        };
        (pdf > 0.0 && phase > 0.0).then(|| NewDirection { dir, pdf, phase, weight: value / pdf })
    }
}
