//! The path loop.

use crate::dimensions as dim;
use crate::fog::{Collision, Fog, Segment};
use crate::shadow::Shadow;
use femc_emission::DeltaKind;
use femc_geometry::{Ray, offset_origin};
use femc_math::glam::Vec3A;
use femc_math::{Frame, Rgb, SampleStream};
use femc_prepared::compile::NONE;
use femc_prepared::media::{Inside, MediaRay};
use femc_prepared::{Crossing, KernelMaterial, Orientation, Prepared, SurfacePoint};
use femc_scattering::{Bsdf, LobeKind};

/// Segments after which Russian roulette may end a path.
const ROULETTE_FROM: u32 = 4;
/// A path never survives roulette with a higher probability: every path ends.
const ROULETTE_MAX: f32 = 0.95;
/// Index-matched interfaces that a path may cross in a row.
const MAX_CROSSINGS: u32 = 512;

/// What a path may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathSettings {
    /// Key of the random streams.
    pub seed: u64,
    /// Longest path in segments (1: what the camera sees directly); 0: no bound.
    pub max_depth: u32,
}

/// Work done by a tracer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Closest-hit rays.
    pub rays: u64,
    /// Shadow rays.
    pub shadow_rays: u64,
    /// Path segments.
    pub segments: u64,
}

/// The result of one camera sample.
#[derive(Clone, Copy, Debug)]
pub struct PathSample {
    /// Radiance, cd/m2. Not checked: the film refuses what is not finite.
    pub color: Rgb,
    /// Reflectance at the first surface.
    pub albedo: Rgb,
    /// Distance of the first surface along the view axis, m; infinite when there is none.
    pub depth: f32,
}

/// The vertex before the present segment, for multiple importance sampling of light that is met by chance.
#[derive(Clone, Copy)]
struct Previous {
    position: Vec3A,
    /// Normal of the side that light was scattered from; zero where light counted from all sides.
    normal: Vec3A,
    /// Density of the segment's direction, 1/sr; `None`: it could only be met this way (camera, mirror).
    pdf: Option<f32>,
    /// The scattering event when the vertex was in a medium.
    collision: Option<Collision>,
}

/// Traces the samples of one frame on one thread.
pub struct Tracer<'a> {
    scene: &'a Prepared,
    settings: PathSettings,
    segment_media: MediaRay,
    shadow: Shadow,
    /// Work done so far.
    pub counters: Counters,
}

impl<'a> Tracer<'a> {
    /// A tracer of `scene`.
    pub fn new(scene: &'a Prepared, settings: PathSettings) -> Self {
        Self {
            scene,
            settings,
            segment_media: MediaRay::default(),
            shadow: Shadow::default(),
            counters: Counters::default(),
        }
    }

    /// Draws sample `sample` of `pixel` (row-major index in the whole film); `place` maps two random numbers to the film
    /// position, pixels.
    #[inline]
    pub fn sample(&mut self, pixel: u32, sample: u32, place: impl FnOnce([f32; 2]) -> [f32; 2]) -> PathSample {
        let mut stream = SampleStream::new(self.settings.seed, self.scene.frame, pixel, sample);
        stream.seek(dim::FILM);
        let [x, y] = place(stream.next_2d());
        stream.seek(dim::LENS);
        let lens = stream.next_2d();
        stream.seek(dim::TIME);
        let time = stream.next_1d();
        let ray = self.scene.camera.ray(x, y, lens, time);
        if self.scene.media.is_empty() { self.trace::<false>(ray, stream) } else { self.trace::<true>(ray, stream) }
    }

