//! Paths side by side: vertices at opaque surfaces are computed in the lanes of vectors.
//!
//! Each lane traces one sample after the other. A ray is traced as in [`Tracer::sample`]. Where it reaches a matte or rough surface,
//! the path waits for the other lanes. Light and direction are then computed for all of them at a time ([`vertices`]). Any other
//! vertex is computed by the lane's own tracer. Lanes do the same operations as the tracer, in the same order, so samples are equal
//! to the bit to those traced one by one. Scenes with media or clear surfaces, guided paths and recorded paths have no lanes.

mod rectangle;
mod vectors;
mod vertices;

use crate::dimensions as dim;
use crate::path_state::{PathState, PreviousVertex, SegmentOrigin};
use crate::record::{PathEnd, RecordLevel, Termination};
use crate::roulette::LONG_PATH;
use crate::tracer::{PathSample, PixelFilter, Tracer, TracerCounters};
use crate::window::DirectionNumbers;
use femc_emission::{BsdfLobes, PointContext};
use femc_geometry::{Hit, Ray};
use femc_math::glam::Vec3A;
use femc_math::{Frame, Rgb, SampleStream};
use femc_prepared::ShadingPoint;
use femc_prepared::media::MediumStack;
use femc_scattering::Bsdf;
use femc_simd::WIDTH;
use std::ops::ControlFlow;
use vertices::{LaneScene, Scattering, Vertices};

/// Number of a sample: pixel (row-major index in the whole film), and sample of the pixel.
pub type SampleNumber = (u32, u32);

/// Tracer of the samples of one frame on one thread, several at a time. Nothing is recorded.
pub struct Packet<'a> {
    lanes: Vec<Lane<'a>>,
    /// `None`: a single lane traces each sample to its end.
    scene: Option<LaneScene>,
    vertices: Vertices,
}

/// One of the paths.
struct Lane<'a> {
    tracer: Tracer<'a>,
    /// Sample of the path; `None`: the lane waits for one.
    sample: Option<SampleNumber>,
    path: PathState,
    out: PathSample,
    /// Light of small emitters that the camera sees, cd/m2.
    camera_light: Rgb,
    /// BSDF of the rough surface at which the path waits.
    rough: Option<&'a Bsdf>,
    /// Context for which the lamps were weighed there.
    light_context: PointContext,
}

/// Ray of a lane that waits for its first sample.
const NO_RAY: Ray = Ray { origin: Vec3A::ZERO, dir: Vec3A::Z, t_max: 0.0, time: 0.0 };
/// Context of a place without lamps to choose from.
const NO_CONTEXT: PointContext = PointContext { position: Vec3A::ZERO, normal: Vec3A::ZERO, lobes: None };

/// Samples to trace, and their receiver.
struct Samples<I, F, D> {
    numbers: I,
    filter: F,
    done: D,
}

impl<'a> Packet<'a> {
    /// Creates a packet.
    /// - `tracer`: creates the tracer of a lane.
    pub fn new(tracer: impl Fn() -> Tracer<'a>) -> Self {
        let first = tracer();
        let is_plain = first.guidance.is_none() && first.field.is_none() && first.settings.single_technique.is_none();
        let scene = if is_plain { LaneScene::new(first.scene) } else { None };
        // Lanes without a common step would only wait for each other.
        let width = if scene.is_some() { WIDTH } else { 1 };
        let lane = || Lane {
            tracer: tracer(),
            sample: None,
            path: PathState::new(NO_RAY, SegmentOrigin::Delta, MediumStack::default(), SampleStream::new(0, 0, 0, 0)),
            out: PathSample::NOTHING,
            camera_light: Rgb::ZERO,
            rough: None,
            light_context: NO_CONTEXT,
        };
        Self { lanes: std::iter::repeat_with(lane).take(width).collect(), scene, vertices: Vertices::default() }
    }

    /// Replaces the instruction set, to test that all give the same bits.
    #[cfg(test)]
    fn set_level(&mut self, level: femc_simd::Level) {
        if let Some(scene) = &mut self.scene {
            scene.level = level;
        }
    }

    /// Returns the work done so far.
    pub fn counters(&self) -> TracerCounters {
        self.lanes.iter().map(|lane| lane.tracer.counters).sum()
    }

