//! Path loop.

use crate::dimensions as dim;
use crate::fog::{Collision, FogSampler, FoggyRay, Segment, SingleScatterSample};
use crate::guided::{DirectionSampler, GuidedSample};
use crate::record::{
    Continuation, Contribution, LightTechnique, LobeSplit, RecordLevel, Recorder, Scatterer, Termination, Vertex,
    VertexLocation,
};
use crate::shadow::ShadowTester;
use crate::technique::{MisTechnique, mis_weight};
use femc_emission::{BsdfLobes, DeltaKind, LightWeights, PointContext};
use femc_field::{Field, Side};
use femc_geometry::{Ray, offset_origin, shadow_segment};
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_math::{Frame, Rgb, SampleStream};
use femc_prepared::camera::View;
use femc_prepared::camera_emitters::PixelEmitters;
use femc_prepared::compile::NONE;
use femc_prepared::media::MediumStack;
use femc_prepared::{Crossing, KernelMaterial, Orientation, Prepared, ShadingPoint};
use femc_scattering::{Bsdf, LobeKind, Transmitted};
use std::f32::consts::FRAC_1_PI;

/// Number of rays after which Russian roulette may end a path.
const RR_MIN_RAYS: u32 = 4;
/// Threshold of Russian roulette in a scene without media. A path survives with certainty while its weight is at least this. A
/// threshold of 1 would end paths earlier: on Cornell boxes that costs a quarter more variance and saves 15 % of the work.
const RR_THRESHOLD: f32 = 0.25;
/// Threshold of Russian roulette in a scene with media. There, later vertices of a path cost more (each also has a segment of fog)
/// and contribute less.
const RR_THRESHOLD_IN_MEDIA: f32 = 0.8;
/// Minimum survival probability by the field's expectation, relative to the probability by the weight alone.
const RR_MIN_SURVIVAL: f32 = 0.5;
/// Number of rays after which a path may end even without loss of throughput.
const LONG_PATH: u32 = 128;
/// Number of rays after which a long path ends with a higher probability.
const VERY_LONG_PATH: u32 = 1 << 16;

/// Number of points that a sample draws on the small emitters visible in its pixel. Such pixels are few, and partly occluded lamps
/// would make them the noisiest of all.
const CAMERA_NEXT_EVENTS: u32 = 4;

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

/// Distribution of the samples of a pixel on the film.
pub trait PixelFilter: Copy {
    /// Returns the offset from the pixel's center, pixels, for `u` in [0, 1)^2.
    fn sample(self, u: [f32; 2]) -> [f32; 2];
    /// Returns the density of [`Self::sample`], 1/pixel2.
    fn density(self, offset: [f32; 2]) -> f32;
}

/// The vertex before the current segment, for multiple importance sampling of light that the path hits.
#[derive(Clone, Copy)]
struct PreviousVertex {
    position: Vec3A,
    origin: SegmentOrigin,
}

/// Origin of a segment.
#[derive(Clone, Copy)]
enum SegmentOrigin {
    /// Delta origin: a mirror, or the camera if it sees no small emitters.
    Delta,
    /// Camera. Its visible small emitters are sampled, too.
    Camera {
        /// Index of the pixel.
        pixel: u32,
        /// Position on the film, pixels.
        film_position: [f32; 2],
        /// Density of the position on the film, 1/pixel2.
        film_pdf: f32,
        /// Solid angle of a pixel there, sr.
        solid_angle: f32,
    },
    /// Surface.
    Surface {
        /// Context for which the lights were weighed.
        light_context: PointContext,
        /// Density of the direction, 1/sr.
        pdf: f32,
    },
    /// Medium.
    Medium {
        collision: Collision,
        /// Density of the direction by the phase function alone, 1/sr.
        phase_pdf: f32,
    },
}

/// Calls the recorder with an event of the path, if the recorder receives all events of this sample ([`RecordLevel::All`]).
macro_rules! record {
    ($tracer:ident.$event:ident($($arguments:tt)*)) => {
        if RECORD_ALL {
            $tracer.recorder.$event($($arguments)*);
        }
    };
}

