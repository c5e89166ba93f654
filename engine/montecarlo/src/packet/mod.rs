//! Paths side by side: vertices at opaque surfaces are computed in the lanes of vectors.
//!
//! Each lane traces one sample after the other. The steps of a path are done for all lanes at a time: its beginning ([`paths`]), its
//! rays, the points that they hit ([`points`]), and light and direction there ([`vertices`]) if the surface is matte or rough. Any
//! other vertex is computed by the lane's own tracer. Lanes do the same operations as the tracer, in the same order, so samples are
//! equal to the bit to those traced one by one. Scenes with media or clear surfaces, guided paths and recorded paths have no lanes.

mod departures;
mod paths;
mod points;
mod rectangle;
mod rough;
mod vectors;
mod vertices;

use crate::dimensions as dim;
use crate::path_state::{PathState, PreviousVertex, SegmentOrigin};
use crate::record::{RecordLevel, Termination};
use crate::roulette::LONG_PATH;
use crate::tracer::{PathSample, PixelFilter, SHUTTER_CENTER, Tracer, TracerCounters};
use crate::window::branch_number;
use departures::{Branches, Leave};
use femc_emission::{BsdfLobes, PointContext};
use femc_geometry::Ray;
use femc_math::glam::Vec3A;
use femc_math::{Frame, Rgb, SampleStream};
use femc_prepared::Prepared;
use femc_prepared::compile::NONE;
use femc_prepared::media::MediumStack;
use femc_simd::{WIDTH, lanes_of};
use paths::{CameraRays, PathLanes};
use points::{FindPoints, PointLanes};
use std::ops::ControlFlow;
use vectors::FloatLanes;
use vertices::{LaneScene, Scattering, Vertices};

/// Number of a sample: pixel (row-major index in the whole film), and sample of the pixel.
pub type SampleNumber = (u32, u32);

/// Tracer of the samples of one frame on one thread, several at a time. Nothing is recorded.
pub struct Packet<'a> {
    lanes: Vec<Lane<'a>>,
    /// `None`: a single lane traces each sample to its end.
    scene: Option<LaneScene<'a>>,
    paths: PathLanes,
    points: PointLanes,
    vertices: Vertices,
    branches: Branches,
    /// Work done in lanes.
    counters: TracerCounters,
}

/// One of the paths.
struct Lane<'a> {
    tracer: Tracer<'a>,
    /// Sample of the path; `None`: the lane waits for one.
    sample: Option<SampleNumber>,
    /// The path. The parts that are in [`PathLanes`], too, are true only after [`Self::load`].
    path: PathState,
    out: PathSample,
    /// Light of small emitters that the camera sees, cd/m2.
    camera_light: Rgb,
    /// Context for which the lamps were weighed at the latest vertex.
    light_context: PointContext,
    /// Branches that wait to be traced, as bits, and what they share.
    waiting: u32,
    first: FirstVertex,
}

/// Parts of a path at its first vertex that its branches share.
#[derive(Clone, Copy)]
struct FirstVertex {
    /// Random numbers of the sample.
    stream: SampleStream,
    /// Context for which the lamps were weighed.
    light_context: PointContext,
}

/// Ray of a lane that waits for its first sample.
const NO_RAY: Ray = Ray { origin: Vec3A::ZERO, dir: Vec3A::Z, t_max: 0.0, time: SHUTTER_CENTER };
/// Context of a place without lamps to choose from.
const NO_CONTEXT: PointContext = PointContext { position: Vec3A::ZERO, normal: Vec3A::ZERO, lobes: None };

/// Samples to trace, and their receiver.
trait SampleQueue {
    type Filter: PixelFilter;
    /// Returns the next sample to trace.
    fn next(&mut self) -> Option<SampleNumber>;
    /// Returns the filter of the film.
    fn filter(&self) -> Self::Filter;
    /// Receives a finished sample.
    fn finish(&mut self, number: SampleNumber, sample: PathSample);
}

struct Samples<I, F, D> {
    numbers: I,
    filter: F,
    done: D,
}

impl<I: Iterator<Item = SampleNumber>, F: PixelFilter, D: FnMut(SampleNumber, PathSample)> SampleQueue
    for Samples<I, F, D>
{
    type Filter = F;

    #[inline(always)]
    fn next(&mut self) -> Option<SampleNumber> {
        self.numbers.next()
    }

    #[inline(always)]
    fn filter(&self) -> F {
        self.filter
    }

    #[inline(always)]
    fn finish(&mut self, number: SampleNumber, sample: PathSample) {
        (self.done)(number, sample);
    }
}