    /// Computes samples. They end in any order.
    /// - `done`: receives the number of each sample, and its result.
    pub fn trace(
        &mut self,
        numbers: impl Iterator<Item = SampleNumber>,
        filter: impl PixelFilter,
        mut done: impl FnMut(SampleNumber, PathSample),
    ) {
        let mut samples = Samples { numbers, filter, done: &mut done };
        match &self.scene {
            Some(_) => while self.step(&mut samples) {},
            None => {
                for number in samples.numbers {
                    let Some(lane) = self.lanes.first_mut() else { return };
                    (samples.done)(number, lane.tracer.sample(number.0, number.1, filter));
                }
            }
        }
    }

    /// Traces one ray of each path. Returns false if there is no path.
    fn step(
        &mut self,
        samples: &mut Samples<
            impl Iterator<Item = SampleNumber>,
            impl PixelFilter,
            impl FnMut(SampleNumber, PathSample),
        >,
    ) -> bool {
        let Self { lanes, scene: Some(scene), vertices } = self else { return false };
        let mut goes_on = false;
        vertices.clear();
        for (index, lane) in lanes.iter_mut().enumerate() {
            if lane.sample.is_none() && !lane.begin(samples) {
                continue;
            }
            goes_on = true;
            if let Some(flow) = lane.trace_ray(index, scene, vertices) {
                lane.advance(flow, samples);
            }
        }
        if vertices.used == 0 {
            return goes_on;
        }
        let (to_evaluate, unsampled) = vertices.sample_lamps(scene);
        for index in bits(to_evaluate) {
            lanes[index].evaluate(index, vertices);
        }
        let mut visible = 0;
        for index in bits(vertices.find_shadow_rays(scene)) {
            let Lane { tracer, path, .. } = &mut lanes[index];
            tracer.counters.shadow_rays += 1;
            let ray = vertices.shadow_ray(index, path.ray.time);
            visible |= u32::from(!tracer.scene.world.occluded(&ray)) << index;
        }
        for index in bits(vertices.rough) {
            lanes[index].sample_direction(index, vertices);
        }
        let continuing = vertices.leave(scene, visible);
        for index in bits(vertices.used) {
            let flow = lanes[index].leave(index, vertices, continuing >> index & 1 == 1);
            lanes[index].advance(flow, samples);
        }
        for index in bits(unsampled) {
            let flow = lanes[index].scatter_again();
            lanes[index].advance(flow, samples);
        }
        goes_on
    }
}

/// Returns the numbers of the set bits.
fn bits(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = (mask != 0).then(|| mask.trailing_zeros() as usize);
        mask &= mask.wrapping_sub(1);
        bit
    })
}

