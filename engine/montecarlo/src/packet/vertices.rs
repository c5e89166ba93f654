//! Vertices of paths in lanes: `Tracer::scatter_at_surface` for opaque surfaces in clear air.
//!
//! The lanes do the same operations as the tracer, in the same order. A single rectangular lamp is sampled in vectors. Other lamps
//! are sampled lane by lane with the tracer's functions; all the rest is in vectors, too.

use super::paths::PathLanes;
use super::points::PointLanes;
use super::rectangle::{LampPoints, sample_points};
use super::rough::{RoughLanes, RoughSurfaces};
use super::vectors::{FloatLanes, Frames, Functions, V3, VectorLanes};
use crate::dimensions as dim;
use crate::path_state::PathState;
use crate::roulette::RR_MIN_RAYS;
use femc_emission::light::UniformRectangle;
use femc_emission::{DeltaKind, LightSample};
use femc_geometry::RayLanes;
use femc_math::glam::Vec2;
use femc_math::sampler::StreamLanes;
use femc_math::{Rgb, gamma};
use femc_prepared::camera::View;
use femc_prepared::{Crossing, KernelMaterial, Orientation, Prepared};
use femc_scattering::Bsdf;
use femc_scattering::bsdf::Opaque;
use femc_simd::{Kernel, Level, Simd, Vector};
use std::f32::consts::FRAC_1_PI;

/// Parts of a frame that the lanes need.
pub struct LaneScene<'a> {
    /// The frame.
    pub prepared: &'a Prepared,
    /// Surfaces of each material, by side (front, back).
    surfaces: Vec<[LaneSurface<'a>; 2]>,
    /// The only lamp, if it is a rectangle, and the maximum distance of the traced surface from it, m.
    pub lamp: Option<(UniformRectangle, f32)>,
    /// View of a camera at rest without a lens, in a scene at rest.
    pub view: Option<View>,
    /// Instruction set.
    pub level: Level,
}

/// A side of a material.
#[derive(Clone, Copy)]
enum LaneSurface<'a> {
    /// Not scattered in lanes.
    Other,
    /// Lambertian reflection of one color.
    Matte { reflectance: Rgb },
    /// Lambertian reflection with a texture.
    Textured { map: u32 },
    /// Reflection without a delta.
    Rough(&'a Opaque),
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
    Rough(&'a Opaque),
}

impl<'a> LaneScene<'a> {
    /// Returns the parts of a frame. `None`: it has media, surfaces that shadow rays go through, or no lamps.
    pub fn new(scene: &'a Prepared) -> Option<Self> {
        if !scene.media.is_empty() || scene.has_clear_surfaces || scene.lights.is_empty() {
            return None;
        }
        let side = |material: &'a KernelMaterial, crossing| {
            if crossing != Crossing::Scatter || material.orientation != Orientation::TowardViewer {
                return LaneSurface::Other;
            }
            match (&material.bsdf, material.map_rd) {
                (Bsdf::Diffuse(diffuse), None) => LaneSurface::Matte { reflectance: diffuse.rd },
                (Bsdf::Diffuse(_), Some(map)) => LaneSurface::Textured { map },
                (Bsdf::Opaque(opaque), None) if !opaque.is_smooth() => LaneSurface::Rough(opaque),
                _ => LaneSurface::Other,
            }
        };
        Some(Self {
            prepared: scene,
            surfaces: scene.materials.iter().map(|it| it.crossing.map(|crossing| side(it, crossing))).collect(),
            lamp: scene.lights.sole_rectangle(),
            view: if scene.world.moves() { None } else { scene.camera.pinhole() },
            level: scene.lights.sampler().level(),
        })
    }

    /// Returns the scattering of the surface at a point. `None`: lanes do not scatter it.
    #[inline(always)]
    pub fn scattering(&self, points: &PointLanes, lane: usize) -> Option<Scattering<'a>> {
        let material = points.material(lane) as usize;
        let side = (points.back >> lane & 1) as usize;
        // An interpolated normal may put the viewer on the wrong side of the surface.
        if points.agree >> lane & 1 == 0 {
            return None;
        }
        match self.surfaces[material][side] {
            LaneSurface::Other => None,
            LaneSurface::Matte { reflectance } => Some(Scattering::Matte { reflectance }),
            LaneSurface::Rough(opaque) => Some(Scattering::Rough(opaque)),
            LaneSurface::Textured { map } => textured(self.prepared, material, map, points.uv(lane)),
        }
    }
}