/// Tracer of the samples of one frame on one thread.
/// - `R`: recorder of the paths; `()` records nothing.
pub struct Tracer<'a, R = ()> {
    scene: &'a Prepared,
    settings: PathSettings,
    /// Media of the current segment, and of the segment before the latest vertex.
    fog: FoggyRay,
    fog_before: FoggyRay,
    /// Weights of the lights for the latest surface, and for directions from a point in fog.
    surface_weights: LightWeights,
    direction_weights: LightWeights,
    shadow: ShadowTester,
    /// Source of all light except that of emitters, in place of longer paths.
    field: Option<&'a Field>,
    /// Field that guides directions, in addition to the BSDF.
    guide: Option<&'a Field>,
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
            surface_weights: LightWeights::default(),
            direction_weights: LightWeights::default(),
            shadow: ShadowTester::default(),
            field: None,
            guide: None,
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

    /// Samples directions at surfaces also from the guide of a field. The mean of the samples is unchanged for any field.
    pub fn with_guide(mut self, field: &'a Field) -> Self {
        self.guide = Some(field);
        self
    }

    /// Computes sample `sample` of `pixel` (row-major index in the whole film).
    #[inline(always)]
    pub fn sample(&mut self, pixel: u32, sample: u32, filter: impl PixelFilter) -> PathSample {
        let record_level = self.recorder.begin_sample(pixel, sample);
        let mut stream = SampleStream::new(self.settings.seed, self.scene.frame, pixel, sample);
        stream.seek(dim::FILM);
        let offset = filter.sample(stream.next_2d());
        stream.seek(dim::LENS);
        let lens = stream.next_2d();
        stream.seek(dim::TIME);
        let time = stream.next_1d();
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
            stream.seek(dim::CAMERA_EMITTER);
            let choice = stream.next_1d();
            stream.seek(dim::CAMERA_EMITTER_POINT);
            let point = stream.next_2d();
            for part in 0..CAMERA_NEXT_EVENTS {
                let number = (choice + part as f32 / CAMERA_NEXT_EVENTS as f32).fract();
                // One quarter of the square for each point.
                let point = [0, 1].map(|axis| 0.5 * (point[axis] + (part >> axis & 1) as f32));
                camera_light +=
                    self.sample_camera_emitter(emitters, &view, time, center, filter, number, point, record_level);
            }
        }
        // Recorders that only receive the end do not slow the path down.
        let mut out = match (self.scene.media.is_empty(), record_level) {
            (true, RecordLevel::End) => self.trace::<false, false>(ray, origin, stream),
            (false, RecordLevel::End) => self.trace::<true, false>(ray, origin, stream),
            (true, RecordLevel::All) => self.trace::<false, true>(ray, origin, stream),
            (false, RecordLevel::All) => self.trace::<true, true>(ray, origin, stream),
        };
        out.color += camera_light;
        out
    }

    /// Samples light that travels straight from a small emitter to the camera, with one of [`CAMERA_NEXT_EVENTS`] points.
    /// - `number`: chooses the emitter, `u` the point; in [0, 1).
    fn sample_camera_emitter(
        &mut self,
        emitters: PixelEmitters<'_>,
        view: &View,
        time: f32,
        center: [f32; 2],
        filter: impl PixelFilter,
        number: f32,
        u: [f32; 2],
        record_level: RecordLevel,
    ) -> Rgb {
        let scene = self.scene;
        let choice = emitters.choose(number, center);
        // Point, its position on the film, and the density of that, 1/pixel2.
        let drawn = match &choice.part {
            Some(part) => part.sample(u).and_then(|film_position| {
                let dir = view.ray(film_position).dir;
                let point = scene.lights.sample_toward(&scene.textures, choice.light, view.origin, dir)?;
                Some((point, film_position, 1.0 / part.area()))
            }),
            None => scene
                .lights
                .sample_light(&scene.world, &scene.textures, choice.light, view.origin, time, u)
                .and_then(|point| {
                    let (film_position, _) = view.project(point.position)?;
                    Some((point, film_position, point.pdf * view.solid_angle(film_position)))
                }),
        };
        let Some((point, film_position, pdf)) = drawn else { return Rgb::ZERO };
        let density = filter.density([film_position[0] - center[0], film_position[1] - center[1]]);
        if density <= 0.0 || point.radiance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let pdf = CAMERA_NEXT_EVENTS as f32 * choice.probability * pdf;
        let weight = mis_weight(self.settings.single_technique, MisTechnique::Light, square(density / pdf));
        let from = (view.origin, Vec3A::ZERO, Vec3A::ZERO);
        let counters = &mut self.counters;
        let visibility = if scene.media.is_empty() {
            self.shadow.visibility::<false>(scene, from, &point, time, &scene.camera_medium_stack, counters)
        } else {
            self.shadow.visibility::<true>(scene, from, &point, time, &scene.camera_medium_stack, counters)
        };
        let color = point.radiance * visibility * (weight * density / pdf);
        if record_level == RecordLevel::All {
            self.recorder.contribution(|| Contribution {
                color,
                throughput: Rgb::ONE,
                bounce: 0,
                technique: LightTechnique::CameraNextEvent,
                light: Some(choice.light),
                position: point.position,
            });
        }
        color
    }

    fn trace<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        mut ray: Ray,
        origin: SegmentOrigin,
        mut stream: SampleStream,
    ) -> PathSample {
        let scene = self.scene;
        let mut out = PathSample { color: Rgb::ZERO, albedo: Rgb::ZERO, depth: f32::INFINITY };
        let mut throughput = Rgb::ONE;
        let mut medium_stack = scene.camera_medium_stack;
        let mut previous = PreviousVertex { position: ray.origin, origin };
        // Factors of the throughput that Russian roulette must ignore: squares of index ratios, and ratios of densities from the
        // mixtures that replaced the BSDF or the phase function. If only the latest ratio counts, the reference roundabout has 8 %
        // more variance.
        let mut scale = 1.0f32;
        // Light that the field expects of the path at the first vertex for which the field has data.
        let mut expected_light = 0.0f32;
        let mut first = true;
        // Current segment of the path, and its number of rays. A segment that goes through clear surfaces has several rays.
        let (mut segment, mut rays, mut vertices) = (0u32, 0u32, 0u32);
        loop {
            let base = dim::ray_base(rays);
            rays += 1;
            self.counters.rays += 1;
            self.counters.segments += 1;
            let hit = scene.world.intersect(&ray);
            let t_hit = hit.as_ref().map_or(f32::INFINITY, |h| h.t);

            if MEDIA && scene.media.find_intervals(ray.origin, ray.dir, t_hit, &medium_stack, &mut self.fog.media) {
                let may_scatter = self.settings.max_depth == 0 || segment + 1 < self.settings.max_depth;
                let mut fog = FogSampler {
                    scene,
                    ray: &mut self.fog,
                    direction_weights: &mut self.direction_weights,
                    shadow: &mut self.shadow,
                    counters: &mut self.counters,
                    single_technique: self.settings.single_technique,
                };
                let (origin, dir, time) = (ray.origin, ray.dir, ray.time);
                let fog_segment = Segment { origin, dir, time, medium_stack: &medium_stack, bounce: segment, base };
                let color = throughput * fog.glow(&fog_segment, &mut stream);
                out.color += color;
                if color != Rgb::ZERO {
                    record!(self.contribution(|| Contribution {
                        color,
                        throughput,
                        bounce: segment,
                        technique: LightTechnique::Glow(fog.emitting_medium()),
                        light: None,
                        position: ray.origin,
                    }));
                }
                if may_scatter {
                    fog.weigh_lights(&fog_segment);
                    if let Some(scattered) = fog.sample_airlight(&fog_segment, &mut stream) {
                        if RECORD_ALL
                            && R::WANTS_OCCLUDERS
                            && scattered.color == Rgb::ZERO
                            && let Some(shadow) = airlight_shadow_ray(scene, &fog_segment, &scattered, &mut stream)
                        {
                            record!(self.occluded(|| shadow));
                        }
                        let color = throughput * scattered.color;
                        out.color += color;
                        if R::WANTS_ZERO_LIGHT || color != Rgb::ZERO {
                            record!(self.contribution(|| Contribution {
                                color,
                                throughput,
                                bounce: segment,
                                technique: LightTechnique::Airlight(fog.dominant_medium(&scattered.event)),
                                light: Some(scattered.light),
                                position: ray.origin + ray.dir * scattered.event.t,
                            }));
                        }
                    }
                }
                match fog.sample_collision(&fog_segment, &mut stream) {
                    Ok(collision) => {
                        first = false;
                        if !may_scatter {
                            self.recorder.terminate(vertices, Termination::Depth, throughput);
                            break;
                        }
                        throughput *= collision.event.weight;
                        let position = collision.position;
                        vertices += 1;
                        record!(self.vertex(|| Vertex {
                            location: VertexLocation::Medium(fog.dominant_medium(&collision.event)),
                            position,
                            bounce: segment,
                            throughput,
                        }));
                        if let Some(field) = self.field {
                            let color = throughput * field.fog.mean_radiance(position);
                            out.color += color;
                            record!(self.contribution(|| field_contribution(color, throughput, segment, position)));
                            self.recorder.terminate(vertices, Termination::Field, throughput);
                            break;
                        }
                        let Some(new) = fog.sample_direction(&fog_segment, &collision, &mut stream) else {
                            self.recorder.terminate(vertices, Termination::Absorbed, throughput);
                            break;
                        };
                        record!(self.leave(Continuation::Scattered {
                            pdf: new.pdf,
                            scatterer: Scatterer::Phase,
                            is_guide_sample: false
                        }));
                        throughput *= new.weight;
                        std::mem::swap(&mut self.fog, &mut self.fog_before);
                        previous = PreviousVertex {
                            position,
                            origin: SegmentOrigin::Medium { collision, phase_pdf: new.phase_pdf },
                        };
                        ray = Ray { origin: position, dir: new.dir, t_max: f32::INFINITY, time: ray.time };
                        segment += 1;
                        scale *= new.pdf / new.phase_pdf;
                        if !survives::<MEDIA>(rays, &mut throughput, scale, None, &mut stream, base) {
                            self.recorder.terminate(vertices, Termination::from_throughput(throughput), throughput);
                            break;
                        }
                        continue;
                    }
                    Err(weight) => throughput *= weight,
                }
            }
            let Some(hit) = hit else {
                self.recorder.terminate(vertices, Termination::Escaped, throughput);
                break;
            };
            let point = scene.shading_point(&ray, &hit);
            if point.light != NONE {
                let color = throughput * self.emitter_hit(&ray, &point, &previous);
                out.color += color;
                record!(self.contribution(|| Contribution {
                    color,
                    throughput,
                    bounce: segment,
                    technique: LightTechnique::EmitterHit,
                    light: Some(point.light),
                    position: point.position,
                }));
            }
            let material = &scene.materials[point.material as usize];
            let back = point.normal.dot(ray.dir) > 0.0;
            let crossing = material.crossing[usize::from(back)];
            let bsdf = bsdf_at(scene, material, &point);
            let (frame, wo) = local_wo(material, &point, ray.dir);
            if first && !matches!(crossing, Crossing::Null { .. }) {
                first = false;
                out.depth = scene.camera.depth(point.position, ray.time);
                out.albedo = throughput * bsdf.albedo(wo);
            }
            let is_last = self.settings.max_depth != 0 && segment + 1 >= self.settings.max_depth;
            if is_last || matches!(crossing, Crossing::Null { .. }) {
                let before = throughput;
                throughput *= crossing.straight_through();
                ray = continue_straight(&ray, &point, &mut medium_stack, material, back);
                if !survives::<MEDIA>(rays, &mut throughput, scale, None, &mut stream, base) {
                    self.recorder.terminate(
                        vertices,
                        if is_last { Termination::Depth } else { Termination::from_throughput(throughput) },
                        before,
                    );
                    break;
                }
                continue;
            }
            vertices += 1;
            record!(self.vertex(|| Vertex {
                location: VertexLocation::Surface {
                    instance: hit.instance,
                    primitive: hit.primitive,
                    material: point.material
                },
                position: point.position,
                bounce: segment,
                throughput,
            }));
            let mut scattering = DirectionSampler::new(&bsdf, &frame, wo);
            if let Some(field) = self.guide {
                scattering = scattering.with_guide(field, (&hit, &point, back));
                self.counters.guided += u64::from(scattering.is_guided());
            }
            let ahead = luminance(throughput * scattering.light_ahead);
            let is_known = ahead > 0.0 && ahead.is_finite();
            if expected_light == 0.0 && is_known {
                expected_light = ahead;
            }
            let survival = is_known.then(|| ahead / expected_light);
            let light_context =
                scene.lights.point_context(point.position, lit_side(&bsdf, &point, back), lobes(&bsdf, wo, ray.dir));
            if !bsdf.is_delta_only() && !scene.lights.is_empty() {
                scene.lights.weigh(&light_context, &mut self.surface_weights);
                stream.seek(base + dim::LIGHT);
                let number = dim::uniform_48(stream.next_2d());
                if let Some(chosen) = scene.lights.choose(&self.surface_weights, &light_context, number) {
                    let color = throughput
                        * self.sample_next_event::<MEDIA, RECORD_ALL>(
                            chosen,
                            (&bsdf, &scattering),
                            &frame,
                            wo,
                            &point,
                            back,
                            ray.time,
                            &medium_stack,
                            base,
                            &mut stream,
                        );
                    out.color += color;
                    if R::WANTS_ZERO_LIGHT || color != Rgb::ZERO {
                        record!(self.contribution(|| Contribution {
                            color,
                            throughput,
                            bounce: segment,
                            technique: LightTechnique::NextEvent,
                            light: Some(chosen.0),
                            position: point.position,
                        }));
                    }
                }
            }
            let rest;
            let scattering = match self.field {
                None => scattering,
                Some(field) => {
                    let (reflected, transmitted) = bsdf.lambertian(wo);
                    let (here, behind) = if back { (Side::Back, Side::Front) } else { (Side::Front, Side::Back) };
                    let facing = if back { -point.shading_normal } else { point.shading_normal };
                    let light = |side, normal| field.irradiance(&hit, side, point.position, normal);
                    let mut color = reflected * light(here, facing);
                    if transmitted != Rgb::ZERO {
                        color += transmitted * light(behind, -facing);
                    }
                    let color = throughput * color * FRAC_1_PI;
                    out.color += color;
                    record!(self.contribution(|| field_contribution(color, throughput, segment, point.position)));
                    rest = bsdf.without_lambertian();
                    DirectionSampler::new(&rest, &frame, wo)
                }
            };
            stream.seek(base + dim::LOBE);
            let choice = stream.next_1d();
            stream.seek(base + dim::DIRECTION);
            let Some(GuidedSample { sample: scattered, pdf_ratio, is_guide_sample: by_guide }) =
                scattering.sample(stream.next_2d(), choice)
            else {
                self.recorder.terminate(
                    vertices,
                    if self.field.is_some() { Termination::Field } else { Termination::Absorbed },
                    throughput,
                );
                break;
            };
            throughput *= scattered.weight;
            scale *= pdf_ratio;
            if scattered.lobe == LobeKind::Delta
                && scattered.transmitted == Transmitted::Yes
                && crossing != Crossing::Scatter
            {
                record!(self.leave(Continuation::Straight));
                ray = continue_straight(&ray, &point, &mut medium_stack, material, back);
                if !survives::<MEDIA>(rays, &mut throughput, scale, None, &mut stream, base) {
                    self.recorder.terminate(vertices, Termination::from_throughput(throughput), throughput);
                    break;
                }
                continue;
            }
            let wi = frame.to_world(scattered.wi);
            if !sides_agree(&frame, &point, scattered.wi, wi) {
                self.recorder.terminate(vertices, Termination::Absorbed, throughput);
                break;
            }
            if scattered.eta != 1.0 {
                scale *= scattered.eta * scattered.eta;
            }
            let leaves_front = point.normal.dot(wi) > 0.0;
            if leaves_front == back {
                cross_boundary(&mut medium_stack, material, back);
            }
            let segment_origin = if scattered.lobe == LobeKind::Delta {
                record!(self.leave(Continuation::Delta(scattered.transmitted)));
                SegmentOrigin::Delta
            } else {
                let scatterer = if scattered.lobe == LobeKind::Glossy { Scatterer::Glossy } else { Scatterer::Diffuse };
                record!(self.lobe_split(|| LobeSplit::new(&bsdf, wo, scattered.wi)));
                record!(self.leave(Continuation::Scattered {
                    pdf: scattered.pdf,
                    scatterer,
                    is_guide_sample: by_guide
                }));
                SegmentOrigin::Surface { light_context, pdf: scattered.pdf }
            };
            previous = PreviousVertex { position: point.position, origin: segment_origin };
            let origin = offset_origin(point.position, point.error, point.normal, wi);
            ray = Ray { origin, dir: wi, t_max: f32::INFINITY, time: ray.time };
            segment += 1;
            if !survives::<MEDIA>(rays, &mut throughput, scale, survival, &mut stream, base) {
                self.recorder.terminate(vertices, Termination::from_throughput(throughput), throughput);
                break;
            }
        }
        // A path with an invalid throughput that found no light afterwards would look dark. The film must count it as a bad sample.
        if !throughput.is_finite() {
            out.color = Rgb::NAN;
        }
        out
    }

    /// Returns the emission of a surface that the path hit, weighted against the other techniques that could have found it.
    #[inline]
    fn emitter_hit(&self, ray: &Ray, point: &ShadingPoint, previous: &PreviousVertex) -> Rgb {
        let (scene, light) = (self.scene, point.light);
        let radiance = scene.lights.radiance(
            &scene.world,
            &scene.textures,
            light,
            ray.time,
            point.normal,
            -ray.dir,
            point.parametric,
        );
        if radiance == Rgb::ZERO {
            return radiance;
        }
        let at = (point.position, point.normal);
        let light_pdf = || scene.lights.pdf(&scene.world, light, previous.position, ray.time, at, ray.dir);
        let others = match &previous.origin {
            SegmentOrigin::Delta => return radiance,
            SegmentOrigin::Camera { pixel, film_position, film_pdf, solid_angle } => {
                let emitters = scene.camera_emitters.get(*pixel);
                let choice = emitters.and_then(|seen| seen.find(light, scene.camera.center(*pixel)));
                let Some(choice) = choice else { return radiance };
                let pdf = match &choice.part {
                    Some(part) if part.contains(*film_position) => 1.0 / part.area(),
                    Some(_) => return radiance,
                    None => light_pdf() * solid_angle,
                };
                square(CAMERA_NEXT_EVENTS as f32 * choice.probability * pdf / film_pdf)
            }
            SegmentOrigin::Surface { light_context, pdf } => {
                square(light_pdf() * scene.lights.probability(&self.surface_weights, light_context, light) / pdf)
            }
            SegmentOrigin::Medium { collision, phase_pdf } => {
                let distance = self.fog_before.airlight_pdf(scene, light, ray.time, &collision.event);
                square(light_pdf() * distance / (phase_pdf * collision.event.pdf))
            }
        };
        radiance * mis_weight(self.settings.single_technique, MisTechnique::Scatter, others)
    }

    /// Computes direct light on a surface by sampling a light.
    /// - `chosen`: index of the light, and the probability of choosing it.
    #[inline]
    fn sample_next_event<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        chosen: (u32, f32),
        (bsdf, scattering): (&Bsdf, &DirectionSampler<'_>),
        frame: &Frame,
        wo: Vec3A,
        point: &ShadingPoint,
        back: bool,
        time: f32,
        medium_stack: &MediumStack,
        base: u32,
        stream: &mut SampleStream,
    ) -> Rgb {
        let scene = self.scene;
        stream.seek(base + dim::LIGHT_POINT);
        let u = stream.next_2d();
        let Some(mut light) =
            scene.lights.sample_light(&scene.world, &scene.textures, chosen.0, point.position, time, u)
        else {
            return Rgb::ZERO;
        };
        light.pdf *= chosen.1;
        let light = &light;
        let wi = frame.to_local(light.dir);
        let value = bsdf.eval(wo, wi);
        if value == Rgb::ZERO || light.radiance == Rgb::ZERO || !sides_agree(frame, point, wi, light.dir) {
            return Rgb::ZERO;
        }
        let by_scattering =
            if light.delta == DeltaKind::Position { 0.0 } else { square(scattering.pdf(wi, light.dir) / light.pdf) };
        let weight = mis_weight(self.settings.single_technique, MisTechnique::Light, by_scattering);
        let contribution = value * light.radiance * (weight / light.pdf);
        let mut medium_stack = *medium_stack;
        if MEDIA && (point.normal.dot(light.dir) > 0.0) == back {
            cross_boundary(&mut medium_stack, &scene.materials[point.material as usize], back);
        }
        let from = (point.position, point.error, point.normal);
        let visibility = self.shadow.visibility::<MEDIA>(scene, from, light, time, &medium_stack, &mut self.counters);
        if visibility == Rgb::ZERO {
            record!(self.occluded(|| shadow_segment(from, (light.position, light.error, light.normal), time)));
        } else {
            record!(self.lobe_split(|| LobeSplit::new(bsdf, wo, wi)));
        }
        contribution * visibility
    }
}

