//! Tracer: camera samples, and the loop over the rays of a path.

use crate::camera_next_event::{CAMERA_NEXT_EVENTS, CameraSample};
use crate::dimensions as dim;
use crate::first_branches::MAX_FIRST_BRANCHES;
use crate::fog::FoggyRay;
use crate::path_state::{PathState, SegmentOrigin};
use crate::record::{BranchEvent, Contribution, Decision, LightTechnique, PathEnd, RecordLevel, Recorder, Termination};
use crate::roulette::RouletteRule;
use crate::shadow::ShadowTester;
use crate::surface::SurfaceInteraction;
use crate::technique::MisTechnique;
use crate::window::{WeightWindow, WindowDecision, frame_light};
use femc_emission::LightWeights;
use femc_field::{Field, TargetGuide};
use femc_geometry::Hit;
use femc_math::{Rgb, SampleStream};
use femc_prepared::compile::NONE;
use femc_prepared::{Crossing, Prepared, ShadingPoint};
use std::ops::ControlFlow;

/// Settings of paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathSettings {
    /// Key of the random streams.
    pub seed: u64,
    /// Maximum path length in segments (1: directly visible light only); 0: unlimited.
    pub max_depth: u32,
    /// Only technique to use where there are several, for tests. `None`: all techniques, combined.
    pub single_technique: Option<MisTechnique>,
}

impl PathSettings {
    /// Checks whether a segment is the last of its path: nothing may scatter at its end.
    #[inline(always)]
    pub(crate) fn is_last(&self, bounce: u32) -> bool {
        self.max_depth != 0 && bounce + 1 >= self.max_depth
    }
}

/// Work done by a tracer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TracerCounters {
    /// Number of closest-hit rays.
    pub rays: u64,
    /// Number of shadow rays.
    pub shadow_rays: u64,
    /// Number of path segments.
    pub segments: u64,
    /// Number of vertices at which a guide samples a share of the directions.
    pub guided: u64,
}

impl std::iter::Sum for TracerCounters {
    fn sum<I: Iterator<Item = Self>>(counters: I) -> Self {
        counters.fold(Self::default(), |sum, counters| Self {
            rays: sum.rays + counters.rays,
            shadow_rays: sum.shadow_rays + counters.shadow_rays,
            segments: sum.segments + counters.segments,
            guided: sum.guided + counters.guided,
        })
    }
}

/// The result of one camera sample.
#[derive(Clone, Copy, Debug)]
pub struct PathSample {
    /// Radiance, cd/m2. It is not checked; the film rejects values that are not finite.
    pub color: Rgb,
    /// Reflectance at the first surface.
    pub albedo: Rgb,
    /// Distance of the first surface along the view axis, m; infinite if there is none.
    pub depth: f32,
}

impl PathSample {
    /// A path that has found no light and no surface.
    pub(crate) const NOTHING: Self = Self { color: Rgb::ZERO, albedo: Rgb::ZERO, depth: f32::INFINITY };
}

/// Distribution of the samples of a pixel on the film.
pub trait PixelFilter: Copy {
    /// Returns the offset from the pixel's center, pixels, for `u` in [0, 1)^2.
    fn sample(self, u: [f32; 2]) -> [f32; 2];
    /// Returns the density of [`Self::sample`], 1/pixel2.
    fn density(self, offset: [f32; 2]) -> f32;
}

/// Guidance of paths by a field: directions toward its light, and a weight window by its values.
#[derive(Clone, Copy, Debug)]
pub struct Guidance<'a> {
    /// Field of the first pass.
    pub field: &'a Field,
    /// Targets of the frame's directions.
    pub targets: Option<&'a TargetGuide>,
    /// Whether targets and tables sample a share of the directions.
    pub samples_directions: bool,
    /// Weight window.
    pub window: WeightWindow,
    /// Mean light that the field expects at the first surfaces of the frame, cd/m2.
    pub frame_light: f32,
}

impl<'a> Guidance<'a> {
    /// Creates the guidance of a frame's paths by `field`. The mean light of the frame's own field is computed once. The targets of
    /// the frame belong to its own field.
    pub fn new(scene: &'a Prepared, field: &'a Field) -> Self {
        let is_own = scene.field().is_some_and(|own| std::ptr::eq(own, field));
        let targets = if is_own { scene.targets() } else { None };
        let frame_light = match is_own {
            true => *scene.field_light.get_or_init(|| frame_light(scene, field, targets)),
            false => frame_light(scene, field, None),
        };
        // The method of 1998 has no window.
        let window = if field.tables.is_empty() { WeightWindow::default() } else { WeightWindow::OPEN };
        Self { field, targets, samples_directions: true, window, frame_light }
    }

