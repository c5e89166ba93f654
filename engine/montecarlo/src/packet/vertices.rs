//! Vertices of paths in lanes: `Tracer::scatter_at_surface` for opaque surfaces in clear air.
//!
//! The lanes do the same operations as the tracer, in the same order. Matte surfaces and a single rectangular lamp are computed in
//! vectors. Other lamps and rough surfaces are computed lane by lane with the tracer's functions; all the rest is in vectors, too.

use super::rectangle::{LampPoints, sample_points};
use super::vectors::{FloatLanes, Frames, Functions, V3, VectorLanes};
use crate::dimensions as dim;
use crate::path_state::PathState;
use crate::roulette::{RR_MIN_RAYS, RR_THRESHOLD};
use femc_emission::light::UniformRectangle;
use femc_emission::{DeltaKind, LightSample};
use femc_geometry::Ray;
use femc_math::glam::Vec3A;
use femc_math::sampler::StreamLanes;
use femc_math::{Rgb, gamma};
use femc_prepared::{Crossing, Orientation, Prepared, ShadingPoint};
use femc_scattering::{Bsdf, BsdfSample};
use femc_simd::{Kernel, Level, Simd, Vector};
use std::f32::consts::FRAC_1_PI;

/// Parts of a frame that the lanes need.
pub struct LaneScene {
    /// Surfaces of each material that are scattered in lanes, by side (front, back).
    kinds: Vec<[bool; 2]>,
    /// The only lamp, if it is a rectangle, and the maximum distance of the traced surface from it, m.
    pub lamp: Option<(UniformRectangle, f32)>,
    /// Instruction set.
    pub level: Level,
}

/// Scattering of a surface.
#[derive(Clone, Copy)]
pub enum Scattering<'a> {
    /// Lambertian reflection.
    Matte {
        /// Reflectance.
        reflectance: Rgb,
    },
    /// Reflection without a delta.
    Rough(&'a Bsdf),
}

impl LaneScene {
    /// Returns the parts of a frame. `None`: it has media, surfaces that shadow rays go through, or no lamps.
    pub fn new(scene: &Prepared) -> Option<Self> {
        if !scene.media.is_empty() || scene.has_clear_surfaces || scene.lights.is_empty() {
            return None;
        }
        let kind = |material: &femc_prepared::KernelMaterial| {
            material.crossing.map(|crossing| {
                let is_opaque = match material.bsdf {
                    Bsdf::Diffuse(_) => true,
                    Bsdf::Opaque(opaque) => !opaque.is_smooth(),
                    Bsdf::Black | Bsdf::Mirror(_) | Bsdf::Sheet(_) | Bsdf::Dielectric(_) => false,
                };
                is_opaque && crossing == Crossing::Scatter && material.orientation == Orientation::TowardViewer
            })
        };
        let kinds = scene.materials.iter().map(kind).collect();
        Some(Self { kinds, lamp: scene.lights.sole_rectangle(), level: scene.lights.sampler().level() })
    }

    /// Returns the normal of the shading frame and the scattering of a surface where a ray along `dir` hit it. `None`: lanes do not
    /// scatter it.
    #[inline(always)]
    pub fn surface<'a>(
        &self,
        scene: &'a Prepared,
        point: &ShadingPoint,
        dir: Vec3A,
    ) -> Option<(Vec3A, Scattering<'a>)> {
        let back = point.normal.dot(dir) > 0.0;
        if !self.kinds[point.material as usize][usize::from(back)] {
            return None;
        }
        let normal = if back { -point.shading_normal } else { point.shading_normal };
        // An interpolated normal may put the viewer on the wrong side of the surface.
        if (-dir).dot(normal) <= 0.0 {
            return None;
        }
        let material = &scene.materials[point.material as usize];
        let scattering = match (&material.bsdf, material.map_rd) {
            (Bsdf::Diffuse(diffuse), None) => Scattering::Matte { reflectance: diffuse.rd },
            (rough, None) => Scattering::Rough(rough),
            (_, Some(map)) => match material.textured_bsdf(scene.textures[map as usize].lookup(point.uv)) {
                Bsdf::Diffuse(diffuse) => Scattering::Matte { reflectance: diffuse.rd },
                _ => return None,
            },
        };
        Some((normal, scattering))
    }
}

