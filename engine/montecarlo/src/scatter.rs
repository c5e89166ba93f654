//! Scattering of a path at a surface.

use crate::dimensions as dim;
use crate::guided::{DirectionSampler, GuidedSample};
use crate::path_state::{PathState, PreviousVertex, SegmentOrigin};
use crate::record::{
    Continuation, Contribution, InteractionKind, LobeSplit, PathEnd, Recorder, Termination, Vertex, VertexLocation,
};
use crate::surface::SurfaceInteraction;
use crate::tracer::{PathSample, Tracer};
use femc_emission::PointContext;
use femc_field::{Field, Side};
use femc_geometry::{Ray, offset_origin};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_prepared::Crossing;
use femc_scattering::{LobeKind, Transmitted};
use std::f32::consts::FRAC_1_PI;
use std::ops::ControlFlow;

impl PathState {
    /// Continues the ray behind a surface that it goes straight through. The path stays on its segment: sampled light reaches the
    /// previous vertex through the same surfaces, so light that is hit is weighted against that.
    #[inline(always)]
    pub(crate) fn continue_straight(&mut self, surface: &SurfaceInteraction<'_>) {
        surface.cross_boundary(&mut self.medium_stack);
        self.ray = surface.ray_behind(&self.ray);
    }

    /// Returns the light that the field expects of the path from a vertex on, relative to that from the first vertex on. `None`: the
    /// field has no data there.
    /// - `light_ahead`: light that the vertex scatters toward the previous vertex, lx.
    #[inline(always)]
    fn expected_survival(&mut self, light_ahead: Rgb) -> Option<f32> {
        let ahead = luminance(self.throughput * light_ahead);
        let is_known = ahead > 0.0 && ahead.is_finite();
        if self.expected_light == 0.0 && is_known {
            self.expected_light = ahead;
        }
        is_known.then(|| ahead / self.expected_light)
    }
}