    fn trace<const MEDIA: bool>(&mut self, mut ray: Ray, mut stream: SampleStream) -> PathSample {
        let scene = self.scene;
        let mut out = PathSample { color: Rgb::ZERO, albedo: Rgb::ZERO, depth: f32::INFINITY };
        let mut throughput = Rgb::ONE;
        let mut inside = scene.camera_inside;
        let mut previous = Previous { position: ray.origin, normal: Vec3A::ZERO, pdf: None, collision: None };
        // Square of the index ratio that radiance was scaled by: roulette must not count it as a loss.
        let mut eta_scale = 1.0f32;
        let mut first = true;
        let (mut segment, mut crossings) = (0u32, 0u32);
        loop {
            let base = dim::segment(segment);
            self.counters.rays += 1;
            self.counters.segments += 1;
            let hit = scene.world.intersect(&ray);
            let t_hit = hit.as_ref().map_or(f32::INFINITY, |h| h.t);

            if MEDIA && scene.media.along(ray.origin, ray.dir, t_hit, &inside, &mut self.segment_media) {
                let may_scatter = self.settings.max_depth == 0 || segment + 1 < self.settings.max_depth;
                let mut fog =
                    Fog { scene, ray: &self.segment_media, shadow: &mut self.shadow, counters: &mut self.counters };
                let stretch = Segment { origin: ray.origin, dir: ray.dir, time: ray.time, inside: &inside, base };
                out.color += throughput * fog.glow(&stretch, &mut stream);
                if may_scatter {
                    out.color += throughput * fog.equiangular(&stretch, &mut stream);
                }
                match fog.collide(&stretch, &mut stream) {
                    Ok(collision) => {
                        first = false;
                        if !may_scatter {
                            break;
                        }
                        throughput *= collision.event.weight;
                        out.color += throughput * fog.direct(&stretch, &collision, &mut stream);
                        let Some((dir, pdf, weight)) = fog.scatter(&stretch, &collision, &mut stream) else { break };
                        throughput *= weight;
                        previous = Previous {
                            position: collision.position,
                            normal: Vec3A::ZERO,
                            pdf: Some(pdf),
                            collision: Some(collision),
                        };
                        ray = Ray { origin: collision.position, dir, t_max: f32::INFINITY, time: ray.time };
                        segment += 1;
                        if !self.survives(segment, &mut throughput, eta_scale, &mut stream, base) {
                            break;
                        }
                        continue;
                    }
                    Err(weight) => throughput *= weight,
                }
            }
            let Some(hit) = hit else { break };
            let point = scene.surface(&ray, &hit);
            if point.light != NONE {
                out.color += throughput * self.met_light(&ray, &point, &previous);
            }
            let material = &scene.materials[point.material as usize];
            let back = point.normal.dot(ray.dir) > 0.0;
            if let Crossing::Null { tint } = material.crossing[usize::from(back)] {
                crossings += 1;
                if crossings > MAX_CROSSINGS {
                    break;
                }
                throughput *= tint;
                cross(&mut inside, material, back);
                let origin = offset_origin(point.position, point.error, point.normal, ray.dir);
                ray = Ray { origin, ..ray };
                continue;
            }
            if first {
                first = false;
                out.depth = scene.camera.depth(point.position, ray.time);
                out.albedo = throughput * self.bsdf(material, &point).albedo(local_wo(material, &point, ray.dir).1);
            }
            if self.settings.max_depth != 0 && segment + 1 >= self.settings.max_depth {
                break;
            }
            let bsdf = self.bsdf(material, &point);
            let (frame, wo) = local_wo(material, &point, ray.dir);
            if !bsdf.is_delta_only() {
                out.color += throughput
                    * self.direct::<MEDIA>(&bsdf, &frame, wo, &point, back, ray.time, &inside, base, &mut stream);
            }
            stream.seek(base + dim::LOBE);
            let choice = stream.next_1d();
            stream.seek(base + dim::DIRECTION);
            let Some(scattered) = bsdf.sample(wo, stream.next_2d(), choice) else { break };
            let wi = frame.to_world(scattered.wi);
            if !same_side(&frame, &point, scattered.wi, wi) {
                break;
            }
            throughput *= scattered.weight;
            if scattered.eta != 1.0 {
                eta_scale *= scattered.eta * scattered.eta;
            }
            let leaves_front = point.normal.dot(wi) > 0.0;
            if leaves_front == back {
                cross(&mut inside, material, back);
            }
            previous = Previous {
                position: point.position,
                normal: lit_side(&bsdf, &point, back),
                pdf: (scattered.lobe != LobeKind::Delta).then_some(scattered.pdf),
                collision: None,
            };
            let origin = offset_origin(point.position, point.error, point.normal, wi);
            ray = Ray { origin, dir: wi, t_max: f32::INFINITY, time: ray.time };
            segment += 1;
            crossings = 0;
            if !self.survives(segment, &mut throughput, eta_scale, &mut stream, base) {
                break;
            }
        }
        // A path that went wrong and met no light after that would pass for a dark one: the film is to count it.
        if !throughput.is_finite() {
            out.color = Rgb::NAN;
        }
        out
    }

    /// Russian roulette; also ends paths that carry nothing.
    #[inline]
    fn survives(
        &self,
        segment: u32,
        throughput: &mut Rgb,
        eta_scale: f32,
        stream: &mut SampleStream,
        base: u32,
    ) -> bool {
        let most = throughput.max_element();
        if !throughput.is_finite() || most <= 0.0 {
            return false;
        }
        if segment < ROULETTE_FROM {
            return true;
        }
        let q = (most * eta_scale).min(ROULETTE_MAX);
        stream.seek(base + dim::ROULETTE);
        if stream.next_1d() >= q {
            return false;
        }
        *throughput /= q;
        true
    }

    fn bsdf(&self, material: &KernelMaterial, point: &SurfacePoint) -> Bsdf {
        match material.map_rd {
            None => material.bsdf,
            Some(map) => material.textured(self.scene.textures[map as usize].lookup(point.uv)),
        }
    }