/// Vertices of paths, from the arrival to the departure.
#[derive(Default)]
pub struct Vertices {
    /// Lanes with a vertex.
    pub used: u32,
    /// Lanes of rough surfaces.
    pub rough: u32,
    pub position: VectorLanes,
    error: VectorLanes,
    /// Geometric normals on the front side.
    normal: VectorLanes,
    /// Normals of the shading frames, on the side of the path.
    facing: VectorLanes,
    /// Directions of the rays.
    dir: VectorLanes,
    reflectance: VectorLanes,
    throughput: VectorLanes,
    color: VectorLanes,
    roulette_scale: FloatLanes,
    /// 1 where Russian roulette may end the path.
    is_long: FloatLanes,
    point_numbers: StreamLanes,
    direction_numbers: StreamLanes,
    roulette_numbers: StreamLanes,
    lamps: LampLanes,
    /// Directions toward the previous vertices, local frame.
    pub wo: VectorLanes,
    /// Shadow rays.
    shadow: Rays,
    /// Mask of the shadow rays that hit nothing.
    visible: FloatLanes,
    /// Light of the lamp's points if nothing occludes them, cd/m2.
    light: VectorLanes,
    /// Sampled directions of rough surfaces in the local frame, and their weights.
    sampled: VectorLanes,
    weight: VectorLanes,
    /// Rays with which paths continue, and the densities of their directions, 1/sr.
    next: Rays,
    pdf: FloatLanes,
}

/// Sampled points of lamps.
#[derive(Default)]
struct LampLanes {
    /// Lanes with a point that sends light to the vertex.
    lit: u32,
    dir: VectorLanes,
    position: VectorLanes,
    error: VectorLanes,
    normal: VectorLanes,
    radiance: VectorLanes,
    /// Density of the lamp and the point, 1/sr.
    pdf: FloatLanes,
    /// 0 for lamps that are points, otherwise 1.
    can_be_hit: FloatLanes,
    /// Directions in the local frames.
    wi: VectorLanes,
    /// BSDF times cosine, and the density with which the path would be scattered in the direction, 1/sr.
    value: VectorLanes,
    scatter_pdf: FloatLanes,
}

/// Rays of the lanes.
#[derive(Default)]
struct Rays {
    /// Lanes with a ray.
    used: u32,
    origin: VectorLanes,
    dir: VectorLanes,
    length: FloatLanes,
}

impl Rays {
    #[inline(always)]
    fn ray(&self, lane: usize, time: f32) -> Ray {
        Ray { origin: self.origin.get(lane), dir: self.dir.get(lane), t_max: self.length.get(lane), time }
    }
}

impl Vertices {
    /// Removes all vertices.
    pub fn clear(&mut self) {
        (self.used, self.rough, self.lamps.lit) = (0, 0, 0);
    }