impl<R: Recorder> Tracer<'_, R> {
    /// Adds the direct light on a surface, and the light of the field if paths end there. Then samples the direction in which the
    /// path continues.
    #[inline(always)]
    pub(crate) fn scatter_at_surface<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        surface: &SurfaceInteraction<'_>,
        out: &mut PathSample,
    ) -> ControlFlow<Termination> {
        let &SurfaceInteraction { hit, ref point, ref bsdf, ref frame, wo, .. } = surface;
        path.vertices += 1;
        record!(self.recorder.vertex(|| Vertex {
            location: VertexLocation::Surface {
                instance: hit.instance,
                primitive: hit.primitive,
                material: point.material
            },
            position: point.position,
            bounce: path.bounce,
            throughput: path.throughput,
        }));
        let mut directions = DirectionSampler::new(bsdf, frame, wo);
        if let Some(field) = self.guide {
            directions = directions.with_guide(field, surface);
            self.counters.guided += u64::from(directions.is_guided());
        }
        let survival = path.expected_survival(directions.light_ahead);
        let light_context =
            self.scene.lights.point_context(point.position, surface.lit_side(), surface.lobes(path.ray.dir));
        self.add_next_event::<MEDIA, RECORD_ALL>(path, surface, &directions, &light_context, out);
        let rest;
        if let Some(field) = self.field {
            let color = path.throughput * field_light(field, surface) * FRAC_1_PI;
            out.color += color;
            record!(self.recorder.contribution(|| Contribution::from_field(
                color,
                path.throughput,
                path.bounce,
                point.position
            )));
            rest = bsdf.without_lambertian();
            directions = DirectionSampler::new(&rest, frame, wo);
        }
        self.continue_path::<MEDIA, RECORD_ALL>(path, surface, &directions, &light_context, survival)
    }

    /// Samples the direction in which the path continues from a surface.
    /// - `light_context`: context for which the lamps were weighed;
    /// - `survival`: light that the field expects of the path, as for [`PathState::roulette`].
    #[inline(always)]
    fn continue_path<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        surface: &SurfaceInteraction<'_>,
        directions: &DirectionSampler<'_>,
        light_context: &PointContext,
        survival: Option<f32>,
    ) -> ControlFlow<Termination> {
        let point = &surface.point;
        path.stream.seek(path.base + dim::LOBE);
        let choice = path.stream.next_1d();
        path.stream.seek(path.base + dim::DIRECTION);
        let Some(GuidedSample { sample: scattered, pdf_ratio, is_guide_sample }) =
            directions.sample(path.stream.next_2d(), choice)
        else {
            let is_field = self.field.is_some();
            return ControlFlow::Break(path.end(if is_field { PathEnd::Field } else { PathEnd::Absorbed }));
        };
        path.throughput *= scattered.weight;
        path.roulette_scale *= pdf_ratio;
        let is_delta = scattered.lobe == LobeKind::Delta;
        if is_delta && scattered.transmitted == Transmitted::Yes && surface.crossing != Crossing::Scatter {
            record!(self.recorder.leave(Continuation::unguided(InteractionKind::Straight)));
            path.continue_straight(surface);
            return path.roulette::<MEDIA>(None);
        }
        let wi = surface.frame.to_world(scattered.wi);
        if !surface.sides_agree(scattered.wi, wi) {
            return ControlFlow::Break(path.end(PathEnd::Absorbed));
        }
        if scattered.eta != 1.0 {
            path.roulette_scale *= scattered.eta * scattered.eta;
        }
        if surface.leaves_front(wi) == surface.back {
            surface.cross_boundary(&mut path.medium_stack);
        }
        let origin = if is_delta {
            record!(self.recorder.leave(Continuation::unguided(match scattered.transmitted {
                Transmitted::No => InteractionKind::Reflection,
                Transmitted::Yes => InteractionKind::Refraction,
            })));
            SegmentOrigin::Delta
        } else {
            let is_glossy = scattered.lobe == LobeKind::Glossy;
            let interaction = if is_glossy { InteractionKind::Glossy } else { InteractionKind::Diffuse };
            record!(self.recorder.lobe_split(|| LobeSplit::new(&surface.bsdf, surface.wo, scattered.wi)));
            record!(self.recorder.leave(Continuation { interaction, is_guide_sample }));
            SegmentOrigin::Surface { light_context: *light_context, pdf: scattered.pdf }
        };
        path.previous = PreviousVertex { position: point.position, origin };
        let origin = offset_origin(point.position, point.error, point.normal, wi);
        path.ray = Ray { origin, dir: wi, t_max: f32::INFINITY, time: path.ray.time };
        path.bounce += 1;
        path.roulette::<MEDIA>(survival)
    }
}

/// Returns the side of a surface on which the path is, and the other side.
#[inline]
fn sides(surface: &SurfaceInteraction<'_>) -> [Side; 2] {
    if surface.back { [Side::Back, Side::Front] } else { [Side::Front, Side::Back] }
}

/// Returns the estimated root mean square error of [`field_light`] over pi, cd/m2 by luminance.
pub(crate) fn field_light_error(field: &Field, surface: &SurfaceInteraction<'_>) -> f32 {
    let SurfaceInteraction { hit, point, .. } = surface;
    let (reflected, transmitted) = surface.bsdf.lambertian(surface.wo);
    let [here, behind] = sides(surface);
    let error = |color: Rgb, side| match luminance(color) {
        0.0 => 0.0,
        share => share * field.irradiance_error(hit, side, point.position),
    };
    let [here, behind] = [error(reflected, here), error(transmitted, behind)];
    (here * here + behind * behind).sqrt() * FRAC_1_PI
}

/// Returns the light of a field that the diffuse lobes of a surface scatter toward the path, times pi, cd/m2.
#[inline]
fn field_light(field: &Field, surface: &SurfaceInteraction<'_>) -> Rgb {
    let SurfaceInteraction { hit, point, back, .. } = surface;
    let (reflected, transmitted) = surface.bsdf.lambertian(surface.wo);
    let [here, behind] = sides(surface);
    let facing = if *back { -point.shading_normal } else { point.shading_normal };
    let light = |side, normal| field.irradiance(hit, side, point.position, normal);
    let mut color = reflected * light(here, facing);
    if transmitted != Rgb::ZERO {
        color += transmitted * light(behind, -facing);
    }
    color
}