/// Returns the ray from a point in fog to the point that was sampled on a lamp, for a sample without light. `None`: the lamp emits
/// nothing toward the point.
#[cold]
fn airlight_shadow_ray(
    scene: &Prepared,
    segment: &Segment<'_>,
    scattered: &SingleScatterSample,
    stream: &mut SampleStream,
) -> Option<Ray> {
    let position = segment.origin + segment.dir * scattered.event.t;
    stream.seek(segment.base + dim::AIRLIGHT_POINT);
    let (light, time, u) = (scattered.light, segment.time, stream.next_2d());
    let point = scene.lights.sample_light(&scene.world, &scene.textures, light, position, time, u)?;
    let lamp = (point.position, point.error, point.normal);
    (point.radiance != Rgb::ZERO).then(|| shadow_segment((position, Vec3A::ZERO, Vec3A::ZERO), lamp, time))
}

/// Returns the lobes of a surface toward a viewer who looks along `dir`, if they contain more information than its normal.
#[inline]
fn lobes(bsdf: &Bsdf, wo: Vec3A, dir: Vec3A) -> Option<BsdfLobes> {
    let (diffuse, glossy, alpha) = bsdf.glossy_lobes(wo)?;
    Some(BsdfLobes { diffuse, glossy, alpha, wo: -dir })
}