    /// Adds the vertex of a path.
    /// - `facing`: normal of the shading frame;
    /// - `color`: light of the path so far, cd/m2.
    #[inline(always)]
    pub fn add(
        &mut self,
        lane: usize,
        path: &PathState,
        point: &ShadingPoint,
        (facing, scattering): (Vec3A, Scattering<'_>),
        color: Rgb,
    ) {
        self.used |= 1 << lane;
        match scattering {
            Scattering::Matte { reflectance } => self.reflectance.set(lane, reflectance),
            Scattering::Rough(_) => self.rough |= 1 << lane,
        }
        self.position.set(lane, point.position);
        self.error.set(lane, point.error);
        self.normal.set(lane, point.normal);
        self.facing.set(lane, facing);
        self.dir.set(lane, path.ray.dir);
        self.throughput.set(lane, path.throughput);
        self.color.set(lane, color);
        self.roulette_scale.set(lane, path.roulette_scale);
        self.is_long.set(lane, if path.rays < RR_MIN_RAYS { 0.0 } else { 1.0 });
        self.point_numbers.set(lane, &path.stream, path.base + dim::LIGHT_POINT);
        self.direction_numbers.set(lane, &path.stream, path.base + dim::DIRECTION);
        self.roulette_numbers.set(lane, &path.stream, path.base + dim::ROULETTE);
    }

    /// Adds the point of a lamp to a vertex. Its density is that of the lamp and the point.
    #[inline(always)]
    pub fn add_lamp_point(&mut self, lane: usize, light: &LightSample) {
        let lamps = &mut self.lamps;
        lamps.lit |= u32::from(light.radiance != Rgb::ZERO) << lane;
        lamps.dir.set(lane, light.dir);
        lamps.position.set(lane, light.position);
        lamps.error.set(lane, light.error);
        lamps.normal.set(lane, light.normal);
        lamps.radiance.set(lane, light.radiance);
        lamps.pdf.set(lane, light.pdf);
        lamps.can_be_hit.set(lane, if light.delta == DeltaKind::Position { 0.0 } else { 1.0 });
    }

    /// Samples points on the only lamp, if it is a rectangle, and evaluates matte surfaces. Returns the lanes of rough
    /// surfaces that must be evaluated. Lanes for which the lamp cannot be sampled are removed from the vertices, and returned second.
    pub fn sample_lamps(&mut self, scene: &LaneScene) -> (u32, u32) {
        let unsampled = scene.level.run(SampleLamps { scene, vertices: self });
        self.used &= !unsampled;
        self.rough &= !unsampled;
        (self.rough & self.lamps.lit, unsampled)
    }

    /// Returns the direction to the point of the lamp, local frame.
    #[inline(always)]
    pub fn lamp_direction(&self, lane: usize) -> Vec3A {
        self.lamps.wi.get(lane)
    }

    /// Replaces the BSDF times the cosine for the point of the lamp, and the density with which the path would be scattered toward
    /// it, 1/sr.
    #[inline(always)]
    pub fn set_value(&mut self, lane: usize, value: Rgb, pdf: f32) {
        self.lamps.value.set(lane, value);
        self.lamps.scatter_pdf.set(lane, pdf);
    }

    /// Computes the shadow rays. Returns their lanes.
    pub fn find_shadow_rays(&mut self, scene: &LaneScene) -> u32 {
        scene.level.run(ShadowRays(self));
        self.shadow.used
    }

    /// Returns the shadow ray of a lane.
    #[inline(always)]
    pub fn shadow_ray(&self, lane: usize, time: f32) -> Ray {
        self.shadow.ray(lane, time)
    }

    /// Adds the sampled direction of a rough surface.
    #[inline(always)]
    pub fn add_direction(&mut self, lane: usize, sample: Option<BsdfSample>) {
        let (wi, weight, pdf) = sample.map_or((Vec3A::Z, Rgb::ZERO, 0.0), |it| (it.wi, it.weight, it.pdf));
        self.sampled.set(lane, wi);
        self.weight.set(lane, weight);
        self.pdf.set(lane, pdf);
    }

    /// Adds the light of the lamp, and samples the directions in which the paths continue. Returns the lanes of paths that
    /// continue.
    /// - `visible`: lanes whose shadow rays hit nothing.
    pub fn leave(&mut self, scene: &LaneScene, visible: u32) -> u32 {
        self.visible.set_mask(visible);
        scene.level.run(Leave(self));
        self.next.used
    }

    /// Returns the light of a path after [`Self::leave`], cd/m2.
    #[inline(always)]
    pub fn color(&self, lane: usize) -> Rgb {
        self.color.get(lane)
    }

    /// Returns the throughput of a path after [`Self::leave`].
    #[inline(always)]
    pub fn throughput(&self, lane: usize) -> Rgb {
        self.throughput.get(lane)
    }

    /// Returns the ray with which a path continues, and the density of its direction, 1/sr.
    #[inline(always)]
    pub fn next_ray(&self, lane: usize, time: f32) -> (Ray, f32) {
        (Ray { t_max: f32::INFINITY, ..self.next.ray(lane, time) }, self.pdf.get(lane))
    }
}

/// Surfaces in the registers.
struct Surfaces<V> {
    position: V3<V>,
    error: V3<V>,
    normal: V3<V>,
    facing: V3<V>,
    /// Lanes whose frame's normal points away from the front side.
    turned: u32,
}

impl<V: Vector> Surfaces<V> {
    #[inline(always)]
    fn load<S: Simd<V = V>>(simd: S, vertices: &Vertices) -> Self {
        let (normal, facing) = (vertices.normal.load(simd), vertices.facing.load(simd));
        Self {
            position: vertices.position.load(simd),
            error: vertices.error.load(simd),
            normal,
            facing,
            turned: facing.dot(normal).lt(simd.splat(0.0)).signs(),
        }
    }