/// Checks whether unguided paths of a frame are traced side by side.
pub fn has_lanes(scene: &Prepared) -> bool {
    LaneScene::new(scene).is_some()
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
            light_context: NO_CONTEXT,
            waiting: 0,
            first: FirstVertex { stream: SampleStream::new(0, 0, 0, 0), light_context: NO_CONTEXT },
        };
        Self {
            lanes: std::iter::repeat_with(lane).take(width).collect(),
            scene,
            paths: PathLanes::default(),
            points: PointLanes::default(),
            vertices: Vertices::default(),
            branches: Branches::new(first.first_branches),
            counters: TracerCounters::default(),
        }
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
        self.lanes.iter().map(|lane| lane.tracer.counters).chain([self.counters]).sum()
    }

    /// Computes samples. They end in any order.
    /// - `done`: receives the number of each sample, and its result.
    pub fn trace(
        &mut self,
        numbers: impl Iterator<Item = SampleNumber>,
        filter: impl PixelFilter,
        done: impl FnMut(SampleNumber, PathSample),
    ) {
        let mut samples = Samples { numbers, filter, done };
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
    fn step(&mut self, samples: &mut impl SampleQueue) -> bool {
        let active = self.begin_paths(samples);
        if active == 0 {
            return false;
        }
        let escaped = self.trace_rays(active);
        let Self { lanes, scene: Some(scene), paths, points, vertices, branches, counters } = self else {
            return false;
        };
        for index in lanes_of(escaped) {
            lanes[index].finish(index, paths, branches, samples);
        }
        scene.level.run(FindPoints { points, paths });
        vertices.clear();
        for index in lanes_of(points.used) {
            if let Some(flow) = lanes[index].arrive(index, scene, paths, points, vertices) {
                lanes[index].advance(flow, index, paths, branches, samples);
            }
        }
        if vertices.used == 0 {
            return true;
        }
        let unsampled = vertices.sample_lamps(scene, points, paths);
        let (rays, used) = vertices.shadow_rays(&paths.time);
        let visible = used & !scene.prepared.world.occluded_lanes(rays, used);
        counters.shadow_rays += u64::from(used.count_ones());
        let split = if branches.exist() { first_vertices(lanes, vertices.used) } else { 0 };
        let continuing = scene.level.run(Leave { vertices, visible, points, paths, split, branches });
        for index in lanes_of(split) {
            let lane = &mut lanes[index];
            lane.waiting = branches.waiting(index);
            lane.first = FirstVertex { stream: lane.path.stream, light_context: lane.light_context };
        }
        paths.scattered |= vertices.used;
        for index in lanes_of(vertices.used) {
            if continuing >> index & 1 == 1 {
                lanes[index].path.bounce += 1;
            } else {
                lanes[index].finish(index, paths, branches, samples);
            }
        }
        for index in lanes_of(unsampled) {
            let flow = lanes[index].scatter(index, paths, points);
            lanes[index].advance(flow, index, paths, branches, samples);
        }
        true
    }

    /// Begins a sample in each lane that waits for one. Returns the lanes with a path.
    #[inline(always)]
    fn begin_paths(&mut self, samples: &mut impl SampleQueue) -> u32 {
        let Self { lanes, scene: Some(scene), paths, .. } = self else { return 0 };
        let (mut active, mut begun) = (0, 0);
        let mut film = [FloatLanes::default(); 2];
        for (index, lane) in lanes.iter_mut().enumerate() {
            if lane.sample.is_none() {
                lane.sample = samples.next();
                let Some((pixel, sample)) = lane.sample else { continue };
                lane.out = PathSample::NOTHING;
                paths.begin(index);
                if scene.view.is_some() && scene.prepared.camera_emitters.get(pixel).is_none() {
                    begun |= 1 << index;
                    let position = lane.begin(pixel, sample, samples.filter());
                    film[0].set(index, position[0]);
                    film[1].set(index, position[1]);
                } else {
                    (lane.path, lane.camera_light) =
                        lane.tracer.begin_path(pixel, sample, samples.filter(), RecordLevel::End);
                    paths.origin.set(index, lane.path.ray.origin);
                    paths.dir.set(index, lane.path.ray.dir);
                }
                paths.time.set(index, lane.path.ray.time);
            }
            lane.path.begin_ray();
            active |= 1 << index;
        }
        if let Some(view) = &scene.view
            && begun != 0
        {
            scene.level.run(CameraRays { view, lanes: begun, film: &film, paths });
        }
        active
    }

    /// Traces the next rays of paths to the closest surfaces. Returns the lanes of rays that hit nothing.
    #[inline(always)]
    fn trace_rays(&mut self, active: u32) -> u32 {
        let Self { scene: Some(scene), paths, points, counters, .. } = self else { return 0 };
        let rays = paths.rays();
        points.clear();
        let found = scene.prepared.world.intersect_lanes(rays, active, &mut points.hits);
        for index in lanes_of(found) {
            let hit = points.hits[index];
            match scene.prepared.flat_triangle(&hit) {
                Some(triangle) => points.add_flat(index, triangle),
                None => points.add(index, &scene.prepared.shading_point(&rays.ray(index), &hit)),
            }
        }
        let count = u64::from(active.count_ones());
        counters.rays += count;
        counters.segments += count;
        active & !found
    }
}