    /// Replaces the targets.
    pub fn with_targets(self, scene: &Prepared, targets: &'a TargetGuide) -> Self {
        let targets = Some(targets);
        Self { targets, frame_light: frame_light(scene, self.field, targets), ..self }
    }

    /// Decides by the window on a path at its latest vertex.
    /// - `radiance`: radiance that the vertex scatters toward the previous vertex by the field, cd/m2.
    #[inline(always)]
    pub(crate) fn decide(&self, path: &mut PathState, radiance: Rgb) -> WindowDecision {
        self.window.decide(path, radiance, self.frame_light)
    }
}

/// Position in the middle of the lens.
const LENS_CENTER: [f32; 2] = [0.5; 2];

/// Time in the middle of the shutter.
pub(crate) const SHUTTER_CENTER: f32 = 0.5;

/// Tracer of the samples of one frame on one thread.
/// - `R`: recorder of the paths; `()` records nothing.
pub struct Tracer<'a, R = ()> {
    pub(crate) scene: &'a Prepared,
    pub(crate) settings: PathSettings,
    /// Media of the current segment, and of the segment before the latest vertex.
    pub(crate) fog: FoggyRay,
    pub(crate) fog_before: FoggyRay,
    /// Media of the segment that ended at the first vertex, if the path was split there.
    pub(crate) first_fog: FoggyRay,
    /// Weights of the lights for the latest surface, and for directions from a point in fog.
    pub(crate) surface_weights: LightWeights,
    pub(crate) direction_weights: LightWeights,
    pub(crate) shadow: ShadowTester,
    /// Source of all light except that of emitters, in place of longer paths.
    pub(crate) field: Option<&'a Field>,
    /// Guidance of the paths by a field.
    pub(crate) guidance: Option<Guidance<'a>>,
    /// Number of branches into which an unguided path is split at its first vertex.
    pub(crate) first_branches: u32,
    /// Branches of the current sample that wait to be traced, and the number of all its branches.
    pub(crate) pending: Vec<PathState>,
    pub(crate) branches: u32,
    /// Work done so far.
    pub counters: TracerCounters,
    /// Recorder of the paths.
    pub recorder: R,
}

impl<'a> Tracer<'a> {
    /// Creates a tracer of `scene`.
    pub fn new(scene: &'a Prepared, settings: PathSettings) -> Self {
        Self::with_recorder(scene, settings, ())
    }
}

impl<'a, R: Recorder> Tracer<'a, R> {
    /// Creates a tracer of `scene` that reports its paths to `recorder`. The samples are identical to the bit to those without a
    /// recorder.
    pub fn with_recorder(scene: &'a Prepared, settings: PathSettings, recorder: R) -> Self {
        Self {
            scene,
            settings,
            fog: FoggyRay::default(),
            fog_before: FoggyRay::default(),
            first_fog: FoggyRay::default(),
            surface_weights: LightWeights::default(),
            direction_weights: LightWeights::default(),
            shadow: ShadowTester::default(),
            field: None,
            guidance: None,
            first_branches: 1,
            pending: Vec::new(),
            branches: 1,
            counters: TracerCounters::default(),
            recorder,
        }
    }

    /// Ends paths with the light of a field where they are scattered diffusely, or in fog. Paths continue only from mirrors, glossy
    /// and clear surfaces. The samples then have the errors of the field.
    pub fn with_field(mut self, field: &'a Field) -> Self {
        self.field = Some(field);
        // Light of sources must be sampled: where the path ends, nothing else could find it.
        self.settings.single_technique = Some(MisTechnique::Light);
        self
    }

    /// Guides paths with a field. The mean of the samples is unchanged for any field.
    pub fn with_guidance(mut self, guidance: Guidance<'a>) -> Self {
        self.guidance = Some(guidance);
        self
    }

    /// Splits unguided paths into several branches, at most 8, at their first vertex that is not only a mirror or glass. The mean of
    /// the samples is unchanged. The branches share the camera ray and the light of the lamps at the vertex.
    pub fn with_first_branches(mut self, branches: u32) -> Self {
        self.first_branches = branches.clamp(1, MAX_FIRST_BRANCHES);
        self
    }