/// Performs Russian roulette, and ends paths with a throughput of 0.
///
/// The survival probability is the remaining weight over the threshold. Where little is absorbed, a path of many segments keeps its
/// weight. Weights that grew with every segment would have infinite variance. A long path ends all the same: its probability to
/// have `n` rays is `LONG_PATH / n`, so that weights grow no faster than paths, and the square of that over `VERY_LONG_PATH`, so
/// that the mean length is bounded in endless fog that absorbs nothing.
///
/// If a field knows the light that arrives at a vertex, this determines the probability (\[vorba2016\]). A path that a guide has
/// sent toward much light has a small weight for that reason and is worth continuing. A path of great weight in the dark is not.
/// The field may be wrong, so the survival probability is at least [`RR_MIN_SURVIVAL`] times that by the weight.
/// - `scale`: factor of the weight here, which removes the changes by guides and refraction;
/// - `survival`: light that the field expects of the path from here on, relative to that from the first vertex on.
#[inline]
fn survives<const MEDIA: bool>(
    rays: u32,
    throughput: &mut Rgb,
    scale: f32,
    survival: Option<f32>,
    stream: &mut SampleStream,
    base: u32,
) -> bool {
    let most = throughput.max_element();
    if !throughput.is_finite() || most <= 0.0 {
        return false;
    }
    if rays < RR_MIN_RAYS {
        return true;
    }
    let threshold = if MEDIA { RR_THRESHOLD_IN_MEDIA } else { RR_THRESHOLD };
    let mut q = (most * scale / threshold).min(1.0);
    if let Some(survival) = survival {
        q = survival.clamp(RR_MIN_SURVIVAL * q, 1.0);
    }
    if rays > LONG_PATH {
        let long_survival = (rays - 1) as f32 / rays as f32;
        q *= if rays > VERY_LONG_PATH { square(long_survival) } else { long_survival };
    }
    stream.seek(base + dim::ROULETTE);
    if stream.next_1d() >= q {
        return false;
    }
    *throughput /= q;
    true
}