impl Lane<'_> {
    /// Begins a sample. Returns false if there is none.
    #[inline(always)]
    fn begin(
        &mut self,
        samples: &mut Samples<
            impl Iterator<Item = SampleNumber>,
            impl PixelFilter,
            impl FnMut(SampleNumber, PathSample),
        >,
    ) -> bool {
        self.sample = samples.numbers.next();
        let Some((pixel, sample)) = self.sample else { return false };
        (self.path, self.camera_light) = self.tracer.begin_path(pixel, sample, samples.filter, RecordLevel::End);
        self.out = PathSample::NOTHING;
        true
    }

    /// Traces the next ray of the path. `None`: the path waits at a surface.
    #[inline(always)]
    fn trace_ray(
        &mut self,
        index: usize,
        scene: &LaneScene,
        vertices: &mut Vertices,
    ) -> Option<ControlFlow<Termination>> {
        let Self { tracer, path, out, .. } = self;
        let hit = tracer.find_hit(path);
        let at = match tracer.reach::<false, false>(path, hit, out) {
            ControlFlow::Break(flow) => return Some(flow),
            ControlFlow::Continue(at) => at,
        };
        let (_, point) = &at;
        let dir = path.ray.dir;
        let is_inner = path.rays <= LONG_PATH && !tracer.settings.is_last(path.bounce);
        let surface = if is_inner { scene.surface(tracer.scene, point, dir) } else { None };
        let Some((facing, scattering)) = surface else {
            return Some(tracer.continue_at::<false, false>(path, at, out));
        };
        let wo = || Frame::from_normal(facing).to_local(-dir);
        if path.awaits_first_surface {
            path.awaits_first_surface = false;
            out.depth = tracer.scene.camera.depth(point.position, path.ray.time);
            let albedo = match scattering {
                Scattering::Matte { reflectance } => reflectance,
                Scattering::Rough(bsdf) => bsdf.albedo(wo()),
            };
            out.albedo = path.throughput * albedo;
        }
        vertices.add(index, path, point, (facing, scattering), out.color);
        self.rough = match scattering {
            Scattering::Matte { .. } => None,
            Scattering::Rough(bsdf) => Some(bsdf),
        };
        // A sole lamp is chosen without regard to the surface.
        if scene.lamp.is_none() {
            let lobes = self.rough.and_then(|bsdf| bsdf.glossy_lobes(wo()));
            let lobes = lobes.map(|(diffuse, glossy, alpha)| BsdfLobes { diffuse, glossy, alpha, wo: -dir });
            let lit_side = if point.normal.dot(dir) > 0.0 { -point.normal } else { point.normal };
            self.light_context = tracer.scene.lights.point_context(point.position, lit_side, lobes);
            self.sample_lamp(index, vertices);
        }
        None
    }

    /// Chooses a lamp, and samples a point on it.
    #[inline(always)]
    fn sample_lamp(&mut self, index: usize, vertices: &mut Vertices) {
        let Self { tracer, path, light_context: context, .. } = self;
        let (scene, lights) = (tracer.scene, &tracer.scene.lights);
        lights.weigh(context, &mut tracer.surface_weights);
        let number = || dim::draw_48(&mut path.stream, path.base + dim::LIGHT);
        let Some((lamp, probability)) = lights.choose(&tracer.surface_weights, context, number) else { return };
        path.stream.seek(path.base + dim::LIGHT_POINT);
        let u = path.stream.next_2d();
        let sampled = lights.sample_light(&scene.world, &scene.textures, lamp, context.position, path.ray.time, u);
        if let Some(mut light) = sampled {
            light.pdf *= probability;
            vertices.add_lamp_point(index, &light);
        }
    }

    /// Evaluates the rough surface at which the path waits, for the point of the lamp.
    #[inline(always)]
    fn evaluate(&self, index: usize, vertices: &mut Vertices) {
        let Some(bsdf) = self.rough else { return };
        let (wo, wi) = (vertices.wo.get(index), vertices.lamp_direction(index));
        vertices.set_value(index, bsdf.eval(wo, wi), bsdf.pdf(wo, wi));
    }

    /// Samples the direction in which the path leaves a rough surface.
    #[inline(always)]
    fn sample_direction(&mut self, index: usize, vertices: &mut Vertices) {
        let Some(bsdf) = self.rough else { return };
        let numbers = DirectionNumbers::draw(&mut self.path, bsdf);
        vertices.add_direction(index, bsdf.sample(vertices.wo.get(index), numbers.u, numbers.choice));
    }

    /// Continues the path from the surface at which it waits, or ends it there.
    #[inline(always)]
    fn leave(&mut self, index: usize, vertices: &Vertices, continues: bool) -> ControlFlow<Termination> {
        let path = &mut self.path;
        self.out.color = vertices.color(index);
        path.vertices += 1;
        path.throughput = vertices.throughput(index);
        if !continues {
            return ControlFlow::Break(path.end(PathEnd::Absorbed));
        }
        let (ray, pdf) = vertices.next_ray(index, path.ray.time);
        let origin = SegmentOrigin::Surface { light_context: self.light_context, pdf };
        path.previous = PreviousVertex { position: vertices.position.get(index), origin };
        path.ray = ray;
        path.bounce += 1;
        ControlFlow::Continue(())
    }

    /// Scatters the path at the surface of its current ray by its own tracer.
    #[inline(never)]
    fn scatter_again(&mut self) -> ControlFlow<Termination> {
        let Self { tracer, path, out, .. } = self;
        let at: Option<(Hit, ShadingPoint)> =
            tracer.scene.world.intersect(&path.ray).map(|hit| (hit, tracer.scene.shading_point(&path.ray, &hit)));
        match at {
            Some(at) => tracer.continue_at::<false, false>(path, at, out),
            None => ControlFlow::Break(path.end(PathEnd::Escaped)),
        }
    }

    /// Ends the path, and the sample after its last branch.
    #[inline(always)]
    fn advance(
        &mut self,
        flow: ControlFlow<Termination>,
        samples: &mut Samples<
            impl Iterator<Item = SampleNumber>,
            impl PixelFilter,
            impl FnMut(SampleNumber, PathSample),
        >,
    ) {
        let ControlFlow::Break(termination) = flow else { return };
        if self.tracer.end_path::<false>(&mut self.path, termination, &mut self.out).is_break()
            && let Some(number) = self.sample.take()
        {
            self.out.color += self.camera_light;
            (samples.done)(number, self.out);
        }
    }
}

#[cfg(test)]
mod tests;
