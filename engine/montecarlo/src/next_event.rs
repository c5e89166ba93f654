//! Direct light on a surface by sampling a light.

use crate::dimensions as dim;
use crate::guided::DirectionSampler;
use crate::path_state::PathState;
use crate::record::{Contribution, Decision, LightTechnique, LobeSplit, Recorder};
use crate::square;
use crate::surface::SurfaceInteraction;
use crate::technique::{MisTechnique, mis_weight};
use crate::tracer::{PathSample, Tracer};
use femc_emission::{DeltaKind, PointContext};
use femc_geometry::shadow_segment;
use femc_math::Rgb;

impl<R: Recorder> Tracer<'_, R> {
    /// Adds the light of a sampled lamp that the surface scatters toward the path.
    /// - `light_context`: the surface, for the choice of the lamp. The weights of the lamps for it are kept.
    #[inline(always)]
    pub(crate) fn add_next_event<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        surface: &SurfaceInteraction<'_>,
        directions: &DirectionSampler<'_>,
        light_context: &PointContext,
        out: &mut PathSample,
    ) {
        let lights = &self.scene.lights;
        if surface.bsdf.is_delta_only() || lights.is_empty() {
            return;
        }
        lights.weigh(light_context, &mut self.surface_weights);
        record!(self.recorder.decide(Decision::Lamp, path.bounce, &mut path.stream));
        let number = || dim::draw_48(&mut path.stream, path.base + dim::LIGHT);
        let Some(chosen) = lights.choose(&self.surface_weights, light_context, number) else { return };
        let light = self.sample_next_event::<MEDIA, RECORD_ALL>(path, surface, directions, chosen);
        let color = path.throughput * light;
        out.color += color;
        if R::WANTS_ZERO_LIGHT || color != Rgb::ZERO {
            record!(self.recorder.contribution(|| Contribution {
                color,
                throughput: path.throughput,
                bounce: path.bounce,
                technique: LightTechnique::NextEvent,
                medium: None,
                light: Some(chosen.0),
                position: surface.point.position,
            }));
        }
    }

    /// Computes direct light on a surface by sampling a point of a light.
    /// - `chosen`: index of the light, and the probability of choosing it.
    #[inline]
    fn sample_next_event<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        surface: &SurfaceInteraction<'_>,
        directions: &DirectionSampler<'_>,
        chosen: (u32, f32),
    ) -> Rgb {
        let (scene, point, time) = (self.scene, &surface.point, path.ray.time);
        record!(self.recorder.decide(Decision::LampPoint, path.bounce, &mut path.stream));
        path.stream.seek(path.base + dim::LIGHT_POINT);
        let u = path.stream.next_2d();
        let Some(mut light) =
            scene.lights.sample_light(&scene.world, &scene.textures, chosen.0, point.position, time, u)
        else {
            return Rgb::ZERO;
        };
        light.pdf *= chosen.1;
        let light = &light;
        let wi = surface.frame.to_local(light.dir);
        let value = surface.bsdf.eval(surface.wo, wi);
        if value == Rgb::ZERO || light.radiance == Rgb::ZERO || !surface.sides_agree(wi, light.dir) {
            return Rgb::ZERO;
        }
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
        record!(self.recorder.lobe_split(|| LobeSplit::new(&surface.bsdf, surface.wo, wi)));
        let by_scattering =
            if light.delta == DeltaKind::Position { 0.0 } else { square(directions.pdf(wi, light.dir) / light.pdf) };
        let weight = mis_weight(self.settings.single_technique, MisTechnique::Light, by_scattering);
        value * light.radiance * (weight / light.pdf) * visibility
    }
}
