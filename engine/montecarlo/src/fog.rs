//! Participating media on a segment of a path: glow, free distances, and direct light scattered once.
//!
//! Light scattered once on the segment can be found in three ways: (1) a distance drawn by transmittance, then a point on a
//! light; (2) a light, a distance equiangular about it, then a point on it (\[kulla2012\]); (3) a distance by transmittance,
//! then a direction by the phase function that meets the light. All three are densities over (light, distance, direction)
//! and are joined there by the power heuristic.

use crate::dimensions as dim;
use crate::path::{Counters, square};
use crate::shadow::Shadow;
use crate::technique::{Technique, weight};
use femc_emission::{DeltaKind, Equiangular, Front, LightSample};
use femc_math::glam::Vec3A;
use femc_math::{Rgb, SampleStream};
use femc_prepared::Prepared;
use femc_prepared::media::{Distance, Event, FAR, Inside, MediaRay};

/// The segment of the path that is looked at.
#[derive(Clone, Copy)]
pub struct Segment<'a> {
    /// Start, m.
    pub origin: Vec3A,
    /// Unit direction.
    pub dir: Vec3A,
    /// Time in the shutter.
    pub time: f32,
    /// Closed objects that the path is in.
    pub inside: &'a Inside,
    /// First random dimension of the segment.
    pub base: u32,
}

/// A scattering event of the path, with what the weights of light met later need.
#[derive(Clone, Copy)]
pub struct Collision {
    /// The event; `pdf` is the density of its distance, 1/m.
    pub event: Event,
    /// Where it is, m.
    pub position: Vec3A,
    origin: Vec3A,
    dir: Vec3A,
    /// Stretch of the segment on which something scatters, m.
    range: (f32, f32),
}

impl Collision {
    /// Density, 1/m, with which way 2 chooses `light` and draws this event's distance about it.
    /// - `front`: where the choice of a light for the segment begins, if it is known.
    pub fn equiangular_pdf(&self, scene: &Prepared, front: Option<&Front>, light: u32, time: f32) -> f32 {
        let place = scene.lights.along(self.origin, self.dir, self.range);
        let chosen = match front {
            Some(front) => scene.lights.probability_from(front, &place, light),
            None => scene.lights.probability(&place, light),
        };
        if chosen <= 0.0 {
            return 0.0;
        }
        chosen * about(scene, light, time, self.origin, self.dir, self.range).pdf(self.event.t - self.range.0)
    }
}

/// A distance on a segment, drawn about a light.
#[derive(Clone, Copy)]
pub struct AboutLight {
    /// The light.
    pub light: u32,
    /// Probability of its choice.
    pub probability: f32,
    /// Density of the distance, 1/m.
    pub density: f32,
    /// The place.
    pub event: Event,
}

/// Equiangular distances about the middle of a light on the stretch `range` of a ray, counted from its start.
fn about(scene: &Prepared, light: u32, time: f32, origin: Vec3A, dir: Vec3A, range: (f32, f32)) -> Equiangular {
    let center = scene.lights.center(&scene.world, light, time);
    let t_max = if range.1 >= FAR { f32::INFINITY } else { range.1 - range.0 };
    Equiangular::new(origin + dir * range.0, dir, t_max, center, scene.least_distance)
}

/// The media of one segment, cut by the caller.
pub struct Fog<'a, 's> {
    /// The scene.
    pub scene: &'s Prepared,
    /// The segment's media.
    pub ray: &'a MediaRay,
    /// Shadow rays.
    pub shadow: &'a mut Shadow,
    /// Work done.
    pub counters: &'a mut Counters,
    /// The only technique that counts.
    pub only: Option<Technique>,
    /// Where the choice of a light for the segment begins, once it is known.
    pub front: Option<Front>,
}

impl Fog<'_, '_> {
    /// Radiance that the media of the segment emit.
    pub fn glow(&mut self, segment: &Segment<'_>, stream: &mut SampleStream) -> Rgb {
        if !self.scene.media.glows() {
            return Rgb::ZERO;
        }
        stream.seek(segment.base + dim::GLOW);
        self.scene.media.glow(self.ray, stream.next_1d())
    }

    /// Draws the distance of the next event. `Err`: none on the segment, with the weight of having gone through.
    pub fn collide(&mut self, segment: &Segment<'_>, stream: &mut SampleStream) -> Result<Collision, Rgb> {
        let media = &self.scene.media;
        let range = media.scattering_range(self.ray);
        stream.seek(segment.base + dim::DISTANCE);
        let [u, channel] = stream.next_2d();
        stream.seek(segment.base + dim::DISTANCE_FINE);
        match media.draw(self.ray, dim::fine([u, stream.next_1d()]), channel) {
            Distance::Through { weight } => Err(weight),
            Distance::Scatter(event) => Ok(Collision {
                event,
                position: segment.origin + segment.dir * event.t,
                origin: segment.origin,
                dir: segment.dir,
                range: range.unwrap_or((0.0, 0.0)),
            }),
        }
    }