    /// Returns the lanes in which shading and geometry agree on the side of incident directions: `SurfaceInteraction::sides_agree`.
    #[inline(always)]
    fn sides_agree<S: Simd<V = V>>(&self, simd: S, local_z: V, dir: V3<V>) -> u32 {
        !(simd.is_positive(local_z).signs() ^ simd.is_positive(self.normal.dot(dir)).signs() ^ self.turned)
    }
}

/// Samples points on the lamp, and evaluates matte surfaces. Returns the lanes for which the lamp cannot be sampled.
struct SampleLamps<'a> {
    scene: &'a LaneScene,
    vertices: &'a mut Vertices,
}

impl Kernel for SampleLamps<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u32 {
        let Self { scene, vertices } = self;
        let surfaces = Surfaces::load(simd, vertices);
        let lamps = &mut vertices.lamps;
        let mut cannot = 0;
        let dir = if let Some((lamp, position_error)) = &scene.lamp {
            let u = vertices.point_numbers.next_2d(simd);
            let LampPoints { lit, unsampled, dir, position, error, pdf } =
                sample_points(simd, lamp, *position_error, surfaces.position, u);
            lamps.lit = lit;
            lamps.position = position.store();
            lamps.error = error.store();
            lamps.normal = V3::splat(simd, lamp.normal).store();
            lamps.radiance = V3::splat(simd, lamp.radiance).store();
            lamps.pdf.0 = pdf.lanes();
            lamps.can_be_hit.0 = simd.splat(1.0).lanes();
            lamps.dir = dir.store();
            cannot = unsampled & vertices.used;
            dir
        } else {
            lamps.dir.load(simd)
        };
        lamps.lit &= vertices.used;
        let frames = Frames::from_normal(simd, surfaces.facing);
        let wo = frames.to_local(vertices.dir.load(simd).negated(simd));
        let wi = frames.to_local(dir);
        let pdf = simd.is_positive(wo.z * wi.z) & (simd.abs(wi.z) * simd.splat(FRAC_1_PI));
        lamps.value = vertices.reflectance.load(simd).scale(pdf).store();
        lamps.scatter_pdf.0 = pdf.lanes();
        lamps.lit &= surfaces.sides_agree(simd, wi.z, dir);
        lamps.wi = wi.store();
        vertices.wo = wo.store();
        cannot
    }
}

/// Computes the light of the lamps' points, and the shadow rays.
struct ShadowRays<'a>(&'a mut Vertices);