    /// Emission of a surface that the path met, weighted against the strategies that could have found it.
    #[inline]
    fn met_light(&self, ray: &Ray, point: &SurfacePoint, previous: &Previous) -> Rgb {
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
        let Some(pdf) = previous.pdf else { return radiance };
        if radiance == Rgb::ZERO {
            return radiance;
        }
        let at = (point.position, point.normal);
        let drawn = scene.lights.pdf(&scene.world, light, previous.position, ray.time, at, ray.dir);
        let chosen = scene.lights.probability(&scene.lights.at_point(previous.position, previous.normal), light);
        let others = match &previous.collision {
            None => square(drawn * chosen),
            Some(collision) => {
                let equiangular = collision.equiangular_pdf(scene, light, ray.time);
                square(drawn) * (square(chosen) + square(equiangular / collision.event.pdf))
            }
        };
        radiance * (square(pdf) / (square(pdf) + others))
    }

    /// Direct light on a surface by sampling a light.
    #[inline]
    fn direct<const MEDIA: bool>(
        &mut self,
        bsdf: &Bsdf,
        frame: &Frame,
        wo: Vec3A,
        point: &SurfacePoint,
        back: bool,
        time: f32,
        inside: &Inside,
        base: u32,
        stream: &mut SampleStream,
    ) -> Rgb {
        let scene = self.scene;
        if scene.lights.is_empty() {
            return Rgb::ZERO;
        }
        stream.seek(base + dim::LIGHT_POINT);
        let u = stream.next_2d();
        stream.seek(base + dim::LIGHT);
        let choice = dim::fine(stream.next_2d());
        let place = scene.lights.at_point(point.position, lit_side(bsdf, point, back));
        let Some(drawn) = scene.lights.sample(&scene.world, &scene.textures, &place, time, choice, u) else {
            return Rgb::ZERO;
        };
        let light = &drawn.sample;
        let wi = frame.to_local(light.dir);
        let value = bsdf.eval(wo, wi);
        if value == Rgb::ZERO || light.radiance == Rgb::ZERO || !same_side(frame, point, wi, light.dir) {
            return Rgb::ZERO;
        }
        let weight = if light.delta == DeltaKind::Position {
            1.0
        } else {
            square(light.pdf) / (square(light.pdf) + square(bsdf.pdf(wo, wi)))
        };
        let contribution = value * light.radiance * (weight / light.pdf);
        let mut inside = *inside;
        if MEDIA && (point.normal.dot(light.dir) > 0.0) == back {
            cross(&mut inside, &scene.materials[point.material as usize], back);
        }
        let from = (point.position, point.error, point.normal);
        contribution * self.shadow.visibility::<MEDIA>(scene, from, light, time, &inside, &mut self.counters)
    }
}

/// The shading frame and the direction toward the viewer in it.
#[inline]
fn local_wo(material: &KernelMaterial, point: &SurfacePoint, dir: Vec3A) -> (Frame, Vec3A) {
    let outward = -dir;
    let back = point.normal.dot(outward) < 0.0;
    let mut shading = point.shading;
    if back && material.faces_viewer == Orientation::TowardViewer {
        shading = -shading;
    }
    let mut frame = Frame::from_normal(shading);
    let mut wo = frame.to_local(outward);
    // An interpolated normal may put the viewer on the wrong side of the surface: shade with the geometric normal there.
    let expected_front = !back || material.faces_viewer == Orientation::TowardViewer;
    if (wo.z > 0.0) != expected_front {
        let normal =
            if back && material.faces_viewer == Orientation::TowardViewer { -point.normal } else { point.normal };
        frame = Frame::from_normal(normal);
        wo = frame.to_local(outward);
    }
    (frame, wo)
}

/// Normal of the side that light is scattered from, as the choice of a light wants it; zero where light comes through.
#[inline]
fn lit_side(bsdf: &Bsdf, point: &SurfacePoint, back: bool) -> Vec3A {
    if bsdf.transmits() {
        Vec3A::ZERO
    } else if back {
        -point.normal
    } else {
        point.normal
    }
}

/// Whether shading and geometry agree on the side of `wi`.
#[inline]
fn same_side(frame: &Frame, point: &SurfacePoint, local: Vec3A, world: Vec3A) -> bool {
    // The frame's normal may be turned against the front side.
    let turned = frame.normal.dot(point.normal) < 0.0;
    let geometric = point.normal.dot(world);
    (local.z > 0.0) == ((geometric > 0.0) != turned)
}

/// The path goes through a surface: from the front into what is behind, or back out.
#[inline]
fn cross(inside: &mut Inside, material: &KernelMaterial, from_back: bool) {
    if let Some(medium) = material.inside {
        if from_back { inside.remove(medium) } else { inside.push(medium) }
    }
}

#[inline]
pub(crate) fn square(x: f32) -> f32 {
    x * x
}
