//! Scattering of a path at a surface.

use crate::guided::{DirectionSampler, GuideDirections, GuidedSample, SurfaceGuide};
use crate::path_state::{PathState, PreviousVertex, SegmentOrigin};
use crate::record::{
    self, BranchEvent, Continuation, Contribution, Decision, Direction, Expectation, InteractionKind, LobeSplit,
    PathEnd, Recorder, Termination, VertexLocation,
};
use crate::roulette::RouletteRule;
use crate::surface::SurfaceInteraction;
use crate::tracer::{PathSample, Tracer};
use crate::window::{DirectionNumbers, MAX_BRANCHES, WindowDecision, branch_number};
use femc_emission::PointContext;
use femc_field::{Field, Side};
use femc_geometry::{Ray, offset_origin};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_prepared::Crossing;
use femc_scattering::{LobeKind, Transmitted};
use std::f32::consts::FRAC_1_PI;
use std::ops::ControlFlow;

/// A surface from which a path continues.
#[derive(Clone, Copy)]
struct Continuing<'s> {
    surface: &'s SurfaceInteraction<'s>,
    directions: &'s DirectionSampler<'s>,
    /// Context for which the lamps were weighed.
    light_context: &'s PointContext,
    /// Region of the targets, and the radiance that the field expects to be scattered toward the previous vertex, cd/m2.
    expected: Option<(u32, Rgb)>,
}

impl PathState {
    /// Continues the ray behind a surface that it goes straight through. The path stays on its segment: sampled light reaches the
    /// previous vertex through the same surfaces, so light that is hit is weighted against that.
    #[inline(always)]
    pub(crate) fn continue_straight(&mut self, surface: &SurfaceInteraction<'_>) {
        surface.cross_boundary(&mut self.medium_stack);
        self.ray = surface.ray_behind(&self.ray);
    }
}

/// A vertex of a path at a surface, from its arrival to its departure.
pub(crate) struct Vertex<'a> {
    /// The surface.
    pub surface: SurfaceInteraction<'a>,
    /// Directions of the guide, and the share of directions to sample from them.
    guide: Option<(GuideDirections<'a>, f32)>,
    /// Decision of the weight window.
    decision: WindowDecision,
    /// Region of the targets, and the radiance that the field expects to be scattered toward the previous vertex, cd/m2.
    expected: Option<(u32, Rgb)>,
    /// Context for which the lamps are weighed.
    pub light_context: PointContext,
}

impl Vertex<'_> {
    /// Returns the sampler of directions.
    #[inline(always)]
    pub fn directions(&self) -> DirectionSampler<'_> {
        let surface = &self.surface;
        let mut directions = DirectionSampler::new(&surface.bsdf, &surface.frame, surface.wo);
        if let Some((guide, share)) = &self.guide {
            directions.add_guide(guide, *share);
        }
        directions
    }
}

