//! Direct light on a surface by sampling a light.

use crate::dimensions as dim;
use crate::path_state::PathState;
use crate::record::{Contribution, Decision, LightTechnique, LobeSplit, Recorder};
use crate::scatter::Vertex;
use crate::square;
use crate::technique::{MisTechnique, mis_weight};
use crate::tracer::{PathSample, Tracer};
use femc_emission::{DeltaKind, LightSample};
use femc_geometry::shadow_segment;
use femc_math::Rgb;
use femc_math::glam::Vec3A;

/// A lamp that was sampled for the direct light on a surface.
pub(crate) struct NextEvent {
    /// Index of the lamp.
    lamp: u32,
    /// The sampled point. `None`: it sends no light that the surface scatters toward the path.
    point: Option<NextEventPoint>,
}

/// Point of a lamp before its shadow ray.
struct NextEventPoint {
    /// Point of the lamp, with the density of its choice.
    light: LightSample,
    /// Direction to the point, local frame.
    wi: Vec3A,
    /// BSDF times cosine, 1/sr.
    value: Rgb,
}

impl<'a, R: Recorder> Tracer<'a, R> {
    /// Samples a lamp, and a point on it, for the direct light on a surface. The weights of the lamps for it are kept.
    #[inline(always)]
    pub(crate) fn sample_next_event<const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        vertex: &Vertex<'a>,
    ) -> Option<NextEvent> {
        let Vertex { surface, light_context, .. } = vertex;
        let (scene, lights) = (self.scene, &self.scene.lights);
        if surface.bsdf.is_delta_only() || lights.is_empty() {
            return None;
        }
        lights.weigh(light_context, &mut self.surface_weights);
        record!(self.recorder.decide(Decision::Lamp, path.bounce, &mut path.stream));
        let number = || dim::draw_48(&mut path.stream, path.base + dim::LIGHT);
        let (lamp, probability) = lights.choose(&self.surface_weights, light_context, number)?;
        record!(self.recorder.decide(Decision::LampPoint, path.bounce, &mut path.stream));
        path.stream.seek(path.base + dim::LIGHT_POINT);
        let u = path.stream.next_2d();
        let time = path.ray.time;
        let sampled = lights.sample_light(&scene.world, &scene.textures, lamp, surface.point.position, time, u);
        let point = sampled.and_then(|mut light| {
            light.pdf *= probability;
            let wi = surface.frame.to_local(light.dir);
            let value = surface.bsdf.eval(surface.wo, wi);
            let is_dark = value == Rgb::ZERO || light.radiance == Rgb::ZERO || !surface.sides_agree(wi, light.dir);
            (!is_dark).then_some(NextEventPoint { light, wi, value })
        });
        Some(NextEvent { lamp, point })
    }

    /// Adds the light of a sampled lamp that the surface scatters toward the path.
    #[inline(always)]
    pub(crate) fn add_next_event<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        vertex: &Vertex<'a>,
        event: &NextEvent,
        out: &mut PathSample,
    ) {
        let light = match &event.point {
            Some(point) => self.direct_light::<MEDIA, RECORD_ALL>(path, vertex, point),
            None => Rgb::ZERO,
        };
        let color = path.throughput * light;
        out.color += color;
        if R::WANTS_ZERO_LIGHT || color != Rgb::ZERO {
            record!(self.recorder.contribution(|| Contribution {
                color,
                throughput: path.throughput,
                bounce: path.bounce,
                technique: LightTechnique::NextEvent,
                medium: None,
                light: Some(event.lamp),
                position: vertex.surface.point.position,
            }));
        }
    }

    /// Computes the light of a point of a lamp that the surface scatters toward the path.
    #[inline(always)]
    fn direct_light<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &PathState,
        vertex: &Vertex<'a>,
        NextEventPoint { light, wi, value }: &NextEventPoint,
    ) -> Rgb {
        let (scene, surface, time) = (self.scene, &vertex.surface, path.ray.time);
        let point = &surface.point;
        let mut medium_stack = path.medium_stack;
        if MEDIA && surface.leaves_front(light.dir) == surface.back {
            surface.cross_boundary(&mut medium_stack);
        }
        let from = (point.position, point.error, point.normal);
        let visibility = self.shadow.visibility::<MEDIA>(scene, from, light, time, &medium_stack, &mut self.counters);
        if visibility == Rgb::ZERO {
            record!(self.recorder.occluded(|| shadow_segment(from, (light.position, light.error, light.normal), time)));
            return Rgb::ZERO;
        }
        record!(self.recorder.lobe_split(|| LobeSplit::new(&surface.bsdf, surface.wo, *wi)));
        let by_scattering = if light.delta == DeltaKind::Position {
            0.0
        } else {
            square(vertex.directions().pdf(*wi, light.dir) / light.pdf)
        };
        let weight = mis_weight(self.settings.single_technique, MisTechnique::Light, by_scattering);
        *value * light.radiance * (weight / light.pdf) * visibility
    }
}