/// Returns the rest of a ray behind a surface that it goes straight through. The ray stays on its segment: sampled light reaches
/// the previous vertex through the same surfaces, so light that is hit is weighted against that.
#[inline]
fn continue_straight(
    ray: &Ray,
    point: &ShadingPoint,
    medium_stack: &mut MediumStack,
    material: &KernelMaterial,
    back: bool,
) -> Ray {
    cross_boundary(medium_stack, material, back);
    Ray { origin: offset_origin(point.position, point.error, point.normal, ray.dir), ..*ray }
}

/// Creates the contribution of a field at a path's latest vertex.
fn field_contribution(color: Rgb, throughput: Rgb, bounce: u32, position: Vec3A) -> Contribution {
    Contribution { color, throughput, bounce, technique: LightTechnique::Field, light: None, position }
}

/// Returns the BSDF at a point of a material.
#[inline]
pub(crate) fn bsdf_at(scene: &Prepared, material: &KernelMaterial, point: &ShadingPoint) -> Bsdf {
    match material.map_rd {
        None => material.bsdf,
        Some(map) => material.textured_bsdf(scene.textures[map as usize].lookup(point.uv)),
    }
}

/// Returns the shading frame, and the direction toward the viewer in it.
#[inline]
pub(crate) fn local_wo(material: &KernelMaterial, point: &ShadingPoint, dir: Vec3A) -> (Frame, Vec3A) {
    let outward = -dir;
    let back = point.normal.dot(outward) < 0.0;
    let mut shading = point.shading_normal;
    if back && material.orientation == Orientation::TowardViewer {
        shading = -shading;
    }
    let mut frame = Frame::from_normal(shading);
    let mut wo = frame.to_local(outward);
    // An interpolated normal may put the viewer on the wrong side of the surface. Then the geometric normal is used for shading.
    let expected_front = !back || material.orientation == Orientation::TowardViewer;
    if (wo.z > 0.0) != expected_front {
        let normal =
            if back && material.orientation == Orientation::TowardViewer { -point.normal } else { point.normal };
        frame = Frame::from_normal(normal);
        wo = frame.to_local(outward);
    }
    (frame, wo)
}

/// Returns the normal of the side from which light is scattered, as context for the choice of a light; zero if the surface
/// transmits light.
#[inline]
fn lit_side(bsdf: &Bsdf, point: &ShadingPoint, back: bool) -> Vec3A {
    if bsdf.transmits() {
        Vec3A::ZERO
    } else if back {
        -point.normal
    } else {
        point.normal
    }
}

/// Checks whether shading and geometry agree on the side of `wi`.
#[inline]
fn sides_agree(frame: &Frame, point: &ShadingPoint, local: Vec3A, world: Vec3A) -> bool {
    // The frame's normal may point away from the front side.
    let turned = frame.normal.dot(point.normal) < 0.0;
    let geometric = point.normal.dot(world);
    (local.z > 0.0) == ((geometric > 0.0) != turned)
}

/// Updates the media when the path crosses a surface, from the front into the object or back out.
#[inline]
pub(crate) fn cross_boundary(medium_stack: &mut MediumStack, material: &KernelMaterial, from_back: bool) {
    if let Some(medium) = material.interior_medium {
        if from_back { medium_stack.remove(medium) } else { medium_stack.push(medium) }
    }
}

#[inline]
pub(crate) fn square(x: f32) -> f32 {
    x * x
}