    /// Computes sample `sample` of `pixel` (row-major index in the whole film).
    #[inline(always)]
    pub fn sample(&mut self, pixel: u32, sample: u32, filter: impl PixelFilter) -> PathSample {
        let record_level = self.recorder.begin_sample(pixel, sample);
        let (path, camera_light) = self.begin_path(pixel, sample, filter, record_level);
        // Recorders that only receive the end do not slow the path down.
        let mut out = match (self.scene.media.is_empty(), record_level) {
            (true, RecordLevel::End) => self.trace::<false, false>(path),
            (false, RecordLevel::End) => self.trace::<true, false>(path),
            (true, RecordLevel::All) => self.trace::<false, true>(path),
            (false, RecordLevel::All) => self.trace::<true, true>(path),
        };
        out.color += camera_light;
        out
    }

    /// Creates the path of a sample. Returns it with the light of small emitters that the camera sees, cd/m2.
    #[inline(always)]
    pub(crate) fn begin_path(
        &mut self,
        pixel: u32,
        sample: u32,
        filter: impl PixelFilter,
        record_level: RecordLevel,
    ) -> (PathState, Rgb) {
        let mut stream = SampleStream::new(self.settings.seed, self.scene.frame, pixel, sample);
        // A constant for recorders of only the ends of paths.
        let records_all = record_level == RecordLevel::All;
        if records_all {
            self.recorder.decide(Decision::Camera, 0, &mut stream);
        }
        stream.seek(dim::FILM);
        let offset = filter.sample(stream.next_2d());
        stream.seek(dim::LENS);
        let lens = if self.scene.camera.has_lens() { stream.next_2d() } else { LENS_CENTER };
        stream.seek(dim::TIME);
        let moves = self.scene.camera.moves() || self.scene.world.moves();
        let time = if moves { stream.next_1d() } else { SHUTTER_CENTER };
        let view = self.scene.camera.view(lens, time);
        let center = self.scene.camera.center(pixel);
        let film_position = [center[0] + offset[0], center[1] + offset[1]];
        let ray = view.ray(film_position);
        if R::WANTS_CAMERA_RAYS {
            self.recorder.camera_ray(&view, lens, &ray);
        }
        let mut origin = SegmentOrigin::Delta;
        let mut camera_light = Rgb::ZERO;
        if let Some(emitters) = self.scene.camera_emitters.get(pixel) {
            origin = SegmentOrigin::Camera {
                pixel,
                film_position,
                film_pdf: filter.density(offset),
                solid_angle: view.solid_angle(film_position),
            };
            if records_all {
                self.recorder.decide(Decision::CameraEmitter, 0, &mut stream);
            }
            stream.seek(dim::CAMERA_EMITTER);
            let choice = stream.next_1d();
            stream.seek(dim::CAMERA_EMITTER_POINT);
            let point = stream.next_2d();
            let from = CameraSample { emitters, view: &view, time, center, filter, record_level };
            for part in 0..CAMERA_NEXT_EVENTS {
                let number = (choice + part as f32 / CAMERA_NEXT_EVENTS as f32).fract();
                // One quarter of the square for each point.
                let point = [0, 1].map(|axis| 0.5 * (point[axis] + (part >> axis & 1) as f32));
                camera_light += self.sample_camera_emitter(&from, number, point);
            }
        }
        self.branches = 1;
        (PathState::new(ray, origin, self.scene.camera_medium_stack, stream), camera_light)
    }

    /// Traces a path and all its branches to their ends.
    /// - `MEDIA`: whether the scene has media;
    /// - `RECORD_ALL`: whether the recorder receives all events of this sample ([`RecordLevel::All`]).
    pub(crate) fn trace<const MEDIA: bool, const RECORD_ALL: bool>(&mut self, mut path: PathState) -> PathSample {
        let mut out = PathSample::NOTHING;
        loop {
            if let ControlFlow::Break(termination) = self.trace_ray::<MEDIA, RECORD_ALL>(&mut path, &mut out)
                && self.end_path::<RECORD_ALL>(&mut path, termination, &mut out).is_break()
            {
                return out;
            }
        }
    }