impl<'a, R: Recorder> Tracer<'a, R> {
    /// Adds the direct light on a surface, and the light of the field if paths end there. Then samples the direction in which the
    /// path continues.
    #[inline(always)]
    pub(crate) fn scatter_at_surface<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        surface: SurfaceInteraction<'a>,
        out: &mut PathSample,
    ) -> ControlFlow<Termination> {
        let vertex = self.begin_vertex::<RECORD_ALL>(path, surface);
        if let Some(event) = self.sample_next_event::<RECORD_ALL>(path, &vertex) {
            self.add_next_event::<MEDIA, RECORD_ALL>(path, &vertex, &event, out);
        }
        self.leave_vertex::<MEDIA, RECORD_ALL>(path, &vertex, out)
    }

    /// Creates the vertex of a path at a surface: finds its guide, and decides by the weight window.
    #[inline(always)]
    pub(crate) fn begin_vertex<const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        surface: SurfaceInteraction<'a>,
    ) -> Vertex<'a> {
        let SurfaceInteraction { hit, ref point, .. } = surface;
        path.vertices += 1;
        record!(self.recorder.vertex(|| record::Vertex {
            location: VertexLocation::Surface {
                instance: hit.instance,
                primitive: hit.primitive,
                material: point.material
            },
            position: point.position,
            bounce: path.bounce,
            throughput: path.throughput,
        }));
        let mut guide = None;
        let mut decision = WindowDecision::Unknown;
        let copies = self.first_branches(path);
        if copies > 1 && !surface.bsdf.is_delta_only() {
            decision = WindowDecision::Copies(copies);
        }
        let mut expected = None;
        if let Some(guidance) = self.guidance {
            let SurfaceGuide { leaf, radiance, region } = SurfaceGuide::new(guidance.field, guidance.targets, &surface);
            decision = guidance.decide(path, radiance);
            expected = region.map(|region| (region, radiance));
            if let Some(expected) = expected {
                record!(self.recorder.expectation(|| expectation(expected, path.throughput)));
            }
            if guidance.samples_directions
                && let Some((leaf, share)) = leaf
                && let Some(found) = leaf.directions_at(point.position)
            {
                guide = Some((found, share));
                self.counters.guided += 1;
            }
        }
        let light_context =
            self.scene.lights.point_context(point.position, surface.lit_side(), surface.lobes(path.ray.dir));
        Vertex { surface, guide, decision, expected, light_context }
    }

    /// Adds the light of the field if paths end there. Then samples the direction in which the path continues.
    #[inline(always)]
    pub(crate) fn leave_vertex<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        vertex: &Vertex<'a>,
        out: &mut PathSample,
    ) -> ControlFlow<Termination> {
        let Vertex { surface, light_context, expected, decision, .. } = vertex;
        let mut directions = vertex.directions();
        let rest;
        if let Some(field) = self.field {
            let color = path.throughput * field_light(field, surface) * FRAC_1_PI;
            out.color += color;
            record!(self.recorder.contribution(|| Contribution::from_field(
                color,
                path.throughput,
                path.bounce,
                surface.point.position
            )));
            rest = surface.bsdf.without_lambertian();
            directions = DirectionSampler::new(&rest, &surface.frame, surface.wo);
        }
        let continuing = Continuing { surface, directions: &directions, light_context, expected: *expected };
        self.apply_window::<MEDIA, RECORD_ALL>(path, *decision, continuing)
    }

    /// Continues a path from a surface as the weight window has decided: ends it, or splits it into branches.
    #[inline(always)]
    fn apply_window<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        decision: WindowDecision,
        from: Continuing<'_>,
    ) -> ControlFlow<Termination> {
        if let WindowDecision::Roulette(q) = decision {
            record!(self.recorder.decide(Decision::Window, path.bounce, &mut path.stream));
            if !path.survives_window(q) {
                return ControlFlow::Break(path.end(PathEnd::Roulette));
            }
        }
        record!(self.recorder.decide(Decision::Direction, path.bounce, &mut path.stream));
        let numbers = DirectionNumbers::draw(path, &from.surface.bsdf);
        if let WindowDecision::Copies(copies) = decision {
            let copies = copies.min(1 + MAX_BRANCHES - self.branches);
            if copies > 1 {
                self.split::<MEDIA, RECORD_ALL>(path, from, numbers, copies);
            }
        }
        self.continue_path::<MEDIA, RECORD_ALL>(path, from, numbers, decision.roulette_rule())
    }

    /// Splits a path at a surface.
    /// - `numbers`: random numbers of the direction of the remaining path.
    #[inline(never)]
    fn split<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        from: Continuing<'_>,
        numbers: DirectionNumbers,
        copies: u32,
    ) {
        self.split_path::<RECORD_ALL>(path, copies, |tracer, branch, copy| {
            let numbers = numbers.of_copy(copy, copies);
            tracer.continue_path::<MEDIA, RECORD_ALL>(branch, from, numbers, RouletteRule::LongPaths)
        });
    }

    /// Splits a path at its latest vertex into copies of equal weight. All but one become branches that wait to be traced.
    /// - `depart`: samples the direction in which a copy continues.
    #[inline(always)]
    pub(crate) fn split_path<const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        copies: u32,
        depart: impl Fn(&mut Self, &mut PathState, u32) -> ControlFlow<Termination>,
    ) {
        path.throughput /= copies as f32;
        path.roulette_scale *= copies as f32;
        self.branches += copies - 1;
        for copy in 1..copies {
            let mut branch = *path;
            record!(self.recorder.branch(BranchEvent::Begin));
            if depart(self, &mut branch, copy).is_break() {
                record!(self.recorder.branch(BranchEvent::Discard));
                // A copy with an invalid throughput makes the sample a bad one.
                if !branch.throughput.is_finite() {
                    path.throughput = Rgb::NAN;
                }
            } else {
                record!(self.recorder.branch(BranchEvent::Suspend));
                branch.stream = path.stream.branch(branch_number(path.rays, copy));
                self.pending.push(branch);
            }
        }
    }

    /// Samples the direction in which the path continues from a surface.
    /// - `rule`: rule by which Russian roulette ends it there.
    #[inline(always)]
    fn continue_path<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        Continuing { surface, directions, light_context, expected }: Continuing<'_>,
        numbers: DirectionNumbers,
        rule: RouletteRule,
    ) -> ControlFlow<Termination> {
        let point = &surface.point;
        let Some(GuidedSample { sample: scattered, pdf_ratio, is_guide_sample }) =
            directions.sample(numbers.u, numbers.choice)
        else {
            let is_field = self.field.is_some();
            return ControlFlow::Break(path.end(if is_field { PathEnd::Field } else { PathEnd::Absorbed }));
        };
        let throughput = path.throughput;
        path.throughput *= scattered.weight;
        path.roulette_scale *= pdf_ratio;
        let is_delta = scattered.lobe == LobeKind::Delta;
        if is_delta && scattered.transmitted == Transmitted::Yes && surface.crossing != Crossing::Scatter {
            record!(self.recorder.leave(Continuation::unguided(InteractionKind::Straight)));
            path.continue_straight(surface);
            record!(self.recorder.decide(Decision::Roulette, path.bounce, &mut path.stream));
            return path.roulette::<MEDIA>(rule);
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
            if let Some(expected) = expected {
                record!(self.recorder.direction(|| Direction {
                    position: point.position,
                    dir: wi,
                    bounce: path.bounce,
                    expectation: expectation(expected, throughput),
                    guide_share: directions.guide_share(),
                    pdf_ratio,
                }));
            }
            record!(self.recorder.lobe_split(|| LobeSplit::new(&surface.bsdf, surface.wo, scattered.wi)));
            record!(self.recorder.leave(Continuation { interaction, is_guide_sample }));
            SegmentOrigin::Surface { light_context: *light_context, pdf: scattered.pdf }
        };
        path.previous = PreviousVertex { position: point.position, origin };
        let origin = offset_origin(point.position, point.error, point.normal, wi);
        path.ray = Ray { origin, dir: wi, t_max: f32::INFINITY, time: path.ray.time };
        record!(self.recorder.decide(Decision::Roulette, path.bounce, &mut path.stream));
        path.bounce += 1;
        path.roulette::<MEDIA>(rule)
    }
}

/// Returns the light that a field expects of a path with this throughput at a region that scatters this radiance.
fn expectation((region, radiance): (u32, Rgb), throughput: Rgb) -> Expectation {
    Expectation { region, light: luminance(throughput * radiance) }
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

#[cfg(test)]
mod weights;