/// Returns the scattering of a textured matte surface.
#[inline(never)]
fn textured(scene: &Prepared, material: usize, map: u32, uv: Vec2) -> Option<Scattering<'_>> {
    match scene.materials[material].textured_bsdf(scene.textures[map as usize].lookup(uv)) {
        Bsdf::Diffuse(diffuse) => Some(Scattering::Matte { reflectance: diffuse.rd }),
        _ => None,
    }
}

/// Vertices of paths, from the arrival to the departure.
#[derive(Default)]
pub struct Vertices {
    /// Lanes with a vertex.
    pub used: u32,
    /// Reflectances of matte surfaces.
    pub reflectance: VectorLanes,
    pub rough: RoughLanes,
    /// Lanes in which Russian roulette may end the path.
    pub is_long: u32,
    point_numbers: StreamLanes,
    pub direction_numbers: StreamLanes,
    pub lobe_numbers: StreamLanes,
    pub roulette_numbers: StreamLanes,
    lamps: LampLanes,
    /// Directions toward the previous vertices, local frame.
    pub wo: VectorLanes,
    /// Shadow rays.
    shadow: Rays,
    /// Light of the lamp's points if nothing occludes them, cd/m2.
    pub light: VectorLanes,
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
}

impl LampLanes {
    #[inline(always)]
    fn load<S: Simd>(&self, simd: S) -> LampPoints<S::V> {
        LampPoints {
            lit: self.lit,
            unsampled: 0,
            dir: self.dir.load(simd),
            position: self.position.load(simd),
            error: self.error.load(simd),
            normal: self.normal.load(simd),
            radiance: self.radiance.load(simd),
            pdf: simd.load(&self.pdf.0),
            can_be_hit: simd.load(&self.can_be_hit.0),
        }
    }
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

impl Vertices {
    /// Removes all vertices.
    pub fn clear(&mut self) {
        (self.used, self.is_long, self.lamps.lit) = (0, 0, 0);
        self.rough.clear();
    }

    /// Adds the vertex of a path.
    #[inline(always)]
    pub fn add(&mut self, lane: usize, path: &PathState, scattering: Scattering<'_>) {
        self.used |= 1 << lane;
        match scattering {
            Scattering::Matte { reflectance } => self.reflectance.set(lane, reflectance),
            Scattering::Rough(surface) => {
                self.rough.add(lane, surface);
                self.lobe_numbers.set(lane, &path.stream, path.base + dim::LOBE);
            }
        }
        self.is_long |= u32::from(path.rays >= RR_MIN_RAYS) << lane;
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

    /// Samples points on the only lamp, if it is a rectangle. Computes the light of the lamps' points, and the shadow rays. Lanes for
    /// which the lamp cannot be sampled are removed from the vertices, and returned.
    pub fn sample_lamps(&mut self, scene: &LaneScene<'_>, points: &PointLanes, paths: &PathLanes) -> u32 {
        let unsampled = scene.level.run(SampleLamps { scene, vertices: self, points, paths });
        self.used &= !unsampled;
        self.rough.used &= !unsampled;
        unsampled
    }

    /// Returns the shadow rays, and their lanes.
    /// - `time`: times in the shutter.
    #[inline(always)]
    pub fn shadow_rays<'a>(&'a self, time: &'a FloatLanes) -> (RayLanes<'a>, u32) {
        let Rays { used, origin, dir, length } = &self.shadow;
        (RayLanes { origin: &origin.0, dir: &dir.0, t_max: &length.0, time: &time.0 }, *used)
    }
}

/// Surfaces in the registers.
pub struct Surfaces<V> {
    pub position: V3<V>,
    pub error: V3<V>,
    pub normal: V3<V>,
    pub facing: V3<V>,
    /// Lanes whose frame's normal points away from the front side.
    turned: u32,
}

impl<V: Vector> Surfaces<V> {
    #[inline(always)]
    pub fn load<S: Simd<V = V>>(simd: S, points: &PointLanes) -> Self {
        let (normal, facing) = (points.normal.load(simd), points.facing.load(simd));
        Self {
            position: points.position.load(simd),
            error: points.error.load(simd),
            normal,
            facing,
            turned: facing.dot(normal).lt(simd.splat(0.0)).signs(),
        }
    }

