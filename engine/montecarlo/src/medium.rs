//! Media that a path crosses: emission, single scattering, and collisions.

use crate::dimensions as dim;
use crate::fog::{Collision, FogSampler, FreeFlight, SingleScatterSample};
use crate::path_state::{PathState, PreviousVertex, SegmentOrigin};
use crate::record::{
    Continuation, Contribution, Decision, InteractionKind, LightTechnique, PathEnd, Recorder, Termination, Vertex,
    VertexLocation,
};
use crate::roulette::RouletteRule;
use crate::tracer::{PathSample, Tracer};
use crate::window::WindowDecision;
use femc_emission::DirectionContext;
use femc_field::DirectionTable;
use femc_geometry::{Ray, shadow_segment};
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::Prepared;
use std::ops::ControlFlow;

/// A collision from which a path continues.
#[derive(Clone, Copy)]
struct CollisionExit<'s> {
    collision: &'s Collision,
    /// Context for directions toward lights.
    lights: Option<&'s DirectionContext>,
    /// Table of directions of the guide.
    table: Option<&'s DirectionTable>,
    /// Rule of Russian roulette.
    rule: RouletteRule,
}

impl<R: Recorder> Tracer<'_, R> {
    /// Returns the sampler of the media of the current ray, and the recorder.
    #[inline(always)]
    fn fog_sampler(&mut self) -> (FogSampler<'_>, &mut R) {
        let fog = FogSampler {
            scene: self.scene,
            ray: &mut self.fog,
            direction_weights: &mut self.direction_weights,
            shadow: &mut self.shadow,
            counters: &mut self.counters,
            single_technique: self.settings.single_technique,
        };
        (fog, &mut self.recorder)
    }

    /// Adds the light that the media of the current ray emit, and the light of lamps that they scatter once into it. Then samples
    /// the distance of the next collision. `None`: the path reaches the end of the ray.
    /// - `t_hit`: distance of the surface at the end of the ray, m.
    #[inline(always)]
    pub(crate) fn cross_media<const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        t_hit: f32,
        out: &mut PathSample,
    ) -> Option<Collision> {
        let (scene, ray) = (self.scene, path.ray);
        if !scene.media.find_intervals(ray.origin, ray.dir, t_hit, &path.medium_stack, &mut self.fog.media) {
            return None;
        }
        let is_last = self.settings.is_last(path.bounce);
        let (mut fog, recorder) = self.fog_sampler();
        record!(recorder.decide(Decision::Glow, path.bounce, &mut path.stream));
        let color = path.throughput * fog.glow(path);
        out.color += color;
        if color != Rgb::ZERO {
            record!(recorder.contribution(|| Contribution {
                color,
                throughput: path.throughput,
                bounce: path.bounce,
                technique: LightTechnique::Glow,
                medium: Some(fog.emitting_medium()),
                light: None,
                position: ray.origin,
            }));
        }
        if !is_last {
            fog.weigh_lights(path);
            let mut decide = |decision, path: &mut PathState| {
                record!(recorder.decide(decision, path.bounce, &mut path.stream));
            };
            if let Some(scattered) = fog.sample_airlight(path, &mut decide) {
                if RECORD_ALL
                    && R::WANTS_OCCLUDERS
                    && scattered.color == Rgb::ZERO
                    && let Some(shadow) = airlight_shadow_ray(scene, path, &scattered)
                {
                    record!(recorder.occluded(|| shadow));
                }
                let color = path.throughput * scattered.color;
                out.color += color;
                if R::WANTS_ZERO_LIGHT || color != Rgb::ZERO {
                    record!(recorder.contribution(|| Contribution {
                        color,
                        throughput: path.throughput,
                        bounce: path.bounce,
                        technique: LightTechnique::Airlight,
                        medium: Some(fog.dominant_medium(&scattered.event)),
                        light: Some(scattered.light),
                        position: ray.origin + ray.dir * scattered.event.t,
                    }));
                }
            }
        }
        record!(recorder.decide(Decision::Distance, path.bounce, &mut path.stream));
        match fog.sample_collision(path) {
            FreeFlight::Collision(collision) => Some(collision),
            FreeFlight::Through { weight } => {
                path.throughput *= weight;
                None
            }
        }
    }

    /// Scatters the path at a collision, or ends it there.
    #[inline(always)]
    pub(crate) fn scatter_in_medium<const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        collision: &Collision,
        out: &mut PathSample,
    ) -> ControlFlow<Termination> {
        path.awaits_first_surface = false;
        if self.settings.is_last(path.bounce) {
            return ControlFlow::Break(path.end(PathEnd::Depth));
        }
        path.throughput *= collision.event.weight;
        let position = collision.position;
        path.vertices += 1;
        let field = self.field;
        let (fog, recorder) = self.fog_sampler();
        record!(recorder.vertex(|| Vertex {
            location: VertexLocation::Medium(fog.dominant_medium(&collision.event)),
            position,
            bounce: path.bounce,
            throughput: path.throughput,
        }));
        if let Some(field) = field {
            let color = path.throughput * field.fog.scattered_radiance(position, -path.ray.dir);
            out.color += color;
            record!(recorder.contribution(|| Contribution::from_field(color, path.throughput, path.bounce, position)));
            return ControlFlow::Break(path.end(PathEnd::Field));
        }
        // The window splits no path in fog: light that the copies hit would need the weights of the lamps for the segment before.
        let guidance = self.guidance;
        let decision = guidance.map_or(WindowDecision::Unknown, |guidance| {
            guidance.decide(path, guidance.field.fog.scattered_radiance(position, -path.ray.dir))
        });
        if let WindowDecision::Roulette(q) = decision {
            record!(self.recorder.decide(Decision::Window, path.bounce, &mut path.stream));
            if !path.survives_window(q) {
                return ControlFlow::Break(path.end(PathEnd::Roulette));
            }
        }
        let guides = guidance.filter(|guidance| guidance.samples_directions && !guidance.field.tables.is_empty());
        let table = guides.and_then(|guidance| guidance.field.fog_table_at(position));
        record!(self.recorder.decide(Decision::Direction, path.bounce, &mut path.stream));
        let from = self.fog_sampler().0.weigh_directions(path, collision);
        let from = CollisionExit { collision, lights: from.as_ref(), table, rule: decision.roulette_rule() };
        let copies = self.first_branches(path);
        if copies > 1 {
            self.split_at_collision::<RECORD_ALL>(path, &from, copies);
        }
        let flow = self.continue_from_collision::<RECORD_ALL>(path, &from, [0, copies]);
        std::mem::swap(&mut self.fog, &mut self.fog_before);
        flow
    }

    /// Splits a path at its first vertex, a collision, into copies of equal weight. All but one become branches that wait to be traced.
    #[inline(never)]
    fn split_at_collision<const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        from: &CollisionExit<'_>,
        copies: u32,
    ) {
        self.first_fog.clone_from(&self.fog);
        self.split_path::<RECORD_ALL>(path, copies, |tracer, branch, copy| {
            tracer.continue_from_collision::<RECORD_ALL>(branch, from, [copy, copies])
        });
    }

    /// Samples the direction in which a path continues from a collision.
    /// - `copy`: number of a copy of the path, and the number of copies.
    #[inline(always)]
    fn continue_from_collision<const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        from: &CollisionExit<'_>,
        copy: [u32; 2],
    ) -> ControlFlow<Termination> {
        let CollisionExit { collision, lights, table, rule } = *from;
        let (mut fog, recorder) = self.fog_sampler();
        let Some(scattered) = fog.sample_direction(path, collision, lights, table, copy) else {
            return ControlFlow::Break(path.end(PathEnd::Absorbed));
        };
        record!(
            recorder.leave(Continuation {
                interaction: InteractionKind::Volume,
                is_guide_sample: scattered.is_guide_sample
            })
        );
        path.throughput *= scattered.weight;
        let position = collision.position;
        let origin = SegmentOrigin::Medium { collision: *collision, phase_pdf: scattered.phase_pdf };
        path.previous = PreviousVertex { position, origin };
        path.ray = Ray { origin: position, dir: scattered.dir, t_max: f32::INFINITY, time: path.ray.time };
        record!(self.recorder.decide(Decision::Roulette, path.bounce, &mut path.stream));
        path.bounce += 1;
        path.roulette_scale *= scattered.pdf / scattered.phase_pdf;
        path.roulette::<true>(rule)
    }
}

/// Returns the ray from a point in fog to the point that was sampled on a lamp, for a sample without light. `None`: the lamp emits
/// nothing toward the point.
#[cold]
fn airlight_shadow_ray(scene: &Prepared, path: &mut PathState, scattered: &SingleScatterSample) -> Option<Ray> {
    let position = path.ray.origin + path.ray.dir * scattered.event.t;
    path.stream.seek(path.base + dim::AIRLIGHT_POINT);
    let (light, time, u) = (scattered.light, path.ray.time, path.stream.next_2d());
    let point = scene.lights.sample_light(&scene.world, &scene.textures, light, position, time, u)?;
    let lamp = (point.position, point.error, point.normal);
    (point.radiance != Rgb::ZERO).then(|| shadow_segment((position, Vec3A::ZERO, Vec3A::ZERO), lamp, time))
}