impl Kernel for ShadowRays<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self(vertices) = self;
        let lamps = &vertices.lamps;
        let zero = simd.splat(0.0);
        let value = lamps.value.load(simd);
        let is_black = value.x.equal(zero) & value.y.equal(zero) & value.z.equal(zero);
        let lit = lamps.lit & !is_black.signs();
        // Light, weighted against a direction of the BSDF that hits the lamp.
        let pdf = simd.load(&lamps.pdf.0);
        let ratio = simd.load(&lamps.scatter_pdf.0) / pdf;
        let weight = simd.splat(1.0) / (simd.splat(1.0) + ratio * ratio * simd.load(&lamps.can_be_hit.0));
        vertices.light = (value * lamps.radiance.load(simd)).scale(weight / pdf).store();
        // Shadow rays: `shadow_segment`.
        let surfaces = Surfaces::load(simd, vertices);
        let (position, normal) = (lamps.position.load(simd), lamps.normal.load(simd));
        let between = position - surfaces.position;
        let start = simd.offset_origin(surfaces.position, surfaces.error, surfaces.normal, between);
        let error = lamps.error.load(simd) + between.abs(simd).scale(simd.splat(gamma(16)));
        let end = simd.offset_origin(position, error, normal, between.negated(simd));
        let way = end - start;
        let length = way.dot(way).sqrt();
        // A ray without length hits nothing; it has the direction x.
        let is_long = simd.is_positive(length);
        let dir = way.over(length);
        let dir = V3 {
            x: is_long.select(dir.x, simd.splat(1.0)),
            y: is_long.select(dir.y, zero),
            z: is_long.select(dir.z, zero),
        };
        let shadow = &mut vertices.shadow;
        shadow.used = lit;
        shadow.origin = start.store();
        shadow.dir = dir.store();
        shadow.length.0 = (is_long & length).lanes();
    }
}

/// Adds the light of visible lamps, samples directions, and performs Russian roulette.
struct Leave<'a>(&'a mut Vertices);

impl Kernel for Leave<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self(vertices) = self;
        let zero = simd.splat(0.0);
        let surfaces = Surfaces::load(simd, vertices);
        let frames = Frames::from_normal(simd, surfaces.facing);
        let throughput = vertices.throughput.load(simd);
        let light = (throughput * vertices.light.load(simd)).masked(simd.load(&vertices.visible.0));
        vertices.color = (vertices.color.load(simd) + light).store();
        // Direction.
        let mut wi = simd.cosine_hemisphere(vertices.direction_numbers.next_2d(simd));
        let mut pdf = simd.abs(wi.z) * simd.splat(FRAC_1_PI);
        let mut weight = vertices.reflectance.load(simd);
        if vertices.rough != 0 {
            let mut mask = FloatLanes::default();
            mask.set_mask(vertices.rough);
            let is_rough = simd.load(&mask.0);
            wi = vertices.sampled.load(simd).or_else(is_rough, wi);
            weight = vertices.weight.load(simd).or_else(is_rough, weight);
            pdf = is_rough.select(simd.load(&vertices.pdf.0), pdf);
        }
        let dir = frames.to_world(wi);
        let mut goes_on = vertices.used & simd.is_positive(pdf).signs() & surfaces.sides_agree(simd, wi.z, dir);
        let throughput = throughput * weight;
        // Russian roulette.
        let most = throughput.x.max(throughput.y).max(throughput.z);
        goes_on &= simd.finite(throughput.x) & simd.finite(throughput.y) & simd.finite(throughput.z);
        let is_left = simd.is_positive(most);
        goes_on &= is_left.signs();
        let q = (most * simd.load(&vertices.roulette_scale.0) / simd.splat(RR_THRESHOLD)).min(simd.splat(1.0));
        let may_end = is_left & zero.lt(simd.load(&vertices.is_long.0)) & q.lt(simd.splat(1.0));
        if may_end.signs() & goes_on != 0 {
            let number = vertices.roulette_numbers.next_1d(simd);
            goes_on &= !(may_end.signs() & q.le(number).signs());
        }
        // The next ray.
        vertices.throughput = throughput.over(may_end.select(q, simd.splat(1.0))).store();
        vertices.pdf.0 = pdf.lanes();
        let next = &mut vertices.next;
        next.used = goes_on;
        next.origin = simd.offset_origin(surfaces.position, surfaces.error, surfaces.normal, dir).store();
        next.dir = dir.store();
    }
}