    /// Returns the lanes in which shading and geometry agree on the side of incident directions: `SurfaceInteraction::sides_agree`.
    #[inline(always)]
    pub fn sides_agree<S: Simd<V = V>>(&self, simd: S, local_z: V, dir: V3<V>) -> u32 {
        !(simd.is_positive(local_z).signs() ^ simd.is_positive(self.normal.dot(dir)).signs() ^ self.turned)
    }
}

/// Samples points on the lamp, and computes their light and the shadow rays. Returns the lanes for which the lamp cannot be sampled.
struct SampleLamps<'a> {
    scene: &'a LaneScene<'a>,
    vertices: &'a mut Vertices,
    points: &'a PointLanes,
    paths: &'a PathLanes,
}

impl Kernel for SampleLamps<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u32 {
        let Self { scene, vertices, points, paths } = self;
        let surfaces = Surfaces::load(simd, points);
        let lamps = match &scene.lamp {
            Some((lamp, position_error)) => {
                let u = vertices.point_numbers.next_2d(simd);
                sample_points(simd, lamp, *position_error, surfaces.position, u)
            }
            None => vertices.lamps.load(simd),
        };
        // Value times cosine, and the density with which the BSDF is sampled in the lamp's direction.
        let frames = Frames::from_normal(simd, surfaces.facing);
        let wo = frames.to_local(paths.dir.load(simd).negated(simd));
        let wi = frames.to_local(lamps.dir);
        let mut scatter_pdf = simd.is_positive(wo.z * wi.z) & (simd.abs(wi.z) * simd.splat(FRAC_1_PI));
        let mut value = vertices.reflectance.load(simd).scale(scatter_pdf);
        if vertices.rough.used != 0 {
            let is_rough = simd.mask(vertices.rough.used);
            let (rough_value, rough_pdf) = RoughSurfaces::new(simd, &vertices.rough, wo).eval_pdf(wi);
            value = rough_value.or_else(is_rough, value);
            scatter_pdf = is_rough.select(rough_pdf, scatter_pdf);
            vertices.wo = wo.store();
        }
        let zero = simd.splat(0.0);
        let is_black = value.x.equal(zero) & value.y.equal(zero) & value.z.equal(zero);
        let lit = lamps.lit & surfaces.sides_agree(simd, wi.z, lamps.dir) & !is_black.signs();
        // Light, weighted against a direction of the BSDF that hits the lamp.
        let ratio = scatter_pdf / lamps.pdf;
        let weight = simd.splat(1.0) / (simd.splat(1.0) + ratio * ratio * lamps.can_be_hit);
        vertices.light = (value * lamps.radiance).scale(weight / lamps.pdf).store();
        // Shadow rays: `shadow_segment`.
        let between = lamps.position - surfaces.position;
        let start = simd.offset_origin(surfaces.position, surfaces.error, surfaces.normal, between);
        let error = lamps.error + between.abs(simd).scale(simd.splat(gamma(16)));
        let end = simd.offset_origin(lamps.position, error, lamps.normal, between.negated(simd));
        let way = end - start;
        let length = way.dot(way).sqrt();
        // A ray without length hits nothing; it has the direction x.
        let is_long = simd.is_positive(length);
        let dir = way.over(length);
        let shadow = &mut vertices.shadow;
        shadow.used = vertices.used & lit & !lamps.unsampled;
        shadow.origin = start.store();
        shadow.dir = dir.or_else(is_long, V3 { x: simd.splat(1.0), y: zero, z: zero }).store();
        shadow.length.0 = (is_long & length).lanes();
        vertices.used & lamps.unsampled
    }
}