    /// Ends a path, and continues with a branch of its sample. `Break`: there is none.
    #[inline(always)]
    pub(crate) fn end_path<const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        termination: Termination,
        out: &mut PathSample,
    ) -> ControlFlow<()> {
        self.recorder.terminate(termination);
        // A path with an invalid throughput that found no light afterwards would look dark. The film must count it as a bad sample.
        if !path.throughput.is_finite() {
            out.color = Rgb::NAN;
        }
        let Some(branch) = self.pending.pop() else { return ControlFlow::Break(()) };
        *path = branch;
        record!(self.recorder.branch(BranchEvent::Resume));
        // Light that the branch hits with its next ray is weighted against the lights at its latest vertex.
        match &path.previous.origin {
            SegmentOrigin::Surface { light_context, .. } => {
                self.scene.lights.weigh(light_context, &mut self.surface_weights);
            }
            SegmentOrigin::Medium { .. } => self.fog_before.clone_from(&self.first_fog),
            SegmentOrigin::Delta | SegmentOrigin::Camera { .. } => {}
        }
        ControlFlow::Continue(())
    }

    /// Traces the next ray of a path to a collision or a surface, and scatters it there.
    #[inline(always)]
    fn trace_ray<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        out: &mut PathSample,
    ) -> ControlFlow<Termination> {
        let hit = self.find_hit(path);
        match self.reach::<MEDIA, RECORD_ALL>(path, hit, out) {
            ControlFlow::Continue(at) => self.continue_at::<MEDIA, RECORD_ALL>(path, at, out),
            ControlFlow::Break(flow) => flow,
        }
    }

    /// Scatters a path at a surface that it has reached.
    #[inline(always)]
    pub(crate) fn continue_at<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        at: (Hit, ShadingPoint),
        out: &mut PathSample,
    ) -> ControlFlow<Termination> {
        match self.arrive::<MEDIA, RECORD_ALL>(path, at, out) {
            ControlFlow::Continue(surface) => self.scatter_at_surface::<MEDIA, RECORD_ALL>(path, surface, out),
            ControlFlow::Break(flow) => flow,
        }
    }

    /// Traces the next ray of a path to the closest surface.
    #[inline(always)]
    pub(crate) fn find_hit(&mut self, path: &mut PathState) -> Option<Hit> {
        path.begin_ray();
        self.counters.rays += 1;
        self.counters.segments += 1;
        self.scene.world.intersect(&path.ray)
    }

    /// Brings a path to the end of its ray: scatters it in a medium before that, or adds the emission of the surface there. `Break`:
    /// the path does not reach a surface.
    #[inline(always)]
    pub(crate) fn reach<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        hit: Option<Hit>,
        out: &mut PathSample,
    ) -> ControlFlow<ControlFlow<Termination>, (Hit, ShadingPoint)> {
        let scene = self.scene;
        if MEDIA {
            let t_hit = hit.as_ref().map_or(f32::INFINITY, |hit| hit.t);
            if let Some(collision) = self.cross_media::<RECORD_ALL>(path, t_hit, out) {
                return ControlFlow::Break(self.scatter_in_medium::<RECORD_ALL>(path, &collision, out));
            }
        }
        let Some(hit) = hit else { return ControlFlow::Break(ControlFlow::Break(path.end(PathEnd::Escaped))) };
        let point = scene.shading_point(&path.ray, &hit);
        if point.light != NONE {
            let color = path.throughput * self.emitter_hit(&path.ray, &point, &path.previous);
            out.color += color;
            record!(self.recorder.contribution(|| Contribution {
                color,
                throughput: path.throughput,
                bounce: path.bounce,
                technique: LightTechnique::EmitterHit,
                medium: None,
                light: Some(point.light),
                position: point.position,
            }));
        }
        ControlFlow::Continue((hit, point))
    }

    /// Brings a path to a surface. `Break`: it goes straight through the surface, or ends there.
    #[inline(always)]
    pub(crate) fn arrive<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        (hit, point): (Hit, ShadingPoint),
        out: &mut PathSample,
    ) -> ControlFlow<ControlFlow<Termination>, SurfaceInteraction<'a>> {
        let scene = self.scene;
        let surface = SurfaceInteraction::new(scene, &path.ray, hit, point);
        let is_null = matches!(surface.crossing, Crossing::Null { .. });
        if path.awaits_first_surface && !is_null {
            path.awaits_first_surface = false;
            out.depth = scene.camera.depth(surface.point.position, path.ray.time);
            out.albedo = path.throughput * surface.bsdf.albedo(surface.wo);
        }
        let is_last = self.settings.is_last(path.bounce);
        if is_last || is_null {
            let before = path.throughput;
            path.throughput *= surface.crossing.straight_through();
            path.continue_straight(&surface);
            record!(self.recorder.decide(Decision::Roulette, path.bounce, &mut path.stream));
            let flow = path.roulette::<MEDIA>(RouletteRule::ByWeight).map_break(|termination| Termination {
                end: if is_last { PathEnd::Depth } else { termination.end },
                throughput: before,
                ..termination
            });
            return ControlFlow::Break(flow);
        }
        ControlFlow::Continue(surface)
    }
}