    /// Direct light at an event by sampling a light (way 1), per unit of throughput after the event's weight.
    pub fn direct(&mut self, segment: &Segment<'_>, collision: &Collision, stream: &mut SampleStream) -> Rgb {
        let scene = self.scene;
        if scene.lights.is_empty() {
            return Rgb::ZERO;
        }
        stream.seek(segment.base + dim::LIGHT_POINT);
        let u = stream.next_2d();
        stream.seek(segment.base + dim::LIGHT);
        let choice = dim::fine(stream.next_2d());
        let place = scene.lights.at_point(collision.position, Vec3A::ZERO);
        let Some(drawn) = scene.lights.sample(&scene.world, &scene.textures, &place, segment.time, choice, u) else {
            return Rgb::ZERO;
        };
        let light = &drawn.sample;
        if light.radiance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let (phase, phase_pdf) = scene.media.phase(self.ray, &collision.event, -segment.dir, light.dir);
        let equiangular = collision.equiangular_pdf(scene, self.front.as_ref(), drawn.light, segment.time);
        // Relative to way 1 for the same light and direction.
        let by_distance = square(equiangular / (collision.event.pdf * drawn.probability));
        let by_phase = if light.delta == DeltaKind::Position { 0.0 } else { square(phase_pdf / light.pdf) };
        let weight = weight(self.only, Technique::Light, by_distance + by_phase);
        let visibility = self.visibility(segment, collision.position, light);
        phase * light.radiance * visibility * (weight / light.pdf)
    }

    /// Light scattered once on the segment, by a distance equiangular about a light (way 2).
    pub fn equiangular(&mut self, segment: &Segment<'_>, stream: &mut SampleStream) -> Rgb {
        let scene = self.scene;
        let Some(drawn) = self.about_light(segment, *stream) else { return Rgb::ZERO };
        let AboutLight { light, probability, density, event } = drawn;
        let position = segment.origin + segment.dir * event.t;
        stream.seek(segment.base + dim::EQUIANGULAR_POINT);
        let point = stream.next_2d();
        let Some(sample) =
            scene.lights.sample_light(&scene.world, &scene.textures, light, position, segment.time, point)
        else {
            return Rgb::ZERO;
        };
        if sample.radiance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let (phase, phase_pdf) = scene.media.phase(self.ray, &event, -segment.dir, sample.dir);
        let pdf = probability * sample.pdf;
        let at_event = scene.lights.probability(&scene.lights.at_point(position, Vec3A::ZERO), light);
        let by_light = square(event.pdf * at_event / (density * probability));
        let by_phase =
            if sample.delta == DeltaKind::Position { 0.0 } else { square(event.pdf * phase_pdf / (density * pdf)) };
        let weight = weight(self.only, Technique::Equiangular, by_light + by_phase);
        let visibility = self.visibility(segment, position, &sample);
        event.weight * phase * sample.radiance * visibility * (weight / (density * pdf))
    }

    /// The light and the distance about it that the numbers of the segment choose.
    #[inline]
    pub fn about_light(&mut self, segment: &Segment<'_>, mut stream: SampleStream) -> Option<AboutLight> {
        let scene = self.scene;
        if scene.lights.is_empty() {
            return None;
        }
        let range = scene.media.scattering_range(self.ray)?;
        stream.seek(segment.base + dim::EQUIANGULAR);
        let u = stream.next_1d();
        stream.seek(segment.base + dim::EQUIANGULAR_LIGHT);
        let choice = dim::fine(stream.next_2d());
        let place = scene.lights.along(segment.origin, segment.dir, range);
        let front = self.front.get_or_insert_with(|| scene.lights.front(&place));
        let (light, probability) = scene.lights.choose_from(front, &place, choice)?;
        let distances = about(scene, light, segment.time, segment.origin, segment.dir, range);
        let (t, density) = distances.sample(u)?;
        let event = scene.media.event_at(self.ray, range.0 + t)?;
        Some(AboutLight { light, probability, density, event })
    }

    /// The medium of an event on the segment; of several the one that scatters most there.
    pub fn medium_of(&self, event: &Event) -> u16 {
        self.scene.media.medium_of(self.ray, event)
    }

    /// The first medium on the segment that glows.
    pub fn glowing(&self) -> u16 {
        self.scene.media.glowing(self.ray)
    }

    fn visibility(&mut self, segment: &Segment<'_>, position: Vec3A, light: &LightSample) -> Rgb {
        let from = (position, Vec3A::ZERO, Vec3A::ZERO);
        self.shadow.visibility::<true>(self.scene, from, light, segment.time, segment.inside, self.counters)
    }

    /// Draws the direction after an event: (direction, density, factor on the throughput).
    pub fn scatter(
        &mut self,
        segment: &Segment<'_>,
        collision: &Collision,
        stream: &mut SampleStream,
    ) -> Option<(Vec3A, f32, Rgb)> {
        let media = &self.scene.media;
        stream.seek(segment.base + dim::LOBE);
        let choice = stream.next_1d();
        stream.seek(segment.base + dim::DIRECTION);
        let drawn = media.draw_phase(self.ray, &collision.event, choice).sample(-segment.dir, stream.next_2d());
        let (value, pdf) = media.phase(self.ray, &collision.event, -segment.dir, drawn.wi);
        (pdf > 0.0).then(|| (drawn.wi, pdf, value / pdf))
    }
}