/// Returns the lanes whose paths are at their first vertex: `Tracer::first_branches`.
fn first_vertices(lanes: &[Lane<'_>], used: u32) -> u32 {
    lanes_of(used).filter(|index| lanes[*index].path.bounce == 0).fold(0, |first, index| first | 1 << index)
}

impl<'a> Lane<'a> {
    /// Begins a sample for a camera at rest without a lens, in a pixel without small emitters: `Tracer::begin_path`. Returns the
    /// position on the film, pixels.
    #[inline(always)]
    fn begin(&mut self, pixel: u32, sample: u32, filter: impl PixelFilter) -> [f32; 2] {
        let Self { tracer, path, .. } = self;
        path.stream = SampleStream::new(tracer.settings.seed, tracer.scene.frame, pixel, sample);
        path.stream.seek(dim::FILM);
        path.previous.origin = SegmentOrigin::Delta;
        path.awaits_first_surface = true;
        path.ray.time = SHUTTER_CENTER;
        (path.bounce, path.rays) = (0, 0);
        tracer.branches = 1;
        self.camera_light = Rgb::ZERO;
        let offset = filter.sample(path.stream.next_2d());
        let center = tracer.scene.camera.center(pixel);
        [center[0] + offset[0], center[1] + offset[1]]
    }

    /// Returns the vertex before the current segment.
    #[inline(always)]
    fn previous(&self, index: usize, paths: &PathLanes) -> PreviousVertex {
        if paths.scattered >> index & 1 == 0 {
            return self.path.previous;
        }
        let origin = SegmentOrigin::Surface { light_context: self.light_context, pdf: paths.pdf.get(index) };
        PreviousVertex { position: paths.previous.get(index), origin }
    }

    /// Copies the path from the lanes.
    #[inline(always)]
    fn load(&mut self, index: usize, paths: &PathLanes) {
        self.path.ray = paths.rays().ray(index);
        self.path.throughput = paths.throughput.get(index);
        self.path.roulette_scale = paths.roulette_scale.get(index);
        self.path.previous = self.previous(index, paths);
        self.out.color = paths.color.get(index);
    }

    /// Copies the path to the lanes.
    #[inline(always)]
    fn store(&self, index: usize, paths: &mut PathLanes) {
        paths.scattered &= !(1 << index);
        paths.origin.set(index, self.path.ray.origin);
        paths.dir.set(index, self.path.ray.dir);
        paths.throughput.set(index, self.path.throughput);
        paths.roulette_scale.set(index, self.path.roulette_scale);
        paths.color.set(index, self.out.color);
    }

    /// Brings the path to a surface. `None`: the path waits there.
    #[inline(always)]
    fn arrive(
        &mut self,
        index: usize,
        scene: &LaneScene<'a>,
        paths: &mut PathLanes,
        points: &PointLanes,
        vertices: &mut Vertices,
    ) -> Option<ControlFlow<Termination>> {
        if points.light(index) != NONE {
            self.add_emission(index, paths, points);
        }
        let Self { tracer, path, out, .. } = self;
        let is_inner = path.rays <= LONG_PATH && !tracer.settings.is_last(path.bounce);
        let scattering = if is_inner { scene.scattering(points, index) } else { None };
        let Some(scattering) = scattering else { return Some(self.scatter(index, paths, points)) };
        let dir = paths.dir.get(index);
        let wo = || Frame::from_normal(points.facing.get(index)).to_local(-dir);
        if path.awaits_first_surface {
            path.awaits_first_surface = false;
            out.depth = tracer.scene.camera.depth(points.position.get(index), path.ray.time);
            let albedo = match scattering {
                Scattering::Matte { reflectance } => reflectance,
                Scattering::Rough(surface) => surface.albedo(wo()),
            };
            out.albedo = paths.throughput.get(index) * albedo;
        }
        vertices.add(index, path, scattering);
        // A sole lamp is chosen without regard to the surface.
        if scene.lamp.is_none() {
            let lobes = match scattering {
                Scattering::Matte { .. } => None,
                Scattering::Rough(surface) => {
                    let (diffuse, glossy, alpha) = surface.lobes(wo());
                    Some(BsdfLobes { diffuse, glossy, alpha, wo: -dir })
                }
            };
            let normal = points.normal.get(index);
            let lit_side = if points.back >> index & 1 == 1 { -normal } else { normal };
            self.light_context = tracer.scene.lights.point_context(points.position.get(index), lit_side, lobes);
            self.sample_lamp(index, vertices);
        }
        None
    }

    /// Adds the emission of the surface that the path has reached.
    #[inline(never)]
    fn add_emission(&self, index: usize, paths: &mut PathLanes, points: &PointLanes) {
        let (ray, (_, point)) = (paths.rays().ray(index), points.point(index));
        let emission = self.tracer.emitter_hit(&ray, &point, &self.previous(index, paths));
        paths.color.set(index, paths.color.get(index) + paths.throughput.get(index) * emission);
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

    /// Scatters the path at the surface that it has reached by its own tracer.
    #[inline(never)]
    fn scatter(&mut self, index: usize, paths: &mut PathLanes, points: &PointLanes) -> ControlFlow<Termination> {
        self.load(index, paths);
        let Self { tracer, path, out, .. } = self;
        let flow = tracer.continue_at::<false, false>(path, points.point(index), out);
        self.store(index, paths);
        flow
    }

    /// Continues the path after a vertex that its own tracer has scattered, or ends it.
    #[inline(always)]
    fn advance(
        &mut self,
        flow: ControlFlow<Termination>,
        index: usize,
        paths: &mut PathLanes,
        branches: &Branches,
        samples: &mut impl SampleQueue,
    ) {
        if flow.is_break() {
            self.finish(index, paths, branches, samples);
        }
    }

    /// Continues with a branch of the sample: `Tracer::end_path`. Returns false if there is none.
    #[inline(always)]
    fn resume(&mut self, index: usize, paths: &mut PathLanes, branches: &Branches) -> bool {
        if self.waiting == 0 && self.tracer.pending.is_empty() {
            return false;
        }
        if let Some(branch) = self.tracer.pending.pop() {
            self.path = branch;
            if let SegmentOrigin::Surface { light_context, .. } = branch.previous.origin {
                self.tracer.scene.lights.weigh(&light_context, &mut self.tracer.surface_weights);
            }
            self.out.color = paths.color.get(index);
            self.store(index, paths);
            return true;
        }
        // The branch that began to wait last.
        let branch = self.waiting.ilog2();
        self.waiting &= !(1 << branch);
        paths.copy_lane(index, branches.paths(branch));
        self.light_context = self.first.light_context;
        self.tracer.scene.lights.weigh(&self.light_context, &mut self.tracer.surface_weights);
        (self.path.bounce, self.path.rays) = (1, 1);
        self.path.stream = self.first.stream.branch(branch_number(1, branch));
        true
    }

    /// Ends the path, and its sample if no branch waits.
    #[inline(always)]
    fn finish(&mut self, index: usize, paths: &mut PathLanes, branches: &Branches, samples: &mut impl SampleQueue) {
        // The film must count a path with an invalid throughput as a bad sample.
        if !paths.throughput.get(index).is_finite() {
            paths.color.set(index, Rgb::NAN);
        }
        if self.resume(index, paths, branches) {
            return;
        }
        let Some(number) = self.sample.take() else { return };
        self.out.color = paths.color.get(index) + self.camera_light;
        samples.finish(number, self.out);
    }
}

#[cfg(test)]
mod tests;
